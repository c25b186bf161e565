"""The page in the browser that `magmpm view` serves: what it draws, as plain numbers. Its own files are in `site`."""

from magmpm.viz.page.motion import MotionStage
from magmpm.viz.page.stage import Stage, about_scene, packed

__all__ = ["MotionStage", "Stage", "about_scene", "packed"]
