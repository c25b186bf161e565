"""Design of anything that can be simulated: any number of a scene, any measure of its answer, any goal; and sweeps of values."""

from typing import Any

Plain = dict[str, Any]  # plain data by key: what files and databases keep
Bounds = tuple[float | None, float | None]  # least and greatest value, SI
