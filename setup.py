"""Where the packages are. studies/ and viz/ stand at the top of the repository and are installed inside magmpm, as magmpm.studies and
magmpm.viz: their own names are common, and a user's studies.py beside a script would be imported in their place. setup.cfg has the rest."""

from setuptools import find_packages, setup

INSIDE = ("studies", "viz")

found = find_packages(include=[name for top in ("magmpm", *INSIDE) for name in (top, f"{top}.*")])
setup(
    packages=[name if name.startswith("magmpm") else f"magmpm.{name}" for name in found],
    package_dir={f"magmpm.{name}": name for name in INSIDE},
)
