"""`magmpm view` without a browser: its server answers who has the secret, and nobody else; wrong commands are refused."""

import http.client
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from magmpm.cli.page_server import PageServer
from magmpm.cli.view import _target
from magmpm.errors import InputError
from magmpm.results.folder_lock import refuse_unwritable
from magmpm.scene import load_scene
from magmpm.viz.page import packed

ROOT = Path(__file__).resolve().parents[2]
FIVE = str(ROOT / "data" / "scenes" / "five_segments.yaml")


@contextmanager
def serving(*host: str) -> Iterator[PageServer]:
    def refuse(asked: object) -> bytes:
        raise InputError("not so")

    with PageServer(
        {"echo": lambda asked: {"asked": asked}, "refuse": refuse}, *host, port=0
    ) as running:
        thread = running.begin()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture
def server() -> Iterator[PageServer]:
    with serving() as running:
        yield running


def ask(
    server: PageServer, method: str, path: str, body: str = "", **headers: str
) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    return answer.status, answer.read()


def test_the_page_asks_with_its_secret(server: PageServer) -> None:
    """Only this machine is listened to. The address ends with the secret, which the browser does not send on its own."""
    assert server.server_address[0] == "127.0.0.1"
    assert server.url.endswith(f"/#{server.secret}")
    assert len(server.secret) >= 24
    known = {"X-Magmpm-Secret": server.secret}
    assert ask(server, "POST", "/echo", '{"a": 1}', **known) == (200, b'{"asked": {"a": 1}}')
    assert ask(server, "POST", "/refuse", "null", **known) == (400, b'{"error": "not so"}')
    assert ask(server, "POST", "/echo", "{}")[0] == 403
    assert ask(server, "POST", "/echo", "{}", **{"X-Magmpm-Secret": "wrong"})[0] == 403


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1.evil.example"},
        {"Host": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
    ],
)
def test_other_names_are_not_answered(server: PageServer, headers: dict[str, str]) -> None:
    """A page elsewhere whose name leads to this machine (DNS rebinding) is another host; another page's script, another origin."""
    assert (
        ask(server, "POST", "/echo", "{}", **{"X-Magmpm-Secret": server.secret}, **headers)[0]
        == 403
    )
    assert ask(server, "GET", "/", **headers)[0] == 403


@pytest.mark.parametrize(
    ("host", "names", "others"),
    [
        (
            "0.0.0.0",
            ["127.0.0.1", "localhost:9000"],
            ["evil.example", "10.9.8.7", "lab.example"],
        ),  # 9000: by ssh -L
        (
            "0.0.0.0,lab.example",
            ["127.0.0.1:8090", "lab.example:80", "LAB.example"],
            ["evil.example"],
        ),
        ("127.0.0.2", ["127.0.0.2"], ["evil.example"]),
    ],
)
def test_with_a_host_the_names_given_are_checked(
    host: str, names: list[str], others: list[str]
) -> None:
    """Everywhere: addresses at which the request arrived, this machine's name, and names given."""
    with serving(host) as running:
        asked = running.server_address[0] if host == "127.0.0.2" else "127.0.0.1"
        for name, status in [(name, 200) for name in names] + [(name, 403) for name in others]:
            connection = http.client.HTTPConnection(asked, running.server_port, timeout=10)
            connection.request(
                "POST", "/echo", "1", {"X-Magmpm-Secret": running.secret, "Host": name}
            )
            assert connection.getresponse().status == status, name


