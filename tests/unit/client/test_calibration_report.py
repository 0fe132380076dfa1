"""The report of a calibration: every pose and figure is there, pictures exist, nothing is hidden."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from calibration_pages import NUMBERS, example

from fringed_client.calibration import tables
from fringed_client.calibration.figures import coverage_words, number, sigmas
from fringed_client.calibration.report import write_page
from fringed_client.pictures import gallery

TRUENESS = {"depths_mm": [900.0, 1100.0], "size_px": [1392, 1040], "sigma_mm": [[[0.02, 0.03], [None, 0.04]]] * 2}


@pytest.fixture(autouse=True)
def _plain_views(monkeypatch):
    """Draw views by a stand-in: what a board view's picture shows is tested where it is drawn."""

    def draw(_, path):
        path.write_bytes(b"picture")
        return path

    monkeypatch.setattr(gallery, "draw_main", draw)


def test_the_page_names_every_pose_and_why_some_were_not_used(tmp_path):
    found, views = example(6, 1)
    page = write_page(found, views, TRUENESS, tmp_path).read_text()
    for view in views:
        assert view.name in page
    assert "another pitch (19.2 mm instead of 20 mm)" in page and "blurred: edges of 4.2 px" in page
    assert "SIMULATED" in page and found.hash in page and "verify on a known length" in page
    linked = set(re.findall(r'src="([^"]+)"', page))
    assert linked and all((tmp_path / name).is_file() for name in linked)


def test_every_parameter_has_its_value_and_deviation():
    found, _ = example()
    rows = {row[0]: row for row in tables.parameters(found)[1]}
    assert rows["camera fx"][1:] == ("3480.00", "0.20", "px")
    assert rows["projector k1"][2] == "0.0020" and rows["camera k3"][2:] == ("–", "held at 0")
    assert len(rows) == 24 and float(rows["turn about y"][1]) == pytest.approx(15.642, abs=2e-3)
    assert sigmas(found)["stereo.tz"] == pytest.approx(0.05) and len(sigmas(found)) == len(NUMBERS)


def test_the_baseline_has_the_deviation_of_its_own_direction():
    found, _ = example()
    tilted = replace(found, T_projector_camera=np.eye(4) + np.array([[0, 0, 0, 3.0], [0] * 4, [0, 0, 0, 4.0], [0] * 4]))
    expected = np.hypot(0.6 * 0.02, 0.8 * 0.05)
    assert tables.headline(tilted, None)[f"from camera to projector, ± {expected:.3f} mm"] == "5.000 mm"


def test_a_pose_at_each_corner_is_asked_for_until_it_is_there():
    _, views = example(1, 0)
    assert "lower right" in coverage_words(views) and "upper left" in coverage_words(views)
    found, whole = example(12, 0)
    assert coverage_words(whole) == "100% of the picture covered"
    assert not any("Take a pose there" in line for line in tables.advice(found, whole))


def test_a_calibration_without_covariance_and_views_has_a_page_too(tmp_path):
    found, _ = example()
    bare = replace(found, covariance=None, parameters=(), views=(), camera_falloff=None, projector_falloff=None)
    page = write_page(bare, [], None, tmp_path).read_text()
    assert "has no covariance" in page and "–" in page


@pytest.mark.parametrize(("value", "sigma", "text"), [
    (3480.1234, 0.213, "3480.12 ± 0.21"), (-0.0801, 0.00112, "-0.0801 ± 0.0011"), (1000.0, 25.0, "1000 ± 25"),
    (5.0, None, "5"), (0.0, 0.0, "0"),
])  # fmt: skip
def test_digits_are_those_that_the_deviation_leaves(value, sigma, text):
    assert number(value, sigma) == text
