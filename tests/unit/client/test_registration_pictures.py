"""Pictures of registrations show the figures that were put in: lines, limits, distances, colours, places."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fringed.data import IterationRecord, Registration
from fringed_client.pictures import convergence
from fringed_client.pictures.figures import APART


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Every figure is drawn and kept here instead of written."""
    figures: list[Any] = []

    def keep(drawn: Any, path: Path) -> Path:
        drawn.canvas.draw()
        figures.append(drawn)
        return path

    for module in (convergence,):
        monkeypatch.setattr(module, "save", keep)
    return figures


def a_history(count: int = 6, stages: tuple[str, ...] = ("medium", "fine"), alpha_mm: float = 0.0) -> tuple:
    return tuple(
        IterationRecord(
            0.5**n, 100 + n, 4 * 0.5**n if n else float("inf"), np.radians(2 * 0.1**n), 0.3 * 0.1**n,
            stages[n * len(stages) // count], alpha_mm,
        )
        for n in range(count)
    )  # fmt: skip


def a_registration(T: Any = None, history: tuple = (), converged: bool = True) -> Registration:
    T = np.eye(4) if T is None else T
    reason = "it stands still" if converged else "the overlap is 3.0%; at least 20% is needed"
    return Registration("a", "b", T, converged, reason, 0.05, 0.7, history=history)


def texts(drawn: Any) -> str:
    from matplotlib.text import Text

    return "\n".join(found.get_text() for found in drawn.findobj(Text) if found.get_visible())


def test_convergence_shows_every_figure_of_every_iteration(kept: list[Any]) -> None:
    history = a_history(alpha_mm=0.25)
    convergence.draw_convergence(Path("c.png"), [a_registration(history=history)], True)
    main, pairs, limits, rotation, translation = kept[0].axes
    drawn = [np.asarray(axes.lines[0].get_ydata(), float) for axes in (main, pairs, limits, rotation, translation)]
    assert drawn[0] == pytest.approx([one.rms_mm for one in history])
    assert drawn[1] == pytest.approx([one.pairs for one in history])
    assert np.isnan(drawn[2][0])  # no limit is infinitely far: not drawn
    assert drawn[2][1:] == pytest.approx([one.threshold_mm for one in history[1:]])
    assert drawn[3] == pytest.approx([2 * 0.1**n for n in range(6)])  # degrees
    assert drawn[4] == pytest.approx([one.translation_mm for one in history])
    assert np.asarray(limits.lines[1].get_ydata()) == pytest.approx([0.25] * 6)
    assert main.get_yscale() == "log" and pairs.get_yscale() == "linear"
    shown = texts(kept[0])
    for word in ("medium", "fine", "SIMULATED", "alpha", "70% overlap", "0.05 mm RMS", "view 2 → 1: converged"):
        assert word in shown


def test_methods_are_compared_by_name_and_told_apart(kept: list[Any]) -> None:
    names = [f"method {n}" for n in range(9)]
    convergence.draw_histories(Path("c.png"), {name: a_history(3 + n) for n, name in enumerate(names)}, False, "nine")
    main, pairs = kept[0].axes[:2]
    assert len(pairs.lines) == 9
    looks = {(line.get_color(), line.get_linestyle()) for line in pairs.lines}
    assert len(looks) == 9 > len(APART)
    assert main.get_xlim() == (0.5, 11.5)
    shown = texts(kept[0])
    assert all(name in shown for name in names)
    assert "alpha" not in shown and "SIMULATED" not in shown


@pytest.mark.parametrize("history", [(), (IterationRecord(0.0, 0, 0.0, 0.0, 0.0),)])
def test_a_registration_without_iterations_is_drawn_too(kept: list[Any], history: tuple) -> None:
    convergence.draw_convergence(Path("c.png"), [a_registration(history=history, converged=False)], False)
    assert "NOT converged" in texts(kept[0])
    convergence.draw_convergence(Path("c.png"), [], False)


def test_stages_are_the_runs_of_one_name() -> None:
    history = [IterationRecord(1.0, 1, 1.0, 0.0, 0.0, name) for name in ("a", "a", "b", "a")]
    assert convergence.stages_of(history) == [("a", 1, 2), ("b", 3, 3), ("a", 4, 4)]
