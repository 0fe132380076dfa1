"""Pixel formats, settings, counters and times of GenICam cameras, against known truth."""

import numpy as np
import pytest
from fake_genicam import Feature, Genicam, modern
from hypothesis import given
from hypothesis import strategies as st

from fringed.data import CameraSettings
from fringed.devices.camera.gige_gvcp import answer, is_address, request
from fringed.devices.camera.gige_pixels import BY_CODE, BY_NAME, FORMATS, choose, image_of
from fringed.devices.camera.gige_settings import Region, Wishes, apply, set_rate, set_region
from fringed.devices.camera.gige_times import CameraTime, FrameIds
from fringed.errors import DeviceError, ProtocolError, UsageError


def pack_lsb(numbers, bits):
    whole = sum(int(number) << place * bits for place, number in enumerate(numbers))
    return np.frombuffer(whole.to_bytes(-(-len(numbers) * bits // 8), "little"), np.uint8)


def pack_gige(numbers, bits):
    few, out = bits - 8, []
    for first, second in zip(numbers[::2], [*numbers[1::2], 0], strict=False):
        mask = (1 << few) - 1
        out += [first >> few, (first & mask) | (second & mask) << 4, second >> few]
    return np.array(out, np.uint8)


def test_known_bytes_of_each_packing():
    assert image_of(np.array([0xAB, 0x21, 0xCD], np.uint8), (2, 1), BY_NAME["Mono12Packed"], "white").tolist() == [
        [0xAB1, 0xCD2]
    ]
    assert image_of(np.array([0xAB, 0xDC, 0xEF], np.uint8), (2, 1), BY_NAME["Mono12p"], "white").tolist() == [
        [0xCAB, 0xEFD]
    ]
    assert image_of(np.array([0x34, 0x02], np.uint8), (1, 1), BY_NAME["Mono10"], "white").tolist() == [[0x234]]


@given(
    name=st.sampled_from(["Mono10p", "Mono12p", "Mono10Packed", "Mono12Packed", "Mono10", "Mono12", "Mono16", "Mono8"]),
    size=st.tuples(st.integers(1, 9), st.integers(1, 5)),
    seed=st.integers(0, 2**32 - 1),
    padding=st.integers(0, 4),
)
def test_what_is_packed_is_unpacked(name, size, seed, padding):
    form = BY_NAME[name]
    numbers = np.random.default_rng(seed).integers(0, 2**form.bits, size[0] * size[1])
    data = {
        "bytes": lambda: numbers.astype(np.uint8),
        "words": lambda: numbers.astype("<u2").view(np.uint8),
        "lsb": lambda: pack_lsb(numbers, form.bits),
        "gige": lambda: pack_gige(numbers.tolist(), form.bits),
    }[form.layout]()
    padded = np.concatenate([data, np.full(padding, 255, np.uint8)])
    image = image_of(padded, size, form, "white")
    assert image.dtype == (np.uint8 if form.bits == 8 else np.uint16)
    assert image.tolist() == numbers.reshape(size[1], size[0]).tolist()
    with pytest.raises(ProtocolError, match=f"numbers in {name} are"):
        image_of(data[:-1], size, form, "white")


@pytest.mark.parametrize("tile", ["RG", "GR", "GB", "BG"])
@pytest.mark.parametrize("bits", [8, 12])
def test_the_tile_of_a_colour_sensor_gives_its_colours(tile, bits):
    colours = {"R": 50, "G": 100, "B": 200}
    rows = {"RG": ("RG", "GB"), "GR": ("GR", "BG"), "GB": ("GB", "RG"), "BG": ("BG", "GR")}[tile]
    plane = np.tile([[colours[name] for name in row] for row in rows], (4, 4))
    form = BY_NAME[f"Bayer{tile}{bits}"]
    data = plane.astype(np.uint8 if bits == 8 else "<u2").view(np.uint8).reshape(-1)
    image = image_of(data, (8, 8), form, "rgb")
    assert image[2:6, 2:6].reshape(-1, 3).tolist() == [[50, 100, 200]] * 16
    assert (image_of(data, (8, 8), form, "blue")[2:6, 2:6] == 200).all()


def test_every_format_is_one():
    assert len({one.name for one in FORMATS}) == len(FORMATS)
    for form in FORMATS:
        per_pixel = form.code >> 16 & 0xFF  # the code tells the bits of a pixel
        stored = {"bytes": 8, "words": 16, "lsb": form.bits, "gige": 12}[form.layout]
        assert per_pixel == stored * form.channels, form
        assert BY_CODE[form.code].bits == form.bits


@pytest.mark.parametrize(
    ("names", "bits", "channel", "chosen"),
    [
        (("Mono8", "Mono12"), 12, "green", ("Mono12", "white")),
        (("Mono12", "Mono12p"), 12, "white", ("Mono12p", "white")),
        (("Mono8", "RGB8", "BayerRG8"), 8, "green", ("RGB8", "green")),
        (("Mono8", "BayerRG8"), 8, "rgb", ("BayerRG8", "rgb")),
        (("Mono8", "BayerRG8", "BayerRG12p"), 12, "red", ("BayerRG12p", "red")),
        (("YUV422", "Mono8"), 8, "white", ("Mono8", "white")),
    ],
)
def test_the_format_is_chosen_by_bits_and_channel(names, bits, channel, chosen):
    form, given_channel = choose(names, bits, channel)
    assert (form.name, given_channel) == chosen


@pytest.mark.parametrize(
    ("names", "bits", "channel", "words"),
    [
        (("Mono8",), 12, "white", r"has Mono8 \(8 bits\)"),
        (("Mono8",), 8, "rgb", "channel 'rgb'"),
        (("BayerRG8",), 8, "white", "channel 'white'"),
        (("YUV422",), 8, "white", "it has YUV422"),
        (("Mono12", "BayerRG8"), 12, "green", "channel 'green' with 12 bits"),
    ],
)
def test_a_format_that_it_has_not_is_refused_with_those_that_it_has(names, bits, channel, words):
    with pytest.raises(UsageError, match=words):
        choose(names, bits, channel)


def set_up(features=None, wishes=None, **settings):
    port = Genicam(features or modern())
    asked = CameraSettings(**{"exposure_us": 5000.0, "channel": "white", **settings})
    return port, apply(port, asked, wishes or Wishes(Region(64, 48)))


def test_everything_automatic_is_off_and_the_response_is_straight():
    port, in_force = set_up()
    values = {name: feature.value for name, feature in port.features.items()}
    assert (values["ExposureAuto"], values["GainAuto"], values["ExposureMode"]) == ("Off", "Off", "Timed")
    assert (values["Gamma"], values["GainSelector"], values["AcquisitionMode"]) == (1.0, "All", "Continuous")
    assert (values["TriggerMode"], values["OffsetX"], values["Width"]) == ("Off", 0, 64)
    assert in_force.size_px == (64, 48)


def test_a_trigger_by_software_and_by_a_line():
    port, in_force = set_up(trigger="software")
    assert port.features["TriggerSource"].value == "Software"
    assert (port.features["TriggerMode"].value, port.features["TriggerSelector"].value) == ("On", "FrameStart")
    assert in_force.period_s == pytest.approx(1 / 40 + 0.005)
    port, _ = set_up(trigger="hardware")
    assert port.features["TriggerSource"].value == "Line1"
    with pytest.raises(UsageError, match="by 'Line7'; it has Software, Line0, Line1"):
        set_up(trigger="hardware", wishes=Wishes(trigger_line="Line7"))
    features = modern()
    del features["TriggerMode"]
    with pytest.raises(UsageError, match="no trigger"):
        set_up(features, trigger="software")


def test_a_region_and_a_region_that_it_cannot_have():
    port = Genicam()
    assert set_region(port, Region()) == (1280, 1024)
    assert set_region(port, Region(640, 480, 320, 200)) == (640, 480)
    assert (port.features["OffsetX"].value, port.features["OffsetY"].value) == (320, 200)
    with pytest.raises(UsageError, match="Width of 2000 was asked for; the camera has 16 to 1280"):
        set_region(port, Region(2000, 480))
    port.features["Height"].stuck = True
    with pytest.raises(UsageError, match=r"640 x 100 .* makes it 640 x 480"):
        set_region(port, Region(640, 100))


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"exposure_us": 5.0}, "ExposureTime has 20 to 1e.06"), ({"gain_db": 30.0}, "Gain has 0 to 24")],
)
def test_values_beyond_the_limits_are_refused_with_the_limits(settings, words):
    with pytest.raises(UsageError, match=words):
        set_up(**settings)


