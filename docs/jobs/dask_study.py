"""A study on a Dask cluster: each task is a session with its own workers; the database is shared.

    MAGMPM_STORAGE=postgresql://... python docs/jobs/dask_study.py STUDY [--scheduler ADDRESS] [--sessions N] [--workers N] [--out DIR]

Without an address the cluster is this machine. Every Dask worker needs magmpm, the study's files, and MAGMPM_STORAGE in its environment:
the password travels in no task.
"""

from __future__ import annotations

import argparse
import subprocess
import sys


def session(study: str, out: str, workers: int) -> tuple[int, str]:
    """Run a session to its end. Returns its exit status and what it said."""
    command = [
        sys.executable,
        "-m",
        "magmpm.cli",
        "design",
        study,
        "--workers",
        str(workers),
        "--out",
        out,
        "--no-pictures",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def main() -> int:
    """Submit the sessions and wait for them. Returns 0 if one ended well: it has seen the whole study."""
    from dask.distributed import Client, LocalCluster, as_completed

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("study")
    parser.add_argument(
        "--scheduler", help="address of a Dask scheduler [a cluster on this machine]"
    )
    parser.add_argument("--sessions", type=int, default=2)
    parser.add_argument("--workers", type=int, default=1, help="processes of each session")
    parser.add_argument("--out", default="runs/dask")
    options = parser.parse_args()
    cluster = (
        None
        if options.scheduler
        else LocalCluster(n_workers=options.sessions, threads_per_worker=1, dashboard_address=None)
    )
    client = Client(options.scheduler or cluster)
    folders = [f"{options.out}-{k}" for k in range(options.sessions)]
    tasks = [
        client.submit(session, options.study, folder, options.workers, pure=False)
        for folder in folders
    ]
    statuses = []
    for _, (status, said) in as_completed(tasks, with_results=True):
        statuses.append(status)
        print(said)
    client.close()
    if cluster is not None:
        cluster.close()
    return 0 if 0 in statuses else max(abs(status) for status in statuses)


if __name__ == "__main__":
    sys.exit(main())
