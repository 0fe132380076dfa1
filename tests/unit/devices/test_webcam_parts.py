"""How webcams are found, their frames timed and counted, and their pictures read."""

import cv2
import numpy as np
import pytest

from fringed.devices.camera.webcam_capture import find, open_v4l2
from fringed.devices.camera.webcam_pictures import picture_of
from fringed.devices.camera.webcam_reader import Counting, Exposing
from fringed.errors import DeviceAbsent, ProtocolError


def test_devices_are_found_by_path_by_name_and_alone(tmp_path):
    folder = tmp_path / "by-id"
    with pytest.raises(DeviceAbsent, match="no webcam is plugged in"):
        find("", folder)
    folder.mkdir()
    for name in ("usb-Maker_A-video-index0", "usb-Maker_A-video-index1"):
        (folder / name).touch()
    assert find("", folder) == str(folder / "usb-Maker_A-video-index0")
    assert find("usb-Maker_A-video-index1", folder).endswith("index1")
    assert find(str(folder / "usb-Maker_A-video-index0"), folder).endswith("index0")
    with pytest.raises(DeviceAbsent, match=r"video9 is not there; plugged in are usb-Maker_A"):
        find("/dev/video9", folder)
    (folder / "usb-Maker_B-video-index0").touch()
    with pytest.raises(DeviceAbsent, match="name one of them"):
        find("", folder)


def test_the_real_opencv_has_what_is_used_of_it(tmp_path):
    capture = open_v4l2(str(tmp_path / "none"))
    assert not capture.isOpened()
    assert capture.set(cv2.CAP_PROP_GAIN, 1.0) is False
    assert capture.get(cv2.CAP_PROP_GAIN) <= 0
    assert capture.grab() is False
    assert capture.retrieve()[0] is False
    capture.release()


def test_losses_show_in_the_counters_once_the_pace_is_known():
    counting = Counting()
    stamps = [k * 0.1 for k in range(12)] + [1.5, 1.6]
    assert [counting.next(stamp) for stamp in stamps][-3:] == [11, 15, 16]
    assert counting.next(None) == 17


@pytest.mark.parametrize(
    ("stamp_s", "start_s"), [(10.0, 9.9), (0.0, 9.85), (10.2, 9.85), (3.0, 9.85)], ids=["good", "none", "future", "old"]
)
def test_a_stamp_of_another_clock_is_not_used(stamp_s, start_s):
    assert Exposing(0.1, 0.2).window_s(stamp_s, 10.05) == pytest.approx((start_s, 10.05))
    end_s = 10.04 if start_s == 9.9 else 10.05
    assert Exposing(0.1, 0.2, 0.14).window_s(stamp_s, 10.05) == pytest.approx((start_s, end_s))
    assert Exposing(0.1, 0.2, 0.14, use_stamps=False).window_s(stamp_s, 10.05) == pytest.approx((9.85, 10.05))


@pytest.mark.parametrize(("fourcc", "place"), [("YUYV", 0), ("UYVY", 1)])
def test_the_brightness_of_uncompressed_frames_is_not_converted(fourcc, place):
    raw = np.zeros((2, 3, 2), np.uint8)
    raw[:, :, place] = [[1, 2, 3], [4, 5, 255]]
    for shape in ((2, 3, 2), (1, 12), (12,)):
        assert picture_of(raw.reshape(shape), (3, 2), fourcc, "white").tolist() == [[1, 2, 3], [4, 5, 255]]
    grey = np.arange(6, dtype=np.uint8)
    assert picture_of(grey, (3, 2), "GREY", "white").tolist() == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(ProtocolError, match="NoneType"):
        picture_of(None, (3, 2), fourcc, "white")
    with pytest.raises(ProtocolError, match="uint16"):
        picture_of(grey.astype(np.uint16), (3, 2), fourcc, "white")
