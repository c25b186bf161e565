"""The page in the browser that `magmpm view` serves: what it draws, as plain numbers, and the server. Its own files are in `site`."""

from magmpm.viz.page.motion import MotionStage
from magmpm.viz.page.server import PageServer, Routes
from magmpm.viz.page.stage import Stage, about_scene
from magmpm.viz.page.wire import packed

__all__ = ["MotionStage", "PageServer", "Routes", "Stage", "about_scene", "packed"]
