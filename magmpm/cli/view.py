"""`magmpm view`: a scene in the browser, with sliders for what can be turned; a motion, to be played."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magmpm.cli.answers import results_folder
from magmpm.errors import InputError
from magmpm.inputs.yaml_document import of_file, read_yaml
from magmpm.results.folder_lock import refuse_unwritable
from magmpm.scene import Scene, load_scene

if TYPE_CHECKING:
    from magmpm.cli.page_server import PageServer
    from magmpm.studies.problem.variables import VaryNumber


def command(options: argparse.Namespace) -> int:
    """Serve the page until it is stopped. Returns the exit status. Raises InputError."""
    path = Path(options.scene)
    scene, path, target, target_name = _requested(path, options)
    if options.port is not None and not 0 <= options.port < 65536:
        raise InputError(
            "--port",
            received=str(options.port),
            rule="must be 0 to 65535",
            remedy="--port 0 takes a free one",
        )
    folder = options.out or results_folder(scene.name)
    refuse_unwritable(folder)
    if scene.in_time:
        if options.cells is not None:
            remedy = "omit it, or change the scene's resolution"
            raise InputError(
                f"--cells: received one for a motion, which is shown as it is run; {remedy}"
            )
        from magmpm.cli.view_pages import MotionView

        view: Any = MotionView(scene, path, folder)
    else:
        from magmpm.cli.view_pages import ShapeView
        from magmpm.studies.explore.live import ready

        more = [_slider(text) for text in options.vary or ()]
        with of_file(path):
            view = ShapeView(ready(scene, options.cells), path, folder, target, target_name, more)
    try:
        return _serve(view, path, options)
    finally:
        view.close()


def _requested(path: Path, options: argparse.Namespace) -> tuple[Scene, Path, Any, str]:
    """The scene to view, its file, the target (m, 4) m or None, and what it is called. A study is viewed as its scene and target."""
    if "scene" in read_yaml(path):
        from magmpm.studies.search.definition import load_study

        study = load_study(path)
        assert study.scene_file is not None  # studies of files have one
        scene = study.scene
        path = study.scene_file
        name = f"target of {study.name}"
        target: Any = None if study.depths or study.keyframes else study.target
    else:
        scene = load_scene(path)
        target = scene.reference_centreline()
        name = "reference"
    if options.target is None:
        return scene, path, target, name
    if scene.in_time:
        raise InputError(
            "--target: received one for a motion; a target is compared with a shape at rest: "
            "omit it"
        )
    return scene, path, *_target(Path(options.target), scene)


def _slider(text: str) -> VaryNumber:
    """The number and its bounds in ADDRESS=MIN,MAX. Raises InputError."""
    from magmpm.cli.goals import address_and_values
    from magmpm.studies.problem.variables import VaryNumber

    address, (low, high) = address_and_values(text, "--vary", 2)
    return VaryNumber(of=address, min=low, max=high)


def _target(path: Path, scene: Scene) -> tuple[Any, str]:
    """The rows of a CSV table, or the target of a study, (m, 4) m; and what it is called."""
    from magmpm.inputs.csv_tables import read_centreline
    from magmpm.studies.search.definition import load_study
    from magmpm.studies.search.study_checks import check_shape

    rows = (
        read_centreline(path)
        if path.suffix.lower() not in (".yaml", ".yml")
        else load_study(path).target
    )
    if scene.body.shape.line is None:
        raise InputError(
            f"--target: received {path}; a body made of parts has no axis to compare with it: "
            "omit it"
        )
    check_shape(rows, scene.length, f"--target: {path}")
    return rows, path.stem.replace("_", " ")


def _serve(view: Any, path: Path, options: argparse.Namespace) -> int:
    from magmpm.cli.page_server import PageServer

    with PageServer(view.routes(), options.host, options.port) as server:
        _tell(server, path, options)
        signal.signal(
            signal.SIGTERM, signal.default_int_handler
        )  # ends it as Ctrl-C does, with its processes
        try:
            server.serve_forever()
        except KeyboardInterrupt:  # the usual way to end it
            print(file=sys.stderr)
    return 0


def _tell(server: PageServer, path: Path, options: argparse.Namespace) -> None:
    """Print the address of the page, and open it if requested."""
    if options.json:
        print(json.dumps({"url": server.url, "port": server.server_port}), flush=True)
    else:
        print(f"{server.url} shows {path}; Ctrl-C ends it", file=sys.stderr, flush=True)
    if options.open:
        import webbrowser

        webbrowser.open(server.url)
