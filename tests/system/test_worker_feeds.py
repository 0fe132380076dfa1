"""Real workers that are fed a set while it is taken, with plug-ins that misbehave meanwhile."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from worker_rig import Answer, Rig, frame_set

from fringed.data import FrameSet, new_id
from fringed.messages import FeedBegin, StageCall
from fringed.workers.jobs import Limits

PLUGIN = """
import ctypes, os, time
import numpy as np
from fringed.data import FrameSet, PhaseMap
from fringed.hookspecs import Params, hookimpl

class Sum:
    version, summary = "1", "toy"
    inputs, optional, output, Params = {"frames": FrameSet}, frozenset(), PhaseMap, Params

    def run(self, inputs, params, context):
        return phase_map(inputs["frames"].frames.sum(axis=0))

    def begin(self, start, params, context):
        return Sink(start.shape, self)

    def at_frame(self, index):
        pass

class Sink:
    def __init__(self, shape, plugin):
        self.total, self.plugin = np.zeros(shape), plugin

    def add(self, index, image):
        self.total += image
        if index == 2:
            self.plugin.at_frame(index)

    def finish(self, frame_set, context):
        context.log("info", "streamed")
        return phase_map(self.total)

def phase_map(plane):
    plane = np.asarray(plane, np.float32)
    return PhaseMap(plane, plane, plane, np.zeros(plane.shape, np.uint16), "wrapped", 16.0)
