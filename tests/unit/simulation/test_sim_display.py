"""When a picture that was shown becomes light."""

import msgspec
import numpy as np
import pytest

from fringed.config.simulated import ProjectorOptics
from fringed.simulation.clock import VirtualClock
from fringed.simulation.display import Display, Picture

BLACK, A, B = (Picture(np.zeros((1, 1, 1), np.uint8)) for _ in range(3))


@pytest.fixture
def clock():
    return VirtualClock(real_time=False)


def display_with(clock, **optics):
    return Display(msgspec.structs.replace(ProjectorOptics(), **optics), clock, BLACK)


def shares(display, start, end):
    return {picture: share for share, picture in display.weights(start, end)}


def test_a_flip_comes_with_the_next_vertical_sync(clock):
    display = display_with(clock, display_hz=50.0)
    clock.sleep(0.003)
    assert display.show(A) == pytest.approx(0.02)
    assert clock.now() == pytest.approx(0.02)
    assert display.show(B) == pytest.approx(0.04)


def test_light_comes_the_latency_after_the_flip(clock):
    display = display_with(clock, display_hz=50.0, latency_frames=3, settle_s=0.0)
    flip = display.show(A)
    light = flip + 3 / 50
    assert shares(display, flip, light - 1e-9) == {BLACK: pytest.approx(1.0)}
    assert shares(display, light + 1e-9, light + 0.01) == {A: pytest.approx(1.0)}
    assert display.is_awaited(light + 1e-9)
    assert not display.is_awaited(light - 1e-6)


def test_an_exposure_over_a_switch_blends_both_pictures(clock):
    display = display_with(clock, settle_s=0.0)
    light = display.show(A) + 2 / 60
    assert shares(display, light - 0.003, light + 0.001) == {BLACK: pytest.approx(0.75), A: pytest.approx(0.25)}


def test_a_pixel_is_within_a_thousandth_after_the_settling_time(clock):
    display = display_with(clock, settle_s=0.010)
    light = display.show(A) + 2 / 60
    at_once = shares(display, light + 0.010, light + 0.010 + 1e-9)
    assert at_once[BLACK] == pytest.approx(1e-3, rel=1e-3)
    tau = 0.010 / np.log(1000)
    mean = shares(display, light, light + 0.010)[BLACK]
    assert mean == pytest.approx(tau / 0.010 * (1 - 1e-3), rel=1e-6)


def test_shares_add_up_however_often_pictures_change(clock):
    display = display_with(clock, settle_s=0.05)
    for picture in (A, B, A, BLACK, B):
        display.show(picture)
    assert sum(shares(display, 0.0, 0.3).values()) == pytest.approx(1.0, abs=1e-6)
    assert len(shares(display, 0.0, 0.3)) == 3


def test_a_late_picture_is_confirmed_as_if_it_were_not(clock):
    display = display_with(clock, settle_s=0.0)
    flip = display.show(A, late_s=0.1335)
    assert flip == pytest.approx(1 / 60)
    light = flip + 2 / 60
    assert display.is_awaited(light + 1e-9)
    assert not display.is_awaited(light - 1e-6)
    assert shares(display, light, light + 0.1) == {BLACK: pytest.approx(1.0)}
    assert shares(display, light + 0.14, light + 0.15) == {A: pytest.approx(1.0)}


def test_a_later_picture_replaces_one_that_never_came(clock):
    display = display_with(clock, settle_s=0.0)
    display.show(A, late_s=1.0)
    light = display.show(B) + 2 / 60
    assert shares(display, light + 1.0, light + 2.0) == {B: pytest.approx(1.0)}
    assert display.previous(light + 1.0) is BLACK


def test_the_first_frame_of_a_picture_is_awaited_though_the_next_one_is_shown_ahead(clock):
    display = display_with(clock, settle_s=0.01)
    display.show(A)
    clock.sleep(0.1)
    exposed = clock.now()
    clock.sleep(0.01)
    display.show(B)
    assert display.is_awaited(exposed) and display.previous(exposed) is BLACK
    display.delivered(exposed)
    assert not display.is_awaited(exposed + 0.001)  # a second one, before the next picture's light
    clock.sleep(0.1)
    assert display.is_awaited(clock.now()) and display.previous(clock.now()) is A


def test_nobody_awaits_a_frame_of_the_idle_picture_before_a_set(clock):
    display = display_with(clock, settle_s=0.01)
    display.show(BLACK)
    clock.sleep(0.1)
    idle = clock.now()
    display.show(A)
    assert not display.is_awaited(idle)
