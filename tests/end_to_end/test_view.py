"""`magmpm view` without a browser: its server answers who has the secret, and nobody else; wrong commands are refused."""

from __future__ import annotations

import http.client
import json
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from magmpm.cli import main
from magmpm.errors import InputError
from magmpm.results.folder_lock import refuse_unwritable
from magmpm.viz.page import PageServer, packed

ROOT = Path(__file__).resolve().parents[2]
FIVE = str(ROOT / "data" / "scenes" / "five_segments.yaml")


@pytest.fixture
def server() -> Iterator[PageServer]:
    def refuse(asked: object) -> bytes:
        raise InputError("not so")

    with PageServer({"echo": lambda asked: {"asked": asked}, "refuse": refuse}, port=0) as running:
        thread = running.begin()
        yield running
        running.shutdown()
        thread.join()


def ask(server: PageServer, method: str, path: str, body: str = "", **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    return answer.status, answer.read()


def test_only_this_machine_is_listened_to(server: PageServer) -> None:
    assert server.server_address[0] == "127.0.0.1"


def test_the_page_asks_with_its_secret(server: PageServer) -> None:
    """Its address ends with the secret, which the browser does not send on its own."""
    assert server.url.endswith(f"/#{server.secret}")
    assert len(server.secret) >= 24
    known = {"X-Magmpm-Secret": server.secret}
    assert ask(server, "POST", "/echo", '{"a": 1}', **known) == (200, b'{"asked": {"a": 1}}')
    assert ask(server, "POST", "/refuse", "null", **known) == (400, b'{"error": "not so"}')
    assert ask(server, "POST", "/echo", "{}")[0] == 403
    assert ask(server, "POST", "/echo", "{}", **{"X-Magmpm-Secret": "wrong"})[0] == 403


def test_other_names_are_not_answered(server: PageServer) -> None:
    """A page elsewhere whose name leads to this machine (DNS rebinding) is another host."""
    known = {"X-Magmpm-Secret": server.secret, "Host": "evil.example"}
    assert ask(server, "POST", "/echo", "{}", **known)[0] == 403
    assert ask(server, "GET", "/", **{"Host": "evil.example"})[0] == 403


@pytest.mark.parametrize(("path", "status"), [
    ("/", 200), ("/main.js", 200), ("/../server.py", 404), ("/%2e%2e/server.py", 404), ("/nothing.js", 404), ("//etc/passwd", 404),
])  # fmt: skip
def test_files_of_the_page_and_no_others(server: PageServer, path: str, status: int) -> None:
    assert ask(server, "GET", path)[0] == status


@pytest.mark.parametrize(("body", "length", "status"), [
    ("{", None, 400), ("[" * 100_000, None, 400), ("{}", "99999999999", 413), ("{}", "-1", 413), ("{}", "x", 413), ("{}", "2000000", 413),
])  # fmt: skip
def test_nonsense_is_refused(server: PageServer, body: str, length: str | None, status: int) -> None:
    headers = {"X-Magmpm-Secret": server.secret} | ({} if length is None else {"Content-Length": length})
    assert ask(server, "POST", "/echo", body, **headers)[0] == status
    assert ask(server, "POST", "/echo", "1", **{"X-Magmpm-Secret": server.secret})[0] == 200  # it goes on


def test_a_port_in_use_is_refused(server: PageServer) -> None:
    with pytest.raises(InputError, match="--port"):
        PageServer({}, port=server.server_port)


def test_messages_hold_their_arrays() -> None:
    """Read as the page reads them."""
    points = np.arange(6.0).reshape(2, 3)
    message = packed({"rms": float("nan"), "word": "ü"}, {"points": points, "triangles": np.array([[0, 1, 1]], np.int32)})
    (length,) = struct.unpack("<I", message[:4])
    header = json.loads(message[4 : 4 + length])
    assert length % 4 == 0
    assert header["rms"] is None
    assert [(one["name"], one["kind"], one["count"]) for one in header["arrays"]] == [("points", "f", 6), ("triangles", "u", 3)]
    np.testing.assert_array_equal(np.frombuffer(message, "<f4", 6, 4 + length), points.ravel())
    np.testing.assert_array_equal(np.frombuffer(message, "<u4", 3, 4 + length + 24), [0, 1, 1])


@pytest.mark.parametrize(("arguments", "words"), [
    (["--port", "70000"], "--port"), (["--cells", "1"], "--cells"), (["--target", "nothing.csv"], "nothing.csv"),
])  # fmt: skip
def test_wrong_options_are_refused(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    """With exit status 2, before anything is served."""
    assert main(["view", FIVE, *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_folder_that_cant_be_written_is_refused_before_the_page_is_served(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is tried leaves nothing behind."""
    assert main(["view", FIVE, "--out", "/proc/nope"]) == 2
    assert "the folder must be writable" in capsys.readouterr().err
    refuse_unwritable(tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def test_a_window_needs_a_display(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Said clearly, before the scene is solved."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert main(["view", FIVE, "--window"]) == 2
    said = capsys.readouterr().err
    assert "no display" in said
    assert "magmpm view" in said


def test_threads_end_with_the_server(server: PageServer) -> None:
    """Two at once: the page asks for a preview and a solution together."""
    answers: list[int] = []

    def one() -> None:
        answers.append(ask(server, "POST", "/echo", "1", **{"X-Magmpm-Secret": server.secret})[0])

    threads = [threading.Thread(target=one) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [200] * 8
