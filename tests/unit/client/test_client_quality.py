"""What a result is worth, what is warned of, and what a stopping station means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fringed.data import RangeImage, Registration
from fringed.errors import Cancelled, ConnectionLost, RequestTimeout
from fringed.messages import ErrorInfo, ScanState
from fringed_client import quality
from fringed_client.protocol import flows


def image(kept: int) -> RangeImage:
    rejected = np.ones((100, 100), np.uint8)
    rejected.ravel()[:kept] = 0
    xyz = np.where(rejected[..., None] == 0, 1.0, np.nan).astype(np.float32).repeat(3, 2)
    sigma = np.where(rejected == 0, 0.05, np.nan).astype(np.float32)
    return RangeImage(xyz, rejected, np.zeros((100, 100), np.uint8), sigma)


def row(content: object) -> dict[str, object]:
    return {"kind": type(content).__name__, "id": "x", "stage": "", **quality.figures(content)}


@pytest.mark.parametrize(("kept", "warned", "passed"), [(2, True, False), (50, True, True), (100, False, True)])
def test_range_image_with_few_pixels_is_warned_of_and_with_hardly_any_refused(
    kept: int, warned: bool, passed: bool
) -> None:
    rows = [row(image(kept))]
    assert rows[0]["kept_fraction"] == kept / 10_000
    assert rows[0]["median_sigma_um"] == pytest.approx(50, rel=1e-6)
    assert bool(quality.warnings_of(rows, {})) is warned
    assert quality.gate(rows) is passed


def test_image_without_a_pixel_has_no_sigma_and_a_text() -> None:
    found = row(image(0))
    assert found["median_sigma_um"] is None
    assert quality.lines(found) == ["0 of 10,000 pixels kept (0.0%)"]


def test_registration_that_did_not_converge_is_warned_of_with_its_reason() -> None:
    good = Registration("a", "b", np.eye(4), True, "settled", 0.022, 0.8)
    said = quality.lines(row(good))
    assert said[0] == "converged, RMS 22 um, overlap 80%"
    assert said[1].startswith("model to reference: turned 0.0000 deg")
    assert [float(x) for line in said[2:] for x in line.split()] == np.eye(4).ravel().tolist()
    assert not quality.warnings_of([row(good)], {})
    bad = replace(good, converged=False, reason="too little overlap")
    assert "too little overlap" in quality.warnings_of([row(bad)], {})[0]


def cancelled() -> ScanState:
    return ScanState("id", "cancelled", "x", error=ErrorInfo("Cancelled", "cancelled, as asked"))


def test_cancelled_by_a_station_that_does_not_answer_any_more_is_a_lost_connection() -> None:
    flow = flows.follow(cancelled(), 10)
    assert next(flow).verb == "status"
    with pytest.raises(ConnectionLost, match="stopped"):
        flow.throw(RequestTimeout("nobody"))


def test_cancelled_by_somebody_else_stays_cancelled() -> None:
    flow = flows.follow(cancelled(), 10)
    next(flow)
    with pytest.raises(Cancelled):
        flow.send(None)
