"""Real workers with plug-ins that misbehave in every way: only the job that misbehaves is hurt."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
import zmq
from worker_rig import FAULTS, Rig, frame_set, write_plugins

from fringed import wire
from fringed.errors import Quarantined
from fringed.messages import ErrorInfo, Request, WorkerReady
from fringed.workers.jobs import Limits


def members(group: int) -> list[int]:
    """Return the live processes of a process group."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = path.read_text().rpartition(") ")[2].split()[:3]
        except OSError:  # it just ended
            continue
        if int(its_group) == group and state != "Z":
            found.append(int(path.parent.name))
    return found


@pytest.fixture(scope="module")
def plugins(tmp_path_factory) -> Path:
    return write_plugins(tmp_path_factory.mktemp("toys") / "plugins", *FAULTS)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("exits", "exited with status 7 in stage s0-exits"),
        ("null", "was killed by SIGSEGV in stage s0-null"),
        ("sleeps", "took longer than 0.6 s in stage s0-sleeps"),
        ("polite", "took longer than the 0.6 s"),
        ("leaks", "over the 400 MB of workers.memory_mb"),
        ("hoards", "MB after stage 's0-hoards'; workers.memory_mb is 400"),
        ("raises", "raised RuntimeError: the plug-in is broken"),
        ("quits", "raised SystemExit: 3"),
        ("wrong", "returned a int; it declares PhaseMap"),
        ("forks", "exited with status 1"),
    ],
)
def test_fault_is_retried_then_quarantined_while_others_go_on(fault, reason, plugins, tmp_path):
    limits = Limits(attempts=2, cancel_grace_s=0.2)
    with Rig(tmp_path, plugins, limits, count=2, memory_mb=400) as rig:
        bad = rig.submit(fault, timeout_s=0.6 if fault in {"sleeps", "polite"} else 60.0)
        others = [rig.submit("good", pipeline="other") for _ in range(3)]
        rig.wait(bad, *others)
        assert [answer.ends for answer in others] == [["done"]] * 3
        assert bad.ends == ["failed"]
        assert bad.quarantined
        assert bad.stages == []
        [entry] = rig.dispatcher.quarantine.entries
        assert reason in entry.reason
        assert entry.attempts == 2
        assert rig.dispatcher.counters["jobs_retried"] == 1
        rig.wait(rig.submit("good", pipeline="other"))


def test_what_a_plugin_started_ends_with_its_worker(plugins, tmp_path):
    with Rig(tmp_path, plugins, Limits(attempts=1), count=1) as rig:
        assert rig.until(lambda: rig.supervisor.states()[0].state == "idle")
        group = rig.supervisor.states()[0].pid
        rig.wait(rig.submit("forks"))
        assert rig.until(lambda: not members(group))


def test_quarantined_set_is_refused_and_allowed_again(plugins, tmp_path):
    frames = frame_set()
    with Rig(tmp_path, plugins, Limits(attempts=1), count=1) as rig:
        rig.wait(rig.submit("raises", given={"object": frames}))
        with pytest.raises(Quarantined, match=frames.id):
            rig.submit("raises", given={"object": frames})
        rig.dispatcher.quarantine.clear(frames.id)
        again = rig.submit("good", given={"object": frames})
        rig.wait(again)
        assert again.ends == ["done"]


def test_products_come_last_stage_first_and_only_those_kept(plugins, tmp_path):
    with Rig(tmp_path, plugins, count=1) as rig:
        kept = rig.submit("good", "chats", "good")
        rig.wait(kept)
        assert [done.stage for done in kept.stages] == ["s2-good", "s0-good", "s1-chats"]
        assert all(done.product.scan == "scan-1" for done in kept.stages)
        assert any(p.level == "warning" and p.text == "careful" for p in kept.progress)
        dropped = rig.submit("good", keep=False)
        rig.wait(dropped)
        assert [done.product for done in dropped.stages] == [None]


@pytest.mark.parametrize(
    ("plugin", "more", "code", "text"),
    [
        ("good", {"params": {"value": 77, "colour": 1}}, "ConfigurationError", "2 problems"),
        ("good", {"inputs": {"frames": "nowhere"}}, "DataError", "there is: object"),
        ("nonsense", {}, "NotFound", "there are chats"),
    ],
)
def test_request_that_cannot_be_meant_fails_at_once(plugin, more, code, text, plugins, tmp_path):
    with Rig(tmp_path, plugins, count=1) as rig:
        answer = rig.submit(plugin, **more)
        rig.wait(answer)
        assert answer.error.code == code
        assert text in answer.error.message
        assert not answer.quarantined
        assert rig.dispatcher.counters["attempts_failed"] == 0


def test_cancelled_job_stops_and_its_worker_lives_on(plugins, tmp_path):
    with Rig(tmp_path, plugins, Limits(cancel_grace_s=10.0), count=1) as rig:
        answer = rig.submit("polite")
        assert rig.until(lambda: answer.progress)
        before = rig.supervisor.states()[0].pid
        assert rig.work.cancel(rig.dispatcher.active[0])
        rig.wait(answer)
        assert answer.error.code == "Cancelled"
        assert rig.supervisor.states()[0].pid == before


