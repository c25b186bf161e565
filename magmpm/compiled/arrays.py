"""Types, by what they hold."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Plain = dict[str, Any]  # plain data by key: what files, reports and databases keep
Named = Mapping[str, Any]  # values by name, which are read
NamedNumbers = dict[str, float]  # numbers by name
