"""Design of anything that can be simulated: any number of a scene, any measure of its answer, any goal; and sweeps of values."""

from magmpm.compiled.arrays import Plain

__all__ = ["Bounds", "Plain"]
Bounds = tuple[float | None, float | None]  # least and greatest value, SI