def test_plugin_that_kills_its_worker_while_loading_is_left_out(tmp_path):
    folder = write_plugins(tmp_path / "plugins", "good")
    (folder / "deadly.py").write_text("import os\nos._exit(9)\n")
    with Rig(tmp_path, folder, count=1) as rig:
        answer = rig.submit("good")
        rig.wait(answer)
        assert answer.ends == ["done"]
        [deadly] = [info for info in rig.supervisor.plugins() if info.name == "deadly"]
        assert "exited with status 9 while loading plug-in deadly" in deadly.error


def test_warm_up_that_crashes_is_left_out(tmp_path):
    folder = write_plugins(tmp_path / "plugins", "good")
    text = (folder / "toys.py").read_text()
    crash = "    @classmethod\n    def warm_up(cls):\n        os._exit(5)\n"
    (folder / "toys.py").write_text(text.replace("class Base:\n", f"class Base:\n{crash}"))
    with Rig(tmp_path, folder, count=1) as rig:
        assert rig.until(lambda: rig.supervisor.states()[0].restarts == 1 and rig.dispatcher.peers)
        assert "while warming up" in rig.supervisor.states()[0].detail
        answer = rig.submit("good")
        rig.wait(answer)
        assert answer.ends == ["done"]


def test_worker_killed_from_outside_is_replaced(plugins, tmp_path):
    with Rig(tmp_path, plugins, count=1) as rig:
        assert rig.until(lambda: rig.supervisor.states()[0].state == "idle")
        os.kill(rig.supervisor.states()[0].pid, signal.SIGKILL)
        answer = rig.submit("good")
        rig.wait(answer)
        [state] = rig.supervisor.states()
        assert (answer.ends, state.restarts) == (["done"], 1)
        assert "SIGKILL" in state.detail


def test_stopped_worker_falls_silent_and_its_job_goes_elsewhere(plugins, tmp_path):
    with Rig(tmp_path, plugins, Limits(silence_s=3.0), count=2) as rig:
        assert rig.until(lambda: all(state.state == "idle" for state in rig.supervisor.states()))
        for state in rig.supervisor.states()[:1]:
            os.kill(state.pid, signal.SIGSTOP)
        answers = [rig.submit("good") for _ in range(2)]
        rig.wait(*answers)
        assert [answer.ends for answer in answers] == [["done"]] * 2
        assert rig.until(lambda: "silent" in rig.supervisor.states()[0].detail)


def test_malformed_messages_are_counted_and_answered_and_harm_nobody(plugins, tmp_path):
    with Rig(tmp_path, plugins, count=1) as rig:
        stranger = rig.context.socket(zmq.DEALER)
        stranger.setsockopt(zmq.SNDHWM, 0)  # this thread has to serve them too
        stranger.connect(f"ipc://{tmp_path}/work")
        nonsense = [[b""], [b"", b"{}"], [b"", b"\xff" * 40, b"x"], wire.encode(Request("1", "status"))]
        nonsense += [[os.urandom(9), os.urandom(60)] for _ in range(10_000)]
        for message in nonsense:
            stranger.send_multipart(message)
        stranger.send_multipart(wire.encode(WorkerReady("x", 1, 0, schemas={"processor": 3})))
        answer = rig.submit("good")
        rig.wait(answer)
        assert rig.until(lambda: rig.dispatcher.counters["malformed"] == len(nonsense))
        assert stranger.poll(2000)
        assert isinstance(wire.decode(stranger.recv_multipart()).content, ErrorInfo)
        stranger.close(linger=0)
        assert answer.ends == ["done"]
        assert rig.reactor.failures == 0


def test_stop_leaves_no_process_even_when_a_plugin_sleeps(plugins, tmp_path):
    rig = Rig(tmp_path, plugins, Limits(), count=2)
    with rig:
        answer = rig.submit("sleeps")
        assert rig.until(lambda: answer.progress)
        pids = [state.pid for state in rig.supervisor.states()]
        begun = time.monotonic()
    assert time.monotonic() - begun < 5
    assert not [pid for pid in pids if pid and Path(f"/proc/{pid}").exists()]


def test_reload_loads_changed_plugins_with_another_number_of_workers(tmp_path):
    folder = write_plugins(tmp_path / "plugins", "good")
    with Rig(tmp_path, folder, count=1) as rig:
        assert rig.until(lambda: len(rig.dispatcher.peers) == 1)
        write_plugins(tmp_path / "plugins", "good", "chats")
        for count in (3, 1):
            rig.supervisor.reload(time.monotonic(), replace(rig.supervisor.options, count=count))
            before = {state.pid for state in rig.supervisor.states()}
            assert rig.until(lambda n=count, old=before: settled(rig, n, old))
        answer = rig.submit("chats")
        rig.wait(answer)
        assert answer.ends == ["done"]


def settled(rig: Rig, count: int, before: set[int]) -> bool:
    states = rig.supervisor.states()
    new = [state for state in states if state.state == "idle" and state.pid not in before]
    return len(states) == len(new) == len(rig.dispatcher.peers) == count
