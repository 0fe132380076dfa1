from __future__ import annotations

import itertools
import threading
import time

import numpy as np
import pytest
from acquisition_fakes import HEIGHT, WIDTH, FakeRig, sinusoids

from fringed.acquisition import AcquisitionRequest, AcquisitionRunner, Rig, Station
from fringed.config import AcquisitionConfig, CheckConfig
from fringed.data import CameraSettings, PatternFrame, PatternSequence, Truth
from fringed.errors import (
    AcquisitionError,
    Cancelled,
    DeviceAbsent,
    DeviceError,
    DeviceStalled,
    QualityError,
    StorageError,
    UsageError,
)

SETTINGS = CameraSettings(exposure_us=8000.0)
KNOWN = {"latency_s": 0.034, "settle_s": 0.012, "reconnect_s": 0.02}


class Sink:
    def __init__(self, station, set_id, shape):
        self.station, self.set_id, self.shape = station, set_id, shape
        self.written, self.state = {}, "open"

    def write(self, index, image):
        if self.station.full_disk:
            raise StorageError("the disk is full")
        self.written[index] = image.copy()

    def commit(self, frame_set):
        self.state = "committed"

    def abort(self):
        self.state = "aborted"


class Bench:
    """A runner on a fake rig, and everything it said."""

    def __init__(self, fake=None, truth=None, **config):
        self.fake = fake or FakeRig()
        self.full_disk = False
        self.sinks, self.states, self.previews, self.sets, self.events, self.truths = [], [], [], [], [], []
        self.frames = []
        self.fractions, self.ended, self.arrived = [], {}, threading.Condition()
        self.unused = 0
        rig = Rig(self.fake.camera, self.fake.projector, "fake", "fake", truth)
        self.runner = AcquisitionRunner(
            rig, Station("rig-1", "c0ffee", "fringed 1"), self, self.open_set, AcquisitionConfig(**{**KNOWN, **config}),
            CheckConfig(),
        )  # fmt: skip

    def __enter__(self):
        self.runner.start()
        return self

    def __exit__(self, *_):
        assert self.runner.stop(5.0)

    def open_set(self, set_id, sequence, shape, dtype):
        self.sinks.append(Sink(self, set_id, shape))
        return self.sinks[-1]

    def device_state(self, which, state):
        self.states.append((which, state.state))

    def progress(self, scan, fraction, text):
        self.fractions.append(fraction)

    def frame(self, of, index, image):
        self.frames.append((of.id, index, image))

    def preview(self, preview):
        self.previews.append(preview)

    def set_taken(self, frame_set, delivered_s, sink):
        assert time.monotonic() - delivered_s < 60
        self.sets.append((frame_set, sink))
        sink.commit(frame_set)

    def discarded(self, count):
        self.unused += count

    def truth(self, truth):
        self.truths.append(truth)

    def event(self, event):
        self.events.append(event)

    def finished(self, scan):
        self._end(scan, None)

    def failed(self, scan, error):
        self._end(scan, error)

    def _end(self, scan, error):
        with self.arrived:
            self.ended[scan] = error
            self.arrived.notify_all()

    def wait(self, scan):
        with self.arrived:
            assert self.arrived.wait_for(lambda: scan in self.ended, 30)
        return self.ended[scan]

    def scan(self, name="scan", sequence=None, **request):
        self.runner.submit(AcquisitionRequest(name, sequence or sinusoids(), settings=SETTINGS, **request))
        return self.wait(name)


def test_set_is_taken_checked_written_and_handed_over():
    with Bench() as bench:
        assert bench.scan() is None
    (frame_set, sink) = bench.sets[0]
    assert frame_set.check.passed and frame_set.retakes == 0
    assert (frame_set.scan, frame_set.role, frame_set.id) == ("scan", "object", sink.set_id)
    assert sink.shape == frame_set.frames.shape and sink.state == "committed"
    for index, image in sink.written.items():
        np.testing.assert_array_equal(image, frame_set.frames[index])
    assert len(sink.written) == 12
    assert frame_set.settings.electrons_per_dn == 51.0  # those in force, not those asked for
    provenance = frame_set.provenance
    assert (provenance.rig, provenance.calibration, provenance.software) == ("rig-1", "c0ffee", "fringed 1")
    assert provenance.simulated and not provenance.replayed and provenance.created
    for stamp in frame_set.stamps:
        assert stamp.exposure_start_s >= stamp.flip_s + 0.046
    assert bench.fractions[-1] == pytest.approx(1.0)
    assert bench.previews[0].image.shape[1] <= 350