def test_a_value_that_the_camera_does_not_take_is_named():
    features = modern()
    features["ExposureTime"].stuck = True
    with pytest.raises(DeviceError, match=r"5000 us was asked for, the camera makes it 15000 us"):
        set_up(features)
    features = modern()
    features["ExposureAuto"].entries = ("Continuous",)
    with pytest.raises(DeviceError, match="does not take Off as its ExposureAuto"):
        set_up(features)
    features = modern()
    del features["ExposureTime"]
    with pytest.raises(DeviceError, match="none of ExposureTime, ExposureTimeAbs, ExposureTimeRaw"):
        set_up(features)


def test_older_names_are_known():
    features = modern()
    features["ExposureTimeRaw"], features["GainRaw"] = Feature(1, (10, 100_000)), Feature(300, (100, 400))
    features["AcquisitionFrameRateAbs"] = features.pop("AcquisitionFrameRate")
    for name in ("ExposureTime", "Gain", "ResultingFrameRate"):
        del features[name]
    port, in_force = set_up(features, Wishes(fps=20.0, gain_step_db=0.1), gain_db=12.0)
    assert port.features["GainRaw"].value == 220
    assert port.features["ExposureTimeRaw"].value == 5000
    assert in_force.period_s == pytest.approx(0.05)
    with pytest.raises(UsageError, match="gain_step_db"):
        set_up(features, gain_db=12.0)
    del features["GainRaw"]
    with pytest.raises(UsageError, match="no gain"):
        set_up(features, gain_db=12.0)


