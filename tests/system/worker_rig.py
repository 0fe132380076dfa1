"""A station's work side alone: dispatcher, supervisor and socket on a real reactor, with toy plug-ins."""

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zmq

from fringed.data import FrameSet, PatternFrame, PatternSequence, new_id
from fringed.messages import ErrorInfo, Job, JobProgress, StageCall, StageDone
from fringed.serving.reactor import Reactor
from fringed.serving.work import WorkSocket
from fringed.workers.dispatch import Dispatcher
from fringed.workers.jobs import Limits, Watcher
from fringed.workers.supervisor import Supervisor, WorkerOptions

BUILT_IN = dict.fromkeys(("phase", "calibration", "triangulation", "registration", "exporters"), "toys are enough here")

PLUGIN_HEAD = """
import ctypes, os, sys, time
from typing import Annotated
import msgspec, numpy as np
from fringed.data import FrameSet, PhaseMap, Mesh
from fringed.hookspecs import Params, hookimpl

class Base:
    version = "1.2"
    summary = "toy"
    inputs = {"frames": FrameSet}
    optional = frozenset()
    output = PhaseMap
    class Params(Params, frozen=True, kw_only=True):
        value: Annotated[float, msgspec.Meta(ge=0, le=9)] = 1.0

    def run(self, inputs, params, context):
        self.act(context)
        shape = inputs["frames"].frames.shape[1:]
        plane = np.full(shape, params.value, np.float32)
        return PhaseMap(plane, plane, plane, np.zeros(shape, np.uint8), "wrapped", 16.0)

    def act(self, context):
        pass

    def hoard(self, megabytes):
        while int(open("/proc/self/statm").read().split()[1]) * 4096 < megabytes * 1e6:
            kept.append(np.ones(1 << 17))

kept = []
"""

FAULTS = {
    "good": "pass",
    "exits": "os._exit(7)",
    "null": "ctypes.string_at(0)",
    "sleeps": "time.sleep(1000)",
    "polite": "[(time.sleep(0.01), context.check_cancelled()) for _ in range(100_000)]",
    "leaks": "global kept; kept = [np.ones(1 << 22) for _ in range(60)]; time.sleep(1)",
    "hoards": "self.hoard(405)",
    "raises": "raise RuntimeError('the plug-in is broken')",
    "quits": "sys.exit(3)",
    "chats": "print('hello from a plug-in'); context.log('warning', 'careful'); context.progress(0.5, 'half')",
    "forks": "import subprocess; subprocess.Popen(['sleep', '1000']); os._exit(1)",
}


def write_plugins(folder: Path, *names: str) -> Path:
    """Write one plug-in file that provides a processor for each of `names`."""
    folder.mkdir(exist_ok=True)
    classes = [
        f"class P{i}(Base):\n    name = {name!r}\n    def act(self, context):\n        {FAULTS[name]}\n"
        for i, name in enumerate(names)
    ]
    wrong = "class Wrong(Base):\n    name = 'wrong'\n    def run(self, inputs, params, context):\n        return 42\n"
    listed = ", ".join([*(f"P{i}" for i in range(len(names))), "Wrong"])
    hook = f"@hookimpl\ndef register_processors():\n    return [{listed}]\n"
    (folder / "toys.py").write_text("\n".join([PLUGIN_HEAD, *classes, wrong, hook]))
    return folder


def frame_set(height: int = 8, width: int = 10, frames: int = 4) -> FrameSet:
    stamped = tuple(PatternFrame("sinusoid", period_px=16.0, step=i, steps=frames) for i in range(frames))
    patterns = tuple(np.zeros((1, 64, 1), np.uint8) for _ in range(frames))
    sequence = PatternSequence("toy", 64, 48, stamped, patterns)
    return FrameSet(np.zeros((frames, height, width), np.uint8), sequence, id=new_id(), scan=new_id())


@dataclass
class Answer:
    """What became of one job."""

    stages: list[StageDone] = field(default_factory=list)
    progress: list[JobProgress] = field(default_factory=list)
    ends: list[str] = field(default_factory=list)
    error: ErrorInfo | None = None
    quarantined: bool = False
    first_stage_s: float = 0.0

    def watcher(self) -> Watcher:
        def on_stage(done: StageDone) -> None:
            self.first_stage_s = self.first_stage_s or time.perf_counter()
            self.stages.append(done)

        def on_failed(error: ErrorInfo, quarantined: bool) -> None:
            self.error, self.quarantined = error, quarantined
            self.ends.append("failed")

        return Watcher(on_stage, lambda _: self.ends.append("done"), on_failed, self.progress.append)


class Rig:
    """Use as a context manager."""

    def __init__(self, folder: Path, plugins: Path, limits: Limits | None = None, **options: object) -> None:
        self.context = zmq.Context()
        self.dispatcher = Dispatcher(limits or Limits(cancel_grace_s=0.3))
        endpoint = f"ipc://{folder}/work"
        self.supervisor = Supervisor(
            WorkerOptions(endpoint, folders=(plugins,), threads=1, skip=BUILT_IN, **options),  # type: ignore[arg-type]
            self.dispatcher,
        )
        self.reactor = Reactor()
        self.work = WorkSocket(self.context, self.dispatcher, (self.supervisor.tick,))
        self.work.bind(endpoint)

    def __enter__(self) -> "Rig":
        self.work.attach(self.reactor)
        return self

    def __exit__(self, *_: object) -> None:
        self.supervisor.stop()
        self.work.close()
        self.reactor.close()
        self.context.destroy(linger=0)

    def submit(
        self,
        *plugins: str,
        given: dict[str, object] | None = None,
        pipeline: str = "p",
        timeout_s: float = 60.0,
        **more: object,
    ) -> Answer:
        stages = tuple(StageCall(f"s{i}-{name}", "processor", name, **more) for i, name in enumerate(plugins))
        answer = Answer()
        job = Job(new_id(), stages, given if given is not None else {"object": frame_set()}, pipeline, scan="scan-1")
        self.work.submit(job, answer.watcher(), timeout_s)
        return answer

    def wait(self, *answers: Answer, timeout_s: float = 60.0) -> None:
        done = self.reactor.run_until(lambda: all(answer.ends for answer in answers), timeout_s)
        assert done, f"no answer after {timeout_s} s"

    def until(self, condition: object, timeout_s: float = 30.0) -> bool:
        return self.reactor.run_until(condition, timeout_s)  # type: ignore[arg-type]