def test_twelve_frames_take_about_twelve_camera_periods():
    for readout_s in (0.002, 0.12):
        with Bench(FakeRig(readout_s=readout_s)) as bench:
            assert bench.scan() is None
        stamps = bench.sets[0][0].stamps
        assert (stamps[-1].exposure_end_s - stamps[0].flip_s) / 0.1335 <= 13.0


def test_triggered_camera_adds_less_than_five_milliseconds_to_a_pattern():
    fake = FakeRig(period_s=0.02, readout_s=0.001)
    with Bench(fake) as bench:
        request = AcquisitionRequest("t", sinusoids(), settings=CameraSettings(8000.0, trigger="software"))
        bench.runner.submit(request)
        assert bench.wait("t") is None
    stamps = bench.sets[0][0].stamps
    least_s = 0.046 + 0.008
    for one, other in itertools.pairwise(stamps):
        spent_s = other.flip_s - one.flip_s
        assert spent_s <= least_s + 1 / 60 + 0.005


@pytest.mark.parametrize("fault", ["late", "repeated", "blended", "torn", "dropped"])
def test_faulty_set_is_retaken_counted_and_the_reason_is_told(fault):
    with Bench() as bench:
        assert bench.scan("first") is None
        order_at_frame(bench, 5, fault)
        assert bench.scan("second") is None
    frame_set = bench.sets[1][0]
    assert frame_set.retakes == 1 and frame_set.check.passed
    assert [sink.state for sink in bench.sinks] == ["committed", "aborted", "committed"]
    (event,) = bench.events
    assert event.name == "set.retaken" and event.detail["retake"] == 1
    assert fault in event.detail["reason"]


def order_at_frame(bench, frame, fault, count=1):
    bench.fractions.clear()
    told = bench.progress

    def progress(scan, fraction, text):
        told(scan, fraction, text)
        if len(bench.fractions) == frame:
            bench.fake.order(fault, count)

    bench.progress = progress


@pytest.mark.parametrize(
    ("fault", "state"), [("vanish", "ABSENT"), ("stall", "FAULT"), ("garbage", "FAULT"), ("crash", "FAULT")]
)
def test_failing_camera_is_reopened_and_the_set_retaken(fault, state):
    with Bench() as bench:
        order_at_frame(bench, 4, fault)
        assert bench.scan() is None
        assert ("camera", state) in bench.states
        assert ("projector", state) not in bench.states
        assert bench.sets[0][0].retakes == 1
        assert bench.fake.opened == {"camera": 2, "projector": 1}
        assert bench.scan("next") is None


def test_retries_end_with_the_reason_and_the_next_scan_works():
    with Bench(retries=2) as bench:
        bench.fake.order("blended", 36)
        error = bench.scan()
        assert isinstance(error, QualityError)
        assert "failed 3 times" in error.message and "misfit" in error.message
        assert ("camera", "DEGRADED") in bench.states
        bench.fake.orders.clear()
        assert bench.scan("next") is None
        assert [event.detail["retake"] for event in bench.events] == [1, 2]
    assert all(sink.state != "open" for sink in bench.sinks)


def test_stalled_camera_fails_the_scan_as_stalled():
    with Bench(retries=0) as bench:
        bench.fake.order("stall")
        assert isinstance(bench.scan(), DeviceStalled)
        assert bench.scan("next") is None


def test_absent_camera_fails_the_scan_and_is_used_once_it_is_there():
    with Bench(retries=1) as bench:
        bench.fake.present["camera"] = False
        assert isinstance(bench.scan(), DeviceAbsent)
        bench.fake.present["camera"] = True
        assert bench.scan("next") is None


def test_device_that_appears_is_opened_without_hands():
    fake = FakeRig()
    fake.present["projector"] = False
    with Bench(fake) as bench:
        wait_for(lambda: ("camera", "IDLE") in bench.states)
        assert ("projector", "IDLE") not in bench.states
        time.sleep(0.1)
        fake.present["projector"] = True
        wait_for(lambda: ("projector", "IDLE") in bench.states)
    said = [state for which, state in bench.states if which == "projector"]
    assert said == ["CONNECTING", "ABSENT", "IDLE", "ABSENT"]  # each once, however often it was tried


