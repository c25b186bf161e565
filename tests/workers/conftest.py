"""The rod's solve and the other helpers of tests/studies serve here as well."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / "studies"), str(Path(__file__).parent)]
