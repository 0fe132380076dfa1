"""A device's own settings: asked between scans, checked against what they allow, never the cause of a failed device."""

from __future__ import annotations

import threading

import pytest
from acquisition_fakes import FakeRig, sinusoids
from test_acquisition_runner import SETTINGS, Bench, wait_for

from fringed.acquisition.adjusting import SettingsRequest, checked
from fringed.acquisition.listener import AcquisitionRequest
from fringed.errors import DeviceAbsent, UsageError
from fringed.hookspecs import Setting


def ask(bench, which, name="", value=None):
    """Return the settings, or raise what came instead."""
    answered, got = threading.Event(), []

    def end(what):
        got.append(what)
        answered.set()

    bench.runner.settings(SettingsRequest(which, end, end, name, value))
    assert answered.wait(10)
    if isinstance(got[0], Exception):
        raise got[0]
    return {setting.name: setting.value for setting in got[0]}


@pytest.fixture
def bench():
    with Bench() as made:
        wait_for(lambda: ("projector", "IDLE") in made.states)
        yield made


def test_settings_are_read_and_set(bench):
    assert ask(bench, "projector") == {"brightness": 50, "input": "rgb1", "lamp_hours": 120.5}
    assert ask(bench, "projector", "brightness", "70")["brightness"] == 70
    assert bench.fake.brightness == 70


@pytest.mark.parametrize(
    ("which", "name", "value", "match"),
    [
        ("lamp", "", None, "no device is called 'lamp'; there are camera, projector"),
        ("camera", "", None, "has no settings of its own"),
        ("projector", "brightnes", 1, "did you mean brightness"),
        ("projector", "brightness", 101, "allowed is 0 % to 100 %"),
        ("projector", "brightness", "much", "allowed is 0 % to 100 %"),
        ("projector", "input", "hdmi", "allowed are rgb1, rgb2"),
        ("projector", "lamp_hours", 0, "read only"),
    ],
)
def test_what_is_not_allowed_is_refused_and_the_rig_goes_on(bench, which, name, value, match):
    with pytest.raises(UsageError, match=match):
        ask(bench, which, name, value)
    assert bench.states[-1][1] == "IDLE" and bench.scan() is None


def test_absent_device_says_so(bench):
    bench.fake.present["projector"] = False
    with pytest.raises(DeviceAbsent):
        ask(bench, "projector")
    bench.fake.present["projector"] = True
    wait_for(lambda: bench.states[-1] == ("projector", "IDLE"))
    assert ask(bench, "projector")["brightness"] == 50


def test_question_waits_for_the_end_of_a_scan():
    fake = FakeRig()
    fake.camera.blocking.set()
    with Bench(fake) as bench:
        bench.runner.submit(AcquisitionRequest("long", sinusoids(steps=16), settings=SETTINGS))
        wait_for(lambda: bench.fractions)
        answered = []
        bench.runner.settings(SettingsRequest("projector", answered.append, answered.append))
        assert not answered
        fake.camera.blocking.clear()
        bench.wait("long")
        wait_for(lambda: answered)


def test_questions_are_answered_when_the_station_stops():
    fake = FakeRig()
    fake.camera.blocking.set()
    answered = []
    with Bench(fake) as bench:
        bench.runner.submit(AcquisitionRequest("long", sinusoids(steps=16), settings=SETTINGS))
        wait_for(lambda: bench.fractions)
        bench.runner.settings(SettingsRequest("projector", answered.append, answered.append))
    assert len(answered) == 1 and isinstance(answered[0], Exception)


SWITCH, WHOLE, TEXT = Setting("blank", False), Setting("hours", 3, most=10), Setting("name", "a")


@pytest.mark.parametrize(
    ("setting", "value", "taken"),
    [(SWITCH, "on", True), (SWITCH, False, False), (WHOLE, "7", 7), (WHOLE, 2.5, 2.5), (TEXT, 5, "5")],
)
def test_values_become_what_the_setting_is(setting, value, taken):
    found = checked([setting], "projector", setting.name, value)
    assert found == taken and type(found) is type(taken)


@pytest.mark.parametrize(("setting", "value"), [(SWITCH, "maybe"), (WHOLE, 11), (WHOLE, float("nan"))])
def test_values_that_are_none_are_refused(setting, value):
    with pytest.raises(UsageError, match="allowed"):
        checked([setting], "projector", setting.name, value)
