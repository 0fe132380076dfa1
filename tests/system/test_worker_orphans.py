"""A station that is killed leaves no worker behind, whatever its plug-ins are doing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from worker_rig import write_plugins

STATION = """
import sys
from pathlib import Path
sys.path.insert(0, {here!r})
from worker_rig import Rig
with Rig(Path({folder!r}), Path({plugins!r}), count=2) as rig:
    answers = [rig.submit("sleeps"), rig.submit("sleeps")]
    assert rig.until(lambda: all(answer.progress for answer in answers))
    print(*(state.pid for state in rig.supervisor.states()), flush=True)
    rig.until(lambda: False, 60)
"""


def alive(pid: int) -> bool:
    try:
        return ") Z" not in Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False


def test_killed_station_leaves_no_worker(tmp_path):
    plugins = write_plugins(tmp_path / "plugins", "sleeps")
    here = str(Path(__file__).parent)
    code = STATION.format(here=here, folder=str(tmp_path), plugins=str(plugins))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as station:
        pids = [int(pid) for pid in station.stdout.readline().split()]
        assert len(pids) == 2
        assert all(alive(pid) for pid in pids)
        os.kill(station.pid, signal.SIGKILL)
        station.wait(10)
    deadline = time.monotonic() + 5
    while any(alive(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not [pid for pid in pids if alive(pid)]
