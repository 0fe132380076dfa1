"""The unit's filter of system calls, in force: what the daemon and its workers are made of has to run under it."""

from __future__ import annotations

import ctypes.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

UNIT = Path(__file__).resolve().parents[3] / "udev" / "fringed.service"
IN_FORCE = """
import ctypes, json, sys
library = ctypes.CDLL(sys.argv[1])
library.seccomp_init.restype = ctypes.c_void_p
library.seccomp_rule_add.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int, ctypes.c_uint]
library.seccomp_load.argtypes = [ctypes.c_void_p]
context = library.seccomp_init(0x00050000 | 1)  # EPERM for what is not allowed
for name in json.loads(sys.argv[2]):
    number = library.seccomp_syscall_resolve_name(name.encode())
    if number >= 0:
        assert library.seccomp_rule_add(context, 0x7FFF0000, number, 0) == 0, name
assert library.seccomp_load(context) == 0
exec(sys.argv[3])
"""
REFUSED = "import os\ntry:\n    os.chroot('/')\nexcept PermissionError:\n    print('refused')\n"
WORK = """
import os, subprocess, sys, tempfile, threading
os.environ |= {"SDL_VIDEODRIVER": "dummy", "PYGAME_HIDE_SUPPORT_PROMPT": "1"}
import h5py, numba, numpy, pygame, zmq
context = zmq.Context()
server, client = context.socket(zmq.ROUTER), context.socket(zmq.DEALER)
with tempfile.TemporaryDirectory() as folder:
    server.bind(f"ipc://{folder}/s"); client.connect(f"ipc://{folder}/s")
    client.send(b"frame"); assert server.recv_multipart()[1] == b"frame"
    with h5py.File(f"{folder}/f.h5", "w") as file:
        file["x"] = numpy.ones((300, 300)) @ numpy.ones((300, 300))
context.destroy(linger=0)
assert numba.njit(lambda x: x + 1)(1) == 2
pygame.display.init(); pygame.display.set_mode((64, 64)); pygame.display.flip(); pygame.quit()
assert subprocess.run([sys.executable, "-c", "print(1)"], capture_output=True).stdout == b"1\\n"
thread = threading.Thread(target=print, args=("worked",)); thread.start(); thread.join()
"""


def members(name: str) -> set[str]:
    """Return the system calls of one of systemd's sets, or the one of that name."""
    if not name.startswith("@"):
        return {name}
    command = [str(shutil.which("systemd-analyze")), "syscall-filter", "--no-pager", name]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    words = {line.strip() for line in lines[1:] if line.strip() and not line.strip().startswith("#")}
    return set().union(*(members(word) for word in words))


def allowed() -> set[str]:
    """Return what the unit allows: its lines in their order, `~` taking away."""
    found = members("@default")
    for line in UNIT.read_text().splitlines():
        if line.startswith("SystemCallFilter="):
            names = line.partition("=")[2]
            listed = set().union(*(members(name) for name in names.lstrip("~").split()))
            found = found - listed if names.startswith("~") else found | listed
    return found


def under(calls: set[str], code: str) -> subprocess.CompletedProcess[str]:
    library = ctypes.util.find_library("seccomp")
    if library is None:
        pytest.skip("libseccomp is not installed here")
    command = [sys.executable, "-c", IN_FORCE, library, json.dumps(sorted(calls)), code]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)


@pytest.fixture(scope="module")
def calls():
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed here")
    return allowed()


def test_sockets_compiler_files_window_and_processes_work(calls):
    done = under(calls, WORK)
    assert (done.returncode, done.stdout) == (0, "worked\n"), done.stderr


def test_filter_is_in_force(calls):
    assert under(calls, REFUSED).stdout == "refused\n"


def test_zeromq_needs_what_the_unit_gives_back(calls):
    done = under(calls - {"sched_setscheduler"}, WORK)
    assert done.returncode != 0 and "Operation not permitted" in done.stderr
