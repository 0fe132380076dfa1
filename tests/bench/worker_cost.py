"""What the way daemon -> worker -> daemon adds to a stage, for full-size sets."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

PLUGIN = """
import numpy as np
from fringed.data import FrameSet, PhaseMap, RangeImage
from fringed.hookspecs import Params, hookimpl

SHAPE = (1040, 1392)

class Base:
    version = "1"
    summary = "instant"
    optional = frozenset()
    Params = Params

class Decode(Base):
    name = "instant-decode"
    inputs = {"frames": FrameSet}
    output = PhaseMap

    def run(self, inputs, params, context):
        one, two, three, four = (np.ones(SHAPE, np.float32) for _ in range(4))
        return PhaseMap(one, two, three, np.zeros(SHAPE, np.uint8), "absolute", 16.0, sigma_rad=four)

class Triangulate(Base):
    name = "instant-triangulate"
    inputs = {"phase": PhaseMap}
    output = RangeImage

    def run(self, inputs, params, context):
        points, sigma = np.ones((*SHAPE, 3), np.float32), np.ones(SHAPE, np.float32)
        return RangeImage(points, np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8), sigma)

@hookimpl
def register_processors():
    return [Decode, Triangulate]
"""


def overheads_ms(count: int) -> list[float]:
    """Return `count` times in ms from submit to range image, without the stages' own, in a fresh process."""
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "system")]
    code = f"import sys; sys.path[:0] = {folders}; import worker_cost; worker_cost.measure({count})"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=120)
    return [float(line) for line in done.stdout.split()]


def measure(count: int) -> None:
    """Print them; the process first settles its allocator, as the daemon does."""
    from fringed.workers.memory import keep_freed_pages

    keep_freed_pages(64)
    from worker_rig import Rig, frame_set

    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "plugins").mkdir()
        (folder / "plugins" / "instant.py").write_text(PLUGIN)
        frames = frame_set(1040, 1392, 12)
        with Rig(folder, folder / "plugins", count=1) as rig:
            for number in range(count + 3):
                begun_s = time.perf_counter()
                answer = rig.submit("instant-decode", "instant-triangulate", given={"object": frames})
                rig.wait(answer)
                own_s = sum(done.seconds for done in answer.stages)
                if number >= 3:  # the first ones start the worker and fill the heaps
                    print((answer.first_stage_s - begun_s - own_s) * 1e3)
