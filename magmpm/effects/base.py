"""Interface of an effect: what it is, what it may request of a scene, and what it reports.

An effect is one file: its settings (a subclass of `Effect`, which scene files name by the file's name), its compiled hooks
(effects.hooks) and what it says of a scene. Every method of `Effect` but `records` has a default, so an effect writes only what it has.
"""

from abc import abstractmethod
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, NotRequired, Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.body import Body
from magmpm.bodies.body_shape import Region
from magmpm.compiled.arrays import Array, Named
from magmpm.effects.hooks import NO_DATA
from magmpm.fields.external_field import Field
from magmpm.fields.sources import FieldSource
from magmpm.inputs.settings import Quantity, Settings
from magmpm.inputs.vectors import Vector, three

Phase = Literal["force", "damping", "contact", "constraint"]
PHASES = (
    "force",
    "damping",
    "contact",
    "constraint",
)  # the order in which hooks of a kind are called
Records = tuple[
    NDArray[Any], ...
]  # parameter records and data, in turn; what kernels take (effects.hooks)

Place = Annotated[float, Quantity("length", at_least="-10 m", at_most="10 m")]
Point = Annotated[tuple[Place, Place, Place], three("[0 mm, 0 mm, -2 mm]")]


class SceneLike(Protocol):
    """Interface of a scene (magmpm.scene.Scene) for effects. Lengths in m."""

    body: Body
    field: FieldSource
    effects: Any  # effects.acting.Effects: settings by key, None where not named
    materials: (
        Any  # by name: shear_modulus (Pa), bulk_to_shear, density (kg/m^3 or None), remanence (T)
    )
    solver: Any  # dynamic, quasi_static: None where not requested
    resolution: Any  # cells_across, particles_per_cell

    @property
    def length(self) -> float: ...

    @property
    def duration(self) -> float: ...

    @property
    def cell(self) -> float: ...

    @property
    def thickness(self) -> float: ...

    def box(self) -> tuple[Vector, Vector]: ...

    def regions(self) -> tuple[Region, ...]: ...

    def region_remanence(self) -> Array: ...

    def magnetized_regions(self) -> list[int]: ...

    def external_field(self) -> Field: ...

    def with_effects(self, **effects: Named | Settings | None) -> Any: ...


class Touching(NamedTuple):
    """Points by which a body touches obstacles: x m (n, 3), mass (n,) kg, coefficient of friction (n,) of their own material (nan:
    none), and friction `pull` (n, 3) N with the largest that their pushes allow, `most` (n,) N."""

    x: Array
    mass: Array
    friction: Array
    pull: Array
    most: Array


class Contact(TypedDict):
    """Report of contact: force (3,) N on the body, number of points that touch, deepest penetration m (0: none), energy J of the springs
    that push; of two parts also the mean point (3,) m and normal (3,) of their push, and slip, the mean speed along it, m/s.
    """

    force: Array
    count: int
    depth: float
    energy: float
    point: NotRequired[Array]
    normal: NotRequired[Array]
    slip: NotRequired[float]


def one_record(dtype: np.dtype[Any], data: Array = NO_DATA, **values: Any) -> Records:
    """A record of these values, and its table."""
    record = np.zeros(1, dtype)
    for name, value in values.items():
        record[name] = value
    return record, data


class MarkedParticles(NamedTuple):
    """Mark (n,) (Effect.marks), segment (n,), volume (n,) m^3 and remanence (n, 3) T of a body's particles."""

    mark: Array
    segment: NDArray[np.integer]
    volume: Array
    remanence: Array


class BodyChange(NamedTuple):
    """A small change of a body: of the remanence (n, 3) T, position (n, 3) m and deformation gradient (n, 3, 3) of its particles."""

    remanence: Array
    x: Array
    F: Array


class Effect(Settings):
    """Settings of an effect, and what the program requests of it. `model` is a magmpm.model.Model."""

    PHASE: ClassVar[Phase]
    ONLY_IN_MOTION: ClassVar[bool] = False  # refused in a scene that is solved for its equilibrium
    ALONG_TIME: ClassVar[bool] = (
        # of an effect only in motion: whether equilibria along time (solver.quasi_static) have it
        # too
        False
    )
    IN_FIELD: ClassVar[bool] = False  # whether it is an effect of the external field

    @abstractmethod
    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels: records (one, or one for each of the times) and a table, or () for nothing.

        strength: factor of a load, 0 to 1; times (k,) s of the steps to come, None in statics.
        """

    def field_changes(
        self, scene: SceneLike, times: Array | None = None
    ) -> tuple[Records, Records, Records]:
        """Records whose stress and force are the derivatives of this effect's with respect to the field's uniform part, x, y, z, per T.

        times (1,) s: of the field's schedule; None: its end. () where a component does not matter. The
        effect may name a dtype of its own for them, with hooks of its own.
        """
        return (), (), ()

    @classmethod
    def key(cls) -> str:
        """The key in scene files: the name of the effect's file."""
        return cls.__module__.rpartition(".")[2]

    def stable_step(self, model: Any) -> float | None:
        """Largest stable step (s) of an effect that has records; None where the effect sets no limit."""
        return None

    def check(self, model: Any) -> None:
        """Raises InputError where the effect can't begin: a body that starts inside a wall, say."""

    def passed(self, scene: SceneLike, x: Array) -> str | None:
        """Reason why the points of a body's surface can't rest at x (n, 3) m: it has gone through an obstacle. None where all is well."""
        return None

    def warnings(self, scene: SceneLike) -> list[str]:
        """Warn of settings that the author of the scene may not have meant."""
        return []

    def report(self, model: Any, touching: Touching) -> Contact | None:
        """Contact of a model by its points that touch."""
        return None

    def marks(self, particles: Any, remanence: Array) -> Array | None:
        """A number (n,) by which hooks distinguish particles (bodies.section_quadrature.Particles); remanence (n, 3) T."""
        return None


class BodyEffect(Effect):
    """An effect that depends on the shape of the whole body, by a table that `refresh` keeps up to date.

    REFRESHED: the dtype of its records; their field `share` is the part of the load, 0 to 1, of the table and of `shared_energy`.
    """

    REFRESHED: ClassVar[np.dtype[Any]]

    @staticmethod
    @abstractmethod
    def refresh(data: Array, particles: MarkedParticles, x: Array, F: Array) -> float:
        """Bring the table up to date, in place; x (n, 3) m, F (n, 3, 3). Returns the energy (J) as `shared_energy` does."""

    @staticmethod
    @abstractmethod
    def coordinates(particles: MarkedParticles, x: Array, F: Array) -> Array:
        """Return what the table's first numbers act on (k,), linear in x and F: a held load has the energy -table . coordinates, J."""

    @staticmethod
    @abstractmethod
    def refresh_change(
        change: Array, particles: MarkedParticles, x: Array, F: Array, by: BodyChange
    ) -> None:
        """Write to `change` how the table changes with the body, to first order, in place; other arguments as of `refresh`.

        Stress and force of such an effect are linear in its table: with the change in its place, its hooks give their change.
        """

    @staticmethod
    @abstractmethod
    def shared_energy(particles: MarkedParticles, x: Array, F: Array) -> float:
        """Energy (J) of all particles in each other's presence; arguments as of `refresh`."""