def test_the_rate_and_the_period_that_follows():
    port = Genicam()
    del port.features["ResultingFrameRate"]
    assert set_rate(port, 50.0, True, 0.001) == pytest.approx(0.02)
    assert port.features["AcquisitionFrameRateEnable"].value is True
    assert set_rate(port, 50.0, True, 0.1) == pytest.approx(0.1)
    assert set_rate(port, 0.0, False, 0.005) == pytest.approx(0.01 + 0.005)
    with pytest.raises(UsageError, match=r"camera\.options\.fps: 500 .* has 1 to 100"):
        set_rate(port, 500.0, True, 0.001)
    del port.features["AcquisitionFrameRate"]
    with pytest.raises(UsageError, match="rate cannot be set"):
        set_rate(port, 50.0, True, 0.001)
    assert set_rate(port, 0.0, True, 0.005) == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("ids", "steps"),
    [
        ([5, 6, 8], [1, 2]),
        ([65534, 65535, 1, 2], [1, 1, 1]),
        ([65535, 3], [3]),
        ([7, 7, 8], [0, 1]),
        ([900, 0, 1], [1, 1]),  # it began anew
        ([2**40, 2**40 + 1, 0], [1, 1]),
    ],
)
def test_ids_wrap_and_begin_anew(ids, steps):
    counting = FrameIds()
    assert np.diff([counting.count(one) for one in ids]).tolist() == steps


def test_the_cameras_clock_is_followed_though_it_drifts():
    ours, drift = CameraTime(), 1e-4
    rng = np.random.default_rng(1)
    for k in range(2000):
        true_s = 0.1 * k
        late_s = float(rng.exponential(0.002))
        told_s = ours.arrival_s(int((true_s * (1 + drift) + 7.0) * 1e9), true_s + late_s)
        assert told_s <= true_s + late_s + 1e-6
        assert told_s >= true_s - 32 * 0.1 * drift - 1e-6  # at most what it drifts over the window
    assert CameraTime().arrival_s(0, 12.5) == 12.5


def test_a_camera_is_asked_who_controls_it():
    assert request(2).hex(" ") == "42 01 00 80 00 04 00 02 00 00 0a 00"
    told = bytes.fromhex("0000 0081 0004 0002 00000002")
    assert answer(told, 2) == 2
    for other in (b"", told[:-1], told + b"\0", bytes.fromhex("8006") + told[2:], bytes(12)):
        assert answer(other, 2) is None
    assert answer(told, 3) is None
    assert is_address("10.0.0.7")
    assert not is_address("Maker-Model-1")


@given(st.binary(max_size=40))
def test_any_datagram_is_an_answer_or_none(data):
    value = answer(data, 1)
    assert value is None or 0 <= value < 2**32
