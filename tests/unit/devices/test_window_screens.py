"""Which display is meant, what is refused, and whether flips follow a refresh."""

import pytest

from fringed.display.environment import backend
from fringed.display.pacing import locking, measured
from fringed.display.screens import (
    Connector,
    Screen,
    chosen,
    connectors,
    doubts,
    hints,
    is_connected,
    require_8_bits,
    watched,
)
from fringed.errors import DeviceAbsent

PANEL = (1024, 768)
LAPTOP, PROJECTOR = Screen(0, "eDP-1", (1920, 1080), 60), Screen(1, "HDMI-1", PANEL, 60)


@pytest.mark.parametrize("wanted", [1, "HDMI-1"])
def test_displays_are_told_apart_by_index_and_by_name(wanted):
    assert chosen([LAPTOP, PROJECTOR], wanted, PANEL, "x11") is PROJECTOR


def test_a_desktop_of_another_size_is_refused_with_both_sizes():
    with pytest.raises(DeviceAbsent, match=r"desktop of 1920 x 1080; the patterns need 1024 x 768.*HDMI-1"):
        chosen([LAPTOP, PROJECTOR], 0, PANEL, "x11")


@pytest.mark.parametrize(("screens", "seen"), [([], "none"), ([LAPTOP], "0 'eDP-1' 1920 x 1080")])
def test_a_display_that_is_not_there_is_named_with_those_that_are(screens, seen):
    with pytest.raises(DeviceAbsent, match=f"no display 'HDMI-1'; x11 has: {seen}"):
        chosen(screens, "HDMI-1", PANEL, "x11")


def test_two_displays_of_one_name_need_an_index():
    twins = [Screen(0, "CP-X260", PANEL, 60), Screen(1, "CP-X260", PANEL, 60)]
    with pytest.raises(DeviceAbsent, match=r"2 displays are called 'CP-X260'.*index"):
        chosen(twins, "CP-X260", PANEL, "x11")
    assert chosen(twins, 1, PANEL, "x11") is twins[1]


@pytest.mark.parametrize(("masks", "ok"), [((0xFF0000, 0xFF00, 0xFF, 0), True), ((0xF800, 0x7E0, 0x1F, 0), False)])
def test_a_desktop_of_another_depth_is_refused(masks, ok):
    if ok:
        require_8_bits(masks, "x11")
    else:
        with pytest.raises(DeviceAbsent, match="5, 6 and 5 bits"):
            require_8_bits(masks, "x11")


def plug(folder, name, status="connected", modes="1024x768\n800x600\n", number=1):
    path = folder / name
    path.mkdir(parents=True)
    for file, text in (("status", status + "\n"), ("modes", modes), ("connector_id", f"{number}\n")):
        (path / file).write_text(text)
    return path


def test_connectors_are_read_as_the_kernel_lists_them(tmp_path):
    plug(tmp_path, "card0-HDMI-A-1", number=98)
    plug(tmp_path, "card0-DP-1", "disconnected", "", number=90)
    (tmp_path / "card0").mkdir()
    found = connectors(tmp_path)
    assert [one.name for one in found] == ["card0-DP-1", "card0-HDMI-A-1"]
    assert found[1] == Connector("card0-HDMI-A-1", True, (PANEL, (800, 600)))
    assert is_connected(tmp_path / "card0-HDMI-A-1") and not is_connected(tmp_path / "card0-DP-1")
    assert not is_connected(tmp_path / "card1-DP-1")
    assert connectors(tmp_path / "nothing") == ()


HDMI, DP = Connector("card0-HDMI-A-1", True, (PANEL,)), Connector("card0-DP-1", True, ((1920, 1080), PANEL))
EMPTY = Connector("card0-DP-2", False, ())


@pytest.mark.parametrize(
    ("found", "wanted", "expected"),
    [
        ((HDMI, DP), "auto", HDMI),  # by name
        ((DP, EMPTY), "auto", DP),  # the only one
        ((DP, Connector("card1-VGA-1", True, ())), "auto", None),
        ((HDMI, DP), "card0-DP-1", DP),
        ((HDMI,), "", None),
        ((), "auto", None),
    ],
)
def test_the_connector_of_a_display(found, wanted, expected):
    assert watched(found, wanted, PROJECTOR) is expected


