"""Map of a body's tip over many uniform fields, and of the fields where its position is not certain: `magmpm map`."""

from magmpm.studies.explore.tip_map.fields import Fields, in_plane, on_rays
from magmpm.studies.explore.tip_map.tips import MARKS, TipMap, map_tips

__all__ = ["MARKS", "Fields", "TipMap", "in_plane", "map_tips", "on_rays"]
