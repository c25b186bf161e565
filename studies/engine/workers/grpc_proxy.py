"""Serves a database of trials to sessions on other machines by Optuna's gRPC proxy: they need neither its driver nor its password.

    MAGMPM_STORAGE=postgresql://user:password@host/name python -m magmpm.studies.engine.workers.grpc_proxy --port 13000

gRPC is not encrypted here, and asks for no password: bind it to an address that only your own machines reach.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import warnings
from collections.abc import Sequence

from magmpm.errors import MagmpmError
from magmpm.studies.engine.storage import CONNECTING, Store, open_storage
from magmpm.studies.engine.storage_url import GRPC_PORT, VARIABLE, given_url, shown_url, storage_url


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until SIGTERM or Ctrl-C.

    Parameters
    ----------
    arguments : sequence of str, optional
        Of the command line; those of this process unless given.

    Returns
    -------
    int
        The exit status.
    """
    parser = argparse.ArgumentParser(
        prog="python -m magmpm.studies.engine.workers.grpc_proxy",
        description=__doc__,
        allow_abbrev=False,
    )
    parser.add_argument("--storage", metavar="URL", help=f"the database [the variable {VARIABLE}]")
    parser.add_argument(
        "--host", default="localhost", help="address to listen on [localhost: this machine alone]"
    )
    parser.add_argument(
        "--port", type=int, default=GRPC_PORT, help=f"port to listen on [{GRPC_PORT}]"
    )
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        given = given_url(options.storage, os.environ)
        if given is None:
            parser.error(f"name the database: --storage URL, or the variable {VARIABLE}")
        url = storage_url(None, given)
        storage = Store(url, CONNECTING, 0.0, print)(lambda: open_storage(url))
    except MagmpmError as error:
        print(f"magmpm: {error}", file=sys.stderr)
        return error.exit_status
    from optuna.storages import run_grpc_proxy_server

    print(
        f"grpc://{options.host}:{options.port} serves {shown_url(url)}; Ctrl-C ends it",
        file=sys.stderr,
        flush=True,
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "experimental"
            run_grpc_proxy_server(storage, host=options.host, port=options.port)
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