@pytest.mark.parametrize(("wanted", "text"), [("card0-DP-2", "nothing is plugged into"), ("card9", "there is no")])
def test_a_connector_that_cannot_be_is_refused_with_those_that_are(wanted, text):
    with pytest.raises(DeviceAbsent, match=f"{text} connector.*card0-HDMI-A-1 connected, card0-DP-2 empty"):
        watched((HDMI, EMPTY), wanted, PROJECTOR)


def test_a_panel_without_that_size_is_refused_and_another_preference_is_doubted():
    assert doubts(HDMI, PANEL, "x11") == doubts(None, PANEL, "x11") == ()
    assert "prefers 1920 x 1080" in doubts(DP, PANEL, "kmsdrm")[0]
    assert "may scale unseen" in doubts(None, PANEL, "wayland")[0]
    with pytest.raises(DeviceAbsent, match="no mode of 640 x 480; it has 1024 x 768"):
        doubts(HDMI, (640, 480), "x11")
    with pytest.raises(DeviceAbsent, match="scaled by the compositor"):
        doubts(DP, PANEL, "wayland")


def test_each_backend_that_fails_says_what_to_do(tmp_path):
    assert "no graphics driver" in hints("kmsdrm", {}, tmp_path)
    (tmp_path / "card0").touch()
    assert "holds the display" in hints("kmsdrm", {}, tmp_path)
    assert "x_display" in hints("x11", {"DISPLAY": ":7"}) and ":7" in hints("x11", {"DISPLAY": ":7"})
    assert "WAYLAND_DISPLAY" in hints("wayland", {})
    assert "backend" in hints("svga", {})


@pytest.mark.parametrize(
    ("wanted", "environment", "expected"),
    [
        ("auto", {}, "kmsdrm"),
        ("auto", {"DISPLAY": ":0"}, "x11"),
        ("auto", {"DISPLAY": ":0", "WAYLAND_DISPLAY": "wayland-0"}, "wayland"),
        ("x11", {"WAYLAND_DISPLAY": "wayland-0"}, "x11"),
    ],
)
def test_auto_takes_the_session_or_the_card(wanted, environment, expected):
    assert backend(wanted, environment) == expected


class Display:
    """A display in virtual time whose driver queues `depth` flips; `refresh` False: each flip is there at once."""

    def __init__(self, depth, refresh=True, period=1 / 60, copy=0.001, every_missed=0):
        self.now, self.depth, self.refresh, self.period, self.copy = 0.0137, depth, refresh, period, copy
        self.every_missed, self.count, self.pending = every_missed, 0, []

    def present(self):
        self.now += self.copy + 1e-4 * (self.count % 3)
        self.count += 1
        if not self.refresh:
            return self.now
        late = self.period if self.every_missed and self.count % self.every_missed == 0 else 0.0
        self.pending = [flip for flip in self.pending if flip > self.now]
        after = max([self.now + late, *self.pending])
        self.pending.append((int(after / self.period + 1e-6) + 1) * self.period)
        if len(self.pending) > self.depth:
            self.now = self.pending[-1 - self.depth]
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.mark.parametrize("depth", [0, 1, 2])
@pytest.mark.parametrize("period", [1 / 50, 1 / 60.004, 1 / 120])
def test_a_refresh_is_found_with_the_depth_of_the_drivers_queue(depth, period):
    display = Display(depth, period=period, every_missed=17)
    pace = measured(display.present, display.sleep, 1 / 60)
    assert pace.depth == depth
    assert pace.interval_s == pytest.approx(period, rel=1e-3)


@pytest.mark.parametrize("copy", [0.0001, 0.005, 0.0163, 0.03])
def test_flips_that_follow_no_refresh_are_not_believed(copy):
    display = Display(0, refresh=False, copy=copy)
    assert measured(display.present, display.sleep, 1 / 60).depth == -1


def test_locking_is_one_at_one_phase_and_small_at_spread_phases():
    assert locking([0.3, 1.3, 7.3], 1.0) == pytest.approx(1.0)
    assert locking([k * 0.618 for k in range(12)], 1.0) < 0.3
