"""Where a body's tip goes over many uniform fields, and where it would not be sure to go: `magmpm map`."""

from magmpm.studies.explore.tip_map.fields import Fields, in_plane, on_rays
from magmpm.studies.explore.tip_map.tips import MARKS, TipMap, map_tips

__all__ = ["MARKS", "Fields", "TipMap", "in_plane", "map_tips", "on_rays"]