"""
FAULTS = {
    "good": "pass",
    "crashes": "ctypes.string_at(0)",
    "hangs": "time.sleep(1000)",
    "raises": "raise RuntimeError('no')",
    "exits": "os._exit(3)",
}


@pytest.fixture(scope="module")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("streaming")
    classes = [
        f"class P{i}(Sum):\n    name = {name!r}\n    def at_frame(self, index):\n        {code}\n"
        for i, (name, code) in enumerate(FAULTS.items())
    ]
    names = ", ".join(f"P{i}" for i in range(len(FAULTS)))
    hook = f"@hookimpl\ndef register_processors():\n    return [{names}]\n"
    (folder / "streaming.py").write_text("\n".join([PLUGIN, *classes, hook]))
    return folder


class FedRig(Rig):
    """A rig that plays acquisition too."""

    def idle(self) -> None:
        assert self.until(lambda: all(state.state == "idle" for state in self.supervisor.states()))

    def feed(self, plugin: str, frames: FrameSet, last: int | None = None) -> FrameSet:
        """Feed a set, or its first frames, to whoever begins; return it under the id that it was fed by."""
        feeds = self.dispatcher.feeding._feeds
        for _ in range(100):
            frames = replace(frames, id=new_id())
            self.work.feed_begin(self._begin(plugin, frames))
            self.until(lambda one=frames.id: one not in feeds or feeds[one].taken == 0, 5.0)
            if frames.id in feeds:
                break
        for index in range(len(frames.frames) if last is None else last):
            self.work.feed_frame(frames.id, index, frames.frames[index])
            self.until(lambda: False, 0.02)
        return frames

    @property
    def fed(self) -> list[str]:
        """Who is fed."""
        return [feed.worker for feed in self.dispatcher.feeding._feeds.values()]

    def process(self, plugin: str, frames: FrameSet) -> Answer:
        return self.submit(plugin, given={"object": frames})

    def _begin(self, plugin: str, frames: FrameSet) -> FeedBegin:
        stage = StageCall(f"s0-{plugin}", "processor", plugin)
        height_px, width_px = frames.frames.shape[1:]
        return FeedBegin(
            frames.id, frames.scan, "object", ("object",), (stage,), frames.sequence, frames.settings, height_px,
            width_px,
        )  # fmt: skip


@pytest.fixture
def frames() -> FrameSet:
    images = np.random.default_rng(7).integers(0, 255, (4, 8, 10), np.uint8)
    return replace(frame_set(), frames=images)


def check(answer: Answer, frames: FrameSet, streamed: bool) -> None:
    assert answer.ends == ["done"]
    [done] = answer.stages
    assert np.array_equal(done.product.phase_rad, frames.frames.sum(axis=0))
    assert done.product.provenance.inputs == (frames.id,)
    assert any(progress.text == "streamed" for progress in answer.progress) == streamed


def test_fed_worker_finishes_what_it_began(plugins, tmp_path, frames):
    with FedRig(tmp_path, plugins, count=2) as rig:
        rig.idle()
        for _ in range(3):
            fed = rig.feed("good", frames)
            [worker] = rig.fed
            answer = rig.process("good", fed)
            assert rig.dispatcher.peers[worker].jobs
            rig.wait(answer)
            check(answer, fed, streamed=True)
        assert rig.dispatcher.counters["sets_fed"] == 3
        whole = rig.process("good", frames)
        rig.wait(whole)
        check(whole, frames, streamed=False)


def test_set_that_is_taken_again_is_fed_again(plugins, tmp_path, frames):
    with FedRig(tmp_path, plugins, count=1) as rig:
        rig.idle()
        bad = rig.feed("good", replace(frames, frames=frames.frames[::-1].copy()), last=3)
        rig.work.feed_drop(bad.id, "its set is taken again")
        assert rig.until(lambda: not rig.fed)
        fed = rig.feed("good", frames)
        rig.wait(answer := rig.process("good", fed))
        check(answer, fed, streamed=True)


@pytest.mark.parametrize("fault", ["raises", "crashes", "exits"])
def test_plug_in_that_fails_while_it_is_fed_leaves_the_job_to_its_run(fault, plugins, tmp_path, frames):
    with FedRig(tmp_path, plugins, count=2) as rig:
        rig.idle()
        fed = rig.feed(fault, frames)
        assert fault == "raises" or rig.until(lambda: not rig.fed)
        rig.wait(answer := rig.process(fault, fed))
        check(answer, fed, streamed=False)
        assert rig.dispatcher.counters["attempts_failed"] == 0
        assert rig.dispatcher.counters["workers_lost"] == (fault != "raises")


def test_plug_in_that_hangs_while_it_is_fed_costs_its_worker_and_nothing_else(plugins, tmp_path, frames):
    with FedRig(tmp_path, plugins, Limits(job_timeout_s=3.0, cancel_grace_s=0.3, silence_s=2.5), count=2) as rig:
        rig.idle()
        fed = rig.feed("hangs", frames)
        [worker] = rig.fed
        rig.until(lambda: not rig.fed or rig.dispatcher.feeding._feeds[fed.id].ended, 10.0)
        rig.wait(answer := rig.process("hangs", fed))
        check(answer, fed, streamed=False)
        assert worker in rig.dispatcher.peers, "its signs of life go on"
        assert rig.until(lambda: worker not in rig.dispatcher.peers)
        assert rig.dispatcher.counters["attempts_failed"] == 0
        rig.idle()


def test_only_worker_that_hangs_while_it_is_fed_is_replaced_and_the_job_done(plugins, tmp_path, frames):
    with FedRig(tmp_path, plugins, Limits(job_timeout_s=2.5, cancel_grace_s=0.3), count=1) as rig:
        rig.idle()
        fed = rig.feed("hangs", frames)
        rig.until(lambda: not rig.fed or rig.dispatcher.feeding._feeds[fed.id].ended, 10.0)
        rig.wait(answer := rig.process("hangs", fed))
        check(answer, fed, streamed=False)
        assert rig.dispatcher.counters["attempts_failed"] == 0


@pytest.mark.parametrize("when", ["before", "with"])
def test_worker_killed_before_or_with_its_job_is_replaced(when, plugins, tmp_path, frames):
    with FedRig(tmp_path, plugins, count=2) as rig:
        rig.idle()
        fed = rig.feed("good", frames)
        [worker] = rig.fed
        pid = rig.dispatcher.peers[worker].pid
        os.kill(pid, signal.SIGSTOP if when == "with" else signal.SIGKILL)
        if when == "before":
            assert rig.until(lambda: not rig.fed)
        answer = rig.process("good", fed)
        if when == "with":
            os.kill(pid, signal.SIGKILL)
        rig.wait(answer)
        check(answer, fed, streamed=False)
        assert rig.dispatcher.counters["attempts_failed"] == (when == "with")


def test_feeds_that_come_to_nothing_leave_no_memory_behind(plugins, tmp_path):
    large = frame_set(1040, 1392, 4)
    with FedRig(tmp_path, plugins, count=1) as rig:
        rig.idle()
        sizes = []
        for _ in range(12):
            fed = rig.feed("good", large)
            rig.work.feed_drop(fed.id, "its set is taken again")
            assert rig.until(lambda: not rig.fed)
            rig.supervisor.tick(float("inf"))
            sizes.append(rig.supervisor.states()[0].memory_mb)
        assert sizes[-1] < sizes[2] + 12  # two sets more would be 12 MB
