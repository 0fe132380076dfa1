"""Write a new plug-in package that works: a decoder, its test and its packaging.

Owns the templates; `fringed plugins new` calls it. What it writes is ordinary code, to be changed.
"""

from __future__ import annotations

import re
from pathlib import Path

from fringed import __version__
from fringed.errors import StorageError, UsageError

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

_PYPROJECT = """[build-system]
requires = ["hatchling>=1.27"]
build-backend = "hatchling.build"

[project]
name = "{name}"
version = "0.1.0"
description = "A plug-in for fringed"
requires-python = ">=3.11"
dependencies = ["fringed>={fringed}", "numpy>=1.26"]

[project.entry-points."fringed.plugins"]
{name} = "{module}"

[tool.hatch.build.targets.wheel]
packages = ["{module}"]

[tool.pytest.ini_options]
pythonpath = ["."]
"""

_README = """# {name}

A plug-in for fringed. It registers the decoder `{name}`: frames of one frequency to a wrapped phase.

    pip install -e .            # fringed finds it by its entry point
    fringed plugins             # lists it, or says why it is broken
    python -m pytest            # checks that it keeps the contract

In a pipeline:

    [pipelines.mine]
    encoder = "phase-shift"
    stages = [{{ processor = "{name}" }}]

It decodes a whole set. Offer `begin` (`fringed.hookspecs.StreamingProcessor`) to take frames while they arrive; the
contract's test then checks that both give the same.
"""

_MODULE = '''"""Registers the decoder `{name}`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from fringed import hookspecs
from fringed.data import FrameSet, PhaseMap, Reject
from fringed.errors import DataError
from fringed.hookspecs import Context, hookimpl
from msgspec import Meta

__version__ = "0.1.0"


class DecoderParams(hookspecs.Params, frozen=True, kw_only=True):
    """Parameters; limits are enforced, help and units are shown."""

    min_modulation_dn: Annotated[
        float, Meta(ge=0, le=65535, description="smallest modulation", extra_json_schema={{"units": "grey level"}})
    ] = 5.0


class Decoder:
    """Wrapped phase of N equal steps: phi = atan2(-sum I sin(shift), sum I cos(shift))."""

    name: ClassVar[str] = "{name}"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N equal steps to a wrapped phase"
    inputs: ClassVar[Mapping[str, Any]] = {{"frames": FrameSet}}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap
    Params: ClassVar[type[hookspecs.Params]] = DecoderParams

    def run(self, inputs: Mapping[str, Any], params: DecoderParams, context: Context) -> PhaseMap:
        """Return the wrapped phase; raise DataError for frames that it cannot decode."""
        frame_set = inputs.get("frames")
        if not isinstance(frame_set, FrameSet):
            raise DataError(f"{name} decodes a FrameSet named 'frames', not {{type(frame_set).__name__}}")
        patterns = frame_set.sequence.frames
        if len(frame_set.sequence.groups()) != 1 or len(patterns) < 3:
            raise DataError("{name} decodes one group of at least 3 steps; use the encoder 'phase-shift'")
        context.check_cancelled()
        shifts = np.array([pattern.shift_rad for pattern in patterns], np.float32)
        frames = frame_set.frames.astype(np.float32)
        sine = np.tensordot(np.sin(shifts), frames, 1)
        cosine = np.tensordot(np.cos(shifts), frames, 1)
        modulation = 2 / len(patterns) * np.hypot(sine, cosine)
        rejected = np.where(modulation < params.min_modulation_dn, Reject.LOW_MODULATION, 0).astype(np.uint16)
        return PhaseMap(
            phase_rad=np.where(rejected, np.nan, np.arctan2(-sine, cosine)).astype(np.float32),
            modulation=modulation.astype(np.float32),
            background=frames.mean(axis=0),
            rejected=rejected,
            kind="wrapped",
            period_px=patterns[0].period_px,
            orientation=patterns[0].orientation,
            initial_phase_rad=patterns[0].initial_phase_rad,
        )


@hookimpl
def register_processors() -> Sequence[type[Any]]:
    """Return the processors of this plug-in."""
    return [Decoder]
'''

_TEST = '''"""Checks that the plug-in keeps the contract and decodes a known phase."""

from __future__ import annotations

import numpy as np
import pytest
from fringed.data import FrameSet, PatternFrame, PatternSequence
from {module} import Decoder


@pytest.fixture
def frame_set():
    shifts = 2 * np.pi * np.arange(4) / 4
    frames = tuple(
        PatternFrame("sinusoidal", period_px=16.0, shift_rad=float(s), step=k, steps=4) for k, s in enumerate(shifts)
    )
    column = np.zeros((1, 64, 1), np.uint8)
    sequence = PatternSequence("phase-shift", 64, 8, frames, (column,) * 4)
    phase = 2 * np.pi * np.arange(64) / 16 * np.ones((8, 1))
    images = [np.rint(120 + 100 * np.cos(phase + s)) for s in shifts]
    return FrameSet(np.array(images, np.uint8), sequence)


def test_decoder_keeps_the_contract(plugin_contract, frame_set):
    plugin_contract.processor(Decoder, {{"frames": frame_set}})


def test_phase_is_that_of_the_frames(plugin_contract, frame_set):
    product = plugin_contract.processor(Decoder, {{"frames": frame_set}})
    expected = 2 * np.pi * np.arange(64) / 16
    error = np.angle(np.exp(1j * (product.phase_rad - expected)))
    assert np.abs(error).max() < 0.01  # grey levels are rounded: half a level of 100
'''


def write_plugin(folder: Path, name: str) -> list[Path]:
    """Write a plug-in package called `name` into `folder` and return its files.

    Raises
    ------
    UsageError
        a name that cannot be a package's, or a file that is there already.
    StorageError
        the folder cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} cannot name a plug-in; use lower-case words joined by hyphens, such as my-decoder")
    module = name.replace("-", "_")
    words = {"name": name, "module": module, "fringed": __version__}
    files = {
        folder / "pyproject.toml": _PYPROJECT,
        folder / "README.md": _README,
        folder / module / "__init__.py": _MODULE,
        folder / "tests" / f"test_{module}.py": _TEST,
    }
    taken = [str(path) for path in files if path.exists()]
    if taken:
        raise UsageError(f"{', '.join(taken)} exist already; choose another name or folder")
    try:
        for path, template in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(template.format(**words), encoding="utf-8")
    except OSError as error:
        raise StorageError(f"the plug-in cannot be written to {folder}: {error}") from error
    return list(files)