@pytest.mark.parametrize(
    "begin", [b"", b"GET / HT", b"POST /echo HTTP/1.1\r\nHost: localhost\r\nContent-Le", "body"]
)
def test_half_open_connections_are_closed(
    server: PageServer, begin: bytes | str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also those that send a byte now and then: the time counts from the beginning of the request."""
    monkeypatch.setattr("magmpm.inputs.page_guard.SECONDS_OF_REQUEST", 0.5)
    if begin == "body":
        begin = (
            "POST /echo HTTP/1.1\r\nHost: localhost\r\nX-Magmpm-Secret:"
            f" {server.secret}\r\nContent-Length: 900\r\n\r\n1".encode()
        )
    assert isinstance(begin, bytes)
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as half:
        half.sendall(begin)
        begun = time.monotonic()
        with suppress(OSError):
            while time.monotonic() < begun + 8:
                half.sendall(b"x" if begin else b"")
                half.settimeout(0.1)
                with suppress(TimeoutError):
                    while half.recv(1000):
                        pass
                    break
        assert time.monotonic() - begun < 5


def test_connections_are_few(server: PageServer) -> None:
    """A hundred that ask nothing leave room for one that does, and not a hundred threads."""
    from magmpm.inputs.page_guard import MOST_CONNECTIONS, SECONDS_OF_REQUEST

    assert 10 <= SECONDS_OF_REQUEST <= 30
    before = threading.active_count()
    with ExitStack() as opened:
        for _ in range(MOST_CONNECTIONS + 40):
            opened.enter_context(
                socket.create_connection(("127.0.0.1", server.server_port), timeout=10)
            )
        assert ask(server, "POST", "/echo", "1", **{"X-Magmpm-Secret": server.secret})[0] == 200
        until = time.monotonic() + 10
        while threading.active_count() > before + MOST_CONNECTIONS and time.monotonic() < until:
            time.sleep(0.05)  # threads of closed connections end
        assert threading.active_count() <= before + MOST_CONNECTIONS


def test_a_fault_of_ours_is_answered(server: PageServer) -> None:
    """Not by a closed connection."""
    server.routes = {"echo": lambda asked: {"asked": 1 / asked}}
    status, content = ask(server, "POST", "/echo", "0", **{"X-Magmpm-Secret": server.secret})
    assert status == 500
    assert "ZeroDivisionError" in json.loads(content)["error"]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ('{"field.uniform[2]": 99999}', "field Bz: 99 999 mT\n"),
        ('{"field.uniform[0]": 1, "field.uniform[2]": -99999.5}', "field Bz: -99 999.5 mT\n"),
        ('{"inserted": -3}', "length outside the guide length: -3 mm\n"),
        ('{"field.uniform[2]": 1' + 400 * "0" + "}", "field Bz: received 1000"),
        ('{"field.uniform[2]": true}', "field Bz: received True"),
    ],
)
def test_a_wrong_number_is_told_with_its_slider_and_unit(
    server: PageServer, values: str, words: str
) -> None:
    """Also one of 401 digits."""
    from magmpm import load_scene
    from magmpm.studies.explore.live import changed, checked, controls

    scene = load_scene(FIVE)
    known = {control.id: control for control in controls(scene)}
    server.routes = {
        "solve": lambda asked: {
            "hash": changed(scene, known, checked(known, asked["values"])).hash()
        }
    }
    status, content = ask(
        server, "POST", "/solve", f'{{"values": {values}}}', **{"X-Magmpm-Secret": server.secret}
    )
    assert status == 400
    assert json.loads(content)["error"].startswith(words)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/", 200),
        ("/main.js", 200),
        ("/../server.py", 404),
        ("/%2e%2e/server.py", 404),
        ("/nothing.js", 404),
        ("//etc/passwd", 404),
    ],
)
def test_files_of_the_page_and_no_others(server: PageServer, path: str, status: int) -> None:
    assert ask(server, "GET", path)[0] == status


@pytest.mark.parametrize(
    ("body", "length", "status"),
    [
        ("{", None, 400),
        ("[" * 100_000, None, 400),
        ("{}", "99999999999", 413),
        ("{}", "-1", 413),
        ("{}", "x", 413),
        ("{}", "2000000", 413),
    ],
)
def test_nonsense_is_refused(
    server: PageServer, body: str, length: str | None, status: int
) -> None:
    headers = {"X-Magmpm-Secret": server.secret} | (
        {} if length is None else {"Content-Length": length}
    )
    assert ask(server, "POST", "/echo", body, **headers)[0] == status
    assert (
        ask(server, "POST", "/echo", "1", **{"X-Magmpm-Secret": server.secret})[0] == 200
    )  # it goes on


def test_a_port_in_use_is_refused(server: PageServer) -> None:
    with pytest.raises(InputError, match="--port"):
        PageServer({}, port=server.server_port)


def test_messages_hold_their_arrays() -> None:
    """Read as the page reads them."""
    points = np.arange(6.0).reshape(2, 3)
    message = packed(
        {"rms": float("nan"), "word": "ü"},
        {"points": points, "triangles": np.array([[0, 1, 1]], np.int32)},
    )
    (length,) = struct.unpack("<I", message[:4])
    header = json.loads(message[4 : 4 + length])
    assert length % 4 == 0
    assert header["rms"] is None
    assert [(one["name"], one["kind"], one["count"]) for one in header["arrays"]] == [
        ("points", "f", 6),
        ("triangles", "u", 3),
    ]
    np.testing.assert_array_equal(np.frombuffer(message, "<f4", 6, 4 + length), points.ravel())
    np.testing.assert_array_equal(np.frombuffer(message, "<u4", 3, 4 + length + 24), [0, 1, 1])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--port", "70000"], "--port"),
        (["--cells", "1"], "--cells"),
        (["--target", "nothing.csv"], "nothing.csv"),
        (["--out", "/proc/nope"], "the folder must be writable"),
    ],
)
def test_wrong_options_are_refused(arguments: list[str], words: str, told) -> None:
    """With exit status 2, before anything is served."""
    told("view", FIVE, *arguments, status=2, says=words)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,0,0,0\n30,30,0,0\n60,58,0,8\n", "must not exceed the catheter's length, 40 mm"),
        ("0,0,0,0\n10,10,0,0\n20,19,0,4\n", None),  # of the half next to the base
        ("0,0,0,0\n20,20,0,0\n40,90,0,0\n", "points must not be further apart"),
    ],
)
def test_a_target_must_be_one_of_this_body(
    rows: str, words: str | None, tmp_path: Path, told
) -> None:
    """As `design` refuses it: the distance from another body's shape would be a number without a meaning."""
    path = tmp_path / "target.csv"
    path.write_text("s_mm,x_mm,y_mm,z_mm\n" + rows)
    if words is None:
        read, name = _target(path, load_scene(FIVE))
        assert (len(read), name) == (3, "target")
    else:
        told("view", FIVE, "--target", path, status=2, says=(f"--target: {path}", words, "remedy:"))


def test_a_folder_that_cant_be_written_leaves_nothing_behind(tmp_path: Path) -> None:
    refuse_unwritable(tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def test_threads_end_with_the_server(server: PageServer) -> None:
    """Two at once: the page asks for a preview and a solution together."""

    def one(_: int) -> int:
        return ask(server, "POST", "/echo", "1", **{"X-Magmpm-Secret": server.secret})[0]

    with ThreadPoolExecutor(8) as threads:
        answers = list(threads.map(one, range(8)))
    assert answers == [200] * 8
