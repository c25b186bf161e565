"""Storage of trials, as a URL: which ones can be used, and how they are shown. Passwords never are."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from magmpm.errors import InputError, installed
from magmpm.studies.problem import DATABASE

if TYPE_CHECKING:
    from sqlalchemy.engine import URL


VARIABLE = "MAGMPM_STORAGE"  # an environment variable that names the storage, password and all
GRPC = "grpc://"
GRPC_PORT = 13000  # Optuna's
HIDDEN = "***"
_IN_FRONT = re.compile(r"^(?P<before>[^:/?#\s]+://[^:/?#@]*:)(?P<password>.*)@", re.DOTALL)
_IN_QUERY = re.compile(
    r"(?P<before>[?&;][^=&;]*(?:pass|pwd|secret|token|key)[^=&;]*=)(?P<password>[^&;\s]*)",
    re.IGNORECASE,
)


def storage_url(out: Path | None, url: str | None) -> str:
    """Find the storage's URL. postgresql://... is served by psycopg, version 3, unless the URL names another driver.

    Parameters
    ----------
    out : Path or None
        The study's folder, or None.
    url : str or None
        As it is given, or None.

    Returns
    -------
    str
        As given, or that of OUT/study.db.

    Raises
    ------
    InputError
        If it is not a URL.
    """
    if url is None:
        return f"sqlite:///{((out or Path()) / DATABASE).resolve()}"
    if "://" not in url:
        from sqlalchemy.engine import make_url

        rule = "must be the URL of a database"
        file = f"sqlite:///{url}"
        if re.search(
            r"[=@;\s]", url
        ):  # another way to say it, such as libpq's, which may hold a password
            raise InputError(
                "--storage",
                received="a text without ://, not shown for what it may hold",
                rule=rule,
                remedy=f"write, say, sqlite:///{DATABASE} or postgresql://USER@HOST/DATABASE",
            )
        raise InputError(
            "--storage",
            received=url or "nothing",
            rule=rule,
            remedy=f"write, say, {f'sqlite:///{DATABASE}' if in_memory(make_url(file)) else file}",
        )
    password = _IN_FRONT.match(url.partition("?")[0])
    if (
        not url.startswith("sqlite")
        and password is not None
        and re.search(r"[@/#]", password["password"])
    ):  # a driver would report it
        raise InputError(
            "--storage",
            received=shown_url(url),
            rule="the signs @ / ? # end a password, so it is written without them",
            remedy="write %40 for @, %2F for /, %3F for ?, %23 for #",
        )
    for plain in ("postgresql://", "postgres://"):
        if url.startswith(plain) and not installed("psycopg2"):
            return "postgresql+psycopg://" + url.removeprefix(plain)
    return url


def known_url(saved: str, option: str | None, environment: Mapping[str, str]) -> str | None:
    """Find the storage of a saved study.

    Parameters
    ----------
    saved : str
        As its report says.
    option : str or None
        Of --storage, or None.
    environment : Mapping[str, str]
        Has MAGMPM_STORAGE where the report hides a password.

    Returns
    -------
    str or None
        The URL; None: unknown.

    Raises
    ------
    InputError
        For a password on the command line, and for what is no URL.
    """
    given = given_url(option, {})
    if given is None and HIDDEN in saved:
        given = environment.get(VARIABLE) or None
        if given is None:
            return None
    return saved if given is None else storage_url(None, given)


def given_url(option: str | None, environment: Mapping[str, str]) -> str | None:
    """Find the storage that a command is given.

    Parameters
    ----------
    option : str or None
        Of --storage, or None.
    environment : Mapping[str, str]
        May have MAGMPM_STORAGE.

    Returns
    -------
    str or None
        The URL, or None.

    Raises
    ------
    InputError
        For a password on the command line.
    """
    if option is not None and passwords(option):
        remedy = (
            f"put the whole URL into the environment variable {VARIABLE}, or leave the password to"
            " PGPASSWORD or ~/.pgpass"
        )
        raise InputError(
            "--storage",
            received=shown_url(option),
            rule="everybody on this machine can read a command line, and with it the password (ps)",
            remedy=remedy,
        )
    return option if option is not None else environment.get(VARIABLE) or None


def passwords(url: str) -> list[str]:
    """Find the passwords in a URL, as they stand there.

    Parameters
    ----------
    url : str
        The URL.

    Returns
    -------
    list of str
        The passwords.
    """
    found = [
        match["password"]
        for match in (_IN_FRONT.match(url), *_IN_QUERY.finditer(url))
        if match is not None
    ]
    return [password for password in found if password]


def shown_url(url: str) -> str:
    """Write a URL without its passwords, for messages and reports.

    Parameters
    ----------
    url : str
        The URL.

    Returns
    -------
    str
        The text.
    """
    front = _IN_FRONT.sub(lambda match: f"{match['before']}{HIDDEN}@", url, count=1)
    return _IN_QUERY.sub(lambda match: match["before"] + HIDDEN, front)


def without_passwords(text: str, url: str) -> str:
    """Take the passwords of a URL out of a text, such as a driver's message.

    Parameters
    ----------
    text : str
        The text.
    url : str
        The URL.

    Returns
    -------
    str
        The text without them.
    """
    for password in passwords(url):
        for form in {password, unquote(password)}:
            text = text.replace(form, HIDDEN)
    return text


def is_server(url: str) -> bool:
    """Tell whether a storage is a server, which may be away for a while, and which other machines may use as well.

    Parameters
    ----------
    url : str
        Of the storage.

    Returns
    -------
    bool
        True if it is.
    """
    return not url.startswith("sqlite")


def sqlite_file(url: str) -> Path | None:
    """Find the file of an SQLite database.

    Parameters
    ----------
    url : str
        Of the storage.

    Returns
    -------
    Path or None
        The file; None for another database.
    """
    if is_server(url):
        return None
    from sqlalchemy.engine import make_url

    return Path(str(make_url(url).database)).absolute()


def grpc_address(url: str) -> tuple[str, int]:
    """Read the address grpc://HOST:PORT.

    Parameters
    ----------
    url : str
        The address.

    Returns
    -------
    host : str
        The host.
    port : int
        The port.

    Raises
    ------
    InputError
        For another address.
    """
    match = re.fullmatch(
        r"grpc://(?P<host>\[[0-9a-fA-F:]+\]|[\w.-]+)(?::(?P<port>[0-9]{1,5}))?/?", url
    )
    if match is None or not 0 < int(match["port"] or GRPC_PORT) < 65536:
        raise InputError(
            "--storage",
            received=shown_url(url),
            rule="must be grpc://HOST:PORT, as of Optuna's gRPC proxy",
            remedy=f"write, say, grpc://localhost:{GRPC_PORT}",
        )
    return match["host"], int(match["port"] or GRPC_PORT)


def in_memory(parts: URL) -> bool:
    """Tell whether SQLite holds a database in memory, by any of its names (sqlite.org/inmemorydb.html), or in a file that goes with it.

    Parameters
    ----------
    parts : URL
        The URL, parsed.

    Returns
    -------
    bool
        True if it does.
    """
    name = parts.database or ""
    options = (parts.query.get("mode") == "memory", parts.query.get("vfs") == "memdb")
    return name in ("", ":memory:", "file:") or name.startswith("file::memory:") or any(options)


def refuse_memory(parts: URL, url: str) -> None:
    """Refuse a database that would not outlive its process.

    Parameters
    ----------
    parts : URL
        The URL, parsed.
    url : str
        The URL, for messages.

    Raises
    ------
    InputError
        For such a database.
    """
    if parts.get_backend_name() == "sqlite" and in_memory(parts):
        raise InputError(
            "--storage",
            received=shown_url(url),
            rule="a database in memory is lost with its process, and all trials with it",
            remedy=f"name a file, say, --storage sqlite:///{DATABASE}",
        )