def test_device_that_is_pulled_while_nobody_scans_is_seen_to_be_gone_and_comes_back():
    with Bench() as bench:
        wait_for(lambda: ("projector", "IDLE") in bench.states)
        bench.fake.present["projector"] = False
        wait_for(lambda: bench.states[-1] == ("projector", "ABSENT"))
        bench.fake.present["projector"] = True
        wait_for(lambda: bench.states[-1] == ("projector", "IDLE"))
        assert bench.scan() is None


def test_projector_whose_lamp_warms_up_is_said_to_and_is_used_once_it_is_on():
    fake = FakeRig()
    fake.projector.lamp_state, opened = "WARMING", fake.projector.open

    def cold():
        if fake.projector.lamp_state != "ON":
            raise DeviceError("the lamp warms up, ready in about 23 s")
        return opened()

    fake.projector.open = cold
    with Bench(fake) as bench:
        wait_for(lambda: bench.states and bench.states[-1] == ("projector", "WARMING"))
        fake.projector.lamp_state = "ON"
        wait_for(lambda: bench.states[-1] == ("projector", "IDLE"))
        assert bench.scan() is None


def wait_for(condition):
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_running_scan_is_cancelled_and_leaves_nothing_behind():
    fake = FakeRig()
    fake.camera.blocking.set()
    with Bench(fake) as bench:
        bench.runner.submit(AcquisitionRequest("long", sinusoids(steps=16), settings=SETTINGS))
        wait_for(lambda: bench.fractions)
        bench.runner.cancel("long")
        assert isinstance(bench.wait("long"), Cancelled)
        assert [sink.state for sink in bench.sinks] == ["aborted"]
        fake.camera.blocking.clear()
        assert bench.scan("next") is None


def test_queued_scan_is_cancelled_before_it_begins():
    fake = FakeRig()
    fake.camera.blocking.set()
    with Bench(fake) as bench:
        bench.runner.submit(AcquisitionRequest("one", sinusoids(), settings=SETTINGS))
        bench.runner.submit(AcquisitionRequest("two", sinusoids(), settings=SETTINGS))
        bench.runner.cancel("two")
        bench.runner.cancel("nobody")
        assert bench.wait("one") is None
        assert isinstance(bench.wait("two"), Cancelled)
    assert len(bench.sets) == 1


def test_stop_ends_a_running_scan_and_closes_the_devices():
    fake = FakeRig()
    fake.camera.blocking.set()
    bench = Bench(fake)
    bench.runner.start()
    bench.runner.submit(AcquisitionRequest("long", sinusoids(steps=16), settings=SETTINGS))
    bench.runner.submit(AcquisitionRequest("queued", sinusoids(), settings=SETTINGS))
    wait_for(lambda: bench.fractions)
    assert bench.runner.stop(5.0)
    assert isinstance(bench.ended["long"], Cancelled)
    assert isinstance(bench.ended["queued"], Cancelled)
    assert bench.states[-2:] == [("camera", "ABSENT"), ("projector", "ABSENT")]
    with pytest.raises(AcquisitionError, match="stopping"):
        bench.runner.submit(AcquisitionRequest("late", sinusoids()))


def test_runner_that_was_never_started_stops_at_once():
    assert Bench().runner.stop(0.1)


def test_each_role_is_loaded_and_taken_and_truth_is_asked_for():
    one = np.zeros((60, 80), np.uint8)
    truth = Truth(np.zeros((60, 80, 3), np.float32), np.zeros((60, 80, 2), np.float32), one, one, one, np.eye(4))
    with Bench(truth=lambda role: truth) as bench:
        assert bench.scan(roles=("reference", "object"), truth=True) is None
    assert [frame_set.role for frame_set, _ in bench.sets] == ["reference", "object"]
    assert bench.fake.roles == ["reference", "object"]
    assert [t.frame_set for t in bench.truths] == [frame_set.id for frame_set, _ in bench.sets]


def test_full_disk_fails_the_scan_and_not_the_devices():
    with Bench() as bench:
        bench.full_disk = True
        assert isinstance(bench.scan(), StorageError)
        assert not bench.events  # taking it again would not help
        bench.full_disk = False
        assert bench.scan("next") is None
    assert bench.fake.opened == {"camera": 1, "projector": 1}


def test_unknown_latency_is_measured_once_and_used():
    with Bench(FakeRig(latency_s=0.055), latency_s=None) as bench:
        assert bench.scan("one") is None
        assert bench.scan("two") is None
        assert [event.name for event in bench.events] == ["latency.measured"]
        measured = bench.runner.latency
    assert measured.latency_s == pytest.approx(0.055, abs=measured.uncertainty_s + 0.001)
    assert all(s.exposure_start_s - s.flip_s >= 0.055 for frame_set, _ in bench.sets for s in frame_set.stamps)


