"""What a reload applies at once, and what it only names."""

from fringed.config import simulated_station
from fringed.serving.reload import changes


def test_nothing_changed_is_nothing():
    assert changes(simulated_station(), simulated_station()) == ([], [])


def test_checks_camera_settings_and_presets_at_once_but_drivers_after_a_restart():
    over = {
        "checks": {"residual_max": 0.2},
        "camera": {"exposure_us": 100.0, "options": {"buffers": 2}},
        "presets": {"mine": {"pipeline": "thesis"}},
        "workers": {"count": 3},
    }
    applied, restart = changes(simulated_station(), simulated_station(over))
    assert applied == ["camera.exposure_us", "checks.residual_max", "presets.mine", "workers.count"]
    assert restart == ["camera.options.buffers"]
