"""`python -m fringed.workers`: one worker, local (started by the supervisor) or remote (started by hand).

Owns the process's set-up: its allocator, its parent's death, its log, its socket.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import logging
import os
import signal
import socket as network
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fringed.kernels import forget_stale_kernels
from fringed.workers.blackbox import BlackBox
from fringed.workers.memory import keep_freed_pages

if TYPE_CHECKING:
    import zmq

EXIT_STATION_GONE = 3
_PR_SET_PDEATHSIG = 1
_OOM_SCORE = "500"  # when the machine runs out of memory, it takes a worker, not the daemon


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fringed.workers", description=__doc__)
    parser.add_argument("--endpoint", required=True, help="the station's work socket, such as tcp://station:7603")
    parser.add_argument("--name", default=f"{network.gethostname()}-{os.getpid()}", help="shown in `fringe status`")
    parser.add_argument("--threads", type=int, default=0, help="threads of a plug-in; 0: one per core")
    parser.add_argument("--memory-mb", type=int, default=1800, help="leave when a job leaves more than that in use")
    parser.add_argument("--plugin-folder", type=Path, action="append", default=[], help="also load *.py of that folder")
    parser.add_argument("--server-key", type=Path, help="the station's public CURVE key file, for tcp://")
    parser.add_argument("--secret-key", type=Path, help="this worker's secret CURVE key file, for tcp://")
    parser.add_argument("--log-level", default="info", choices=["debug", "info", "warning", "error"])
    parser.add_argument("--no-warm-up", action="store_true", help="do not run plug-ins' warm_up")
    parser.add_argument("--skip", action="append", default=[], metavar="NAME=REASON", help="do not load that plug-in")
    parser.add_argument("--parent", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--box", type=int, default=-1, help=argparse.SUPPRESS)
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run one worker until its station sends it home; return the exit status."""
    args = _arguments(argv)
    logging.basicConfig(level=args.log_level.upper(), format="%(levelname)s %(name)s: %(message)s")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the station's affair, which sends workers home
    if args.parent:
        _die_with(args.parent)
    threads = args.threads or len(os.sched_getaffinity(0))
    _limit_threads(threads)
    keep_freed_pages(256)
    _forget_stale_kernels()
    return _serve(args, threads)


def _forget_stale_kernels() -> None:
    """Before any kernel is read from disk."""
    found = importlib.util.find_spec("fringed_plugins")  # which imports nothing
    if found is not None and found.origin:
        forget_stale_kernels(Path(found.origin).parent)


def _serve(args: argparse.Namespace, threads: int) -> int:
    import zmq  # only now: NumPy's and ZeroMQ's threads read what was set above

    from fringed.workers.host import Host, HostOptions
    from fringed.workers.link import Link

    note = BlackBox(args.box).write if args.box >= 0 else (lambda _: None)
    context = zmq.Context()
    link = Link(_connected(context, args), args.name, _leave)
    link.start()
    skip = dict(item.partition("=")[::2] for item in args.skip)
    folders = tuple(args.plugin_folder)
    local = args.endpoint.startswith("ipc:")  # through a network, frames would delay what else the station sends
    options = HostOptions(args.name, threads, args.memory_mb, folders, skip, not args.no_warm_up, feeds=local)
    Host(options, link, note).run()
    context.destroy(linger=2000)
    return 0


def _connected(context: zmq.Context[zmq.Socket[bytes]], args: argparse.Namespace) -> zmq.Socket[bytes]:
    import zmq
    import zmq.auth

    socket = context.socket(zmq.DEALER)
    socket.setsockopt(zmq.IDENTITY, args.name.encode())
    socket.setsockopt(zmq.SNDHWM, 0)
    socket.setsockopt(zmq.RCVHWM, 0)
    if args.server_key and args.secret_key:
        socket.curve_serverkey, _ = zmq.auth.load_certificate(args.server_key)
        socket.curve_publickey, secret = zmq.auth.load_certificate(args.secret_key)
        if secret is None:
            sys.exit(f"{args.secret_key} holds no secret key; give the file that ends in .key_secret")
        socket.curve_secretkey = secret
    socket.connect(args.endpoint)
    return socket


def _die_with(parent: int) -> None:
    """Have the kernel end this process together with the daemon, whatever ends that."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(EXIT_STATION_GONE)  # it died before prctl
    try:
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE)
    except OSError:
        logging.getLogger(__name__).debug("the kernel does not let this process volunteer for the OOM killer")


def _limit_threads(threads: int) -> None:
    """Tell libraries that start threads of their own; those in use read the environment when they load."""
    for name in ("OMP", "OPENBLAS", "MKL", "NUMBA", "NUMEXPR"):
        os.environ.setdefault(f"{name}_NUM_THREADS", str(threads))
    os.environ.setdefault("OPENCV_FOR_THREADS_NUM", str(threads))


def _leave(reason: str) -> None:
    logging.getLogger(__name__).error("leaving: %s", reason)
    logging.shutdown()
    os._exit(EXIT_STATION_GONE)  # the main thread may be deep in a plug-in and nobody is left to answer


if __name__ == "__main__":
    sys.exit(main())