def test_latency_that_is_set_too_short_is_found_by_the_check():
    with Bench(FakeRig(latency_s=0.2), retries=1) as bench:
        error = bench.scan()
    assert isinstance(error, QualityError)
    assert "latency" in error.message


def test_latency_is_measured_on_request():
    with Bench(FakeRig(latency_s=0.021)) as bench:
        bench.runner.calibrate_latency("cal", SETTINGS)
        assert bench.wait("cal") is None
        (event,) = bench.events
    assert event.detail["latency_s"] == pytest.approx(0.021, abs=event.detail["uncertainty_s"] + 0.001)


def test_new_configuration_holds_from_the_next_set():
    with Bench(retries=3) as bench:
        bench.runner.reconfigure(AcquisitionConfig(**KNOWN, retries=0), CheckConfig())
        bench.fake.order("blended", 12)
        assert isinstance(bench.scan(), QualityError)
        assert not bench.events


@pytest.mark.parametrize("fault", ["", "blended"])
def test_frames_that_come_too_early_are_counted_whether_the_set_is_good_or_not(fault):
    with Bench(retries=0) as bench:
        read, calls = bench.fake.camera.read, itertools.count(1)

        def counted(timeout_s):
            next(calls)
            return read(timeout_s)

        bench.fake.camera.read = counted
        if fault:
            bench.fake.order(fault, 2)  # the first one strikes a frame that is of no use anyway
        assert isinstance(bench.scan(), QualityError) == bool(fault)
        assert bench.unused == next(calls) - 1 - 12 > 0


def test_projector_that_fails_leaves_no_camera_armed_behind():
    with Bench(retries=1) as bench:
        camera, show, calls = bench.fake.camera, bench.fake.projector.show, itertools.count()
        arm, armed_twice = camera.arm, []

        def arm_once(settings):
            armed_twice.append(camera.settings is not None)
            return arm(settings)

        def fail_once(index):
            if next(calls) == 3:
                raise DeviceError("the lamp went out")
            return show(index)

        camera.arm, bench.fake.projector.show = arm_once, fail_once
        assert bench.scan() is None
        assert not any(armed_twice)
        wait_for(lambda: camera.settings is None)


@pytest.mark.parametrize("error", [UsageError("no such option"), StorageError("no such file")])
def test_driver_that_refuses_to_open_is_a_device_that_is_not_there(error):
    with Bench(retries=0) as bench:

        def refuse():
            raise error

        opened, bench.fake.camera.open = bench.fake.camera.open, refuse
        failed = bench.scan()
        assert isinstance(failed, DeviceError) and error.message in failed.message
        bench.fake.camera.open = opened
        assert bench.scan("next") is None


def test_rig_that_cannot_be_put_to_rest_is_opened_afresh():
    with Bench(retries=0) as bench:
        idle, calls = bench.fake.projector.idle, itertools.count()

        def refuse_to_rest():
            if next(calls) == 1:
                raise UsageError("not now")
            idle()

        bench.fake.projector.idle = refuse_to_rest
        assert bench.scan() is None
        assert bench.scan("next") is None
        assert bench.fake.opened["projector"] == 2


def test_mistake_in_the_thread_fails_what_waits_instead_of_leaving_it_for_ever():
    with Bench() as bench:

        def broken(scan):
            raise ZeroDivisionError("a bug of ours")

        bench.finished = broken
        bench.failed, failed = broken, bench.failed
        bench.runner._tell_failed = lambda scan, error: failed(scan, error) if "mistake" in error.message else broken(0)
        assert "mistake" in bench.scan().message
        with pytest.raises(AcquisitionError):
            bench.scan("next")


def test_only_one_thread_touches_the_devices():
    with Bench() as bench:
        bench.scan()
    assert bench.fake.threads == {"acquisition"}


def test_patterns_that_the_projector_refuses_fail_the_scan():
    frames = (PatternFrame("white"),)
    sequence = PatternSequence("test", WIDTH, HEIGHT, frames, (np.full((1, 1, 1), 255, np.uint8),))

    def refuse(*_):
        raise DeviceError("too large")

    with Bench(retries=0) as bench:
        bench.fake.projector.load = refuse
        error = bench.scan(sequence=sequence)
        assert isinstance(error, DeviceError) and "too large" in error.message
