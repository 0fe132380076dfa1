"""The driver "hitachi": the control in virtual time, composed with a video output that records calls."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hitachi_lab import Lab

from fringed.config import validate
from fringed.devices.projector.hitachi import HITACHI, HitachiOptions, HitachiProjector, create
from fringed.devices.projector.hitachi_options import control_of, transport_of
from fringed.emulators.cpx260_conversation import Manner
from fringed.errors import ConfigurationError, DeviceAbsent, DeviceError, UsageError
from fringed.hookspecs import Adjustable, Driver, Params, Projector, Watched
from fringed.protocols import hitachi_commands as codes
from fringed.transports.serial_port import SerialPort
from fringed.transports.tcp import TcpPort


class Output:
    """A video output that records what it was told."""

    simulated = False

    def __init__(self, size_px=(1024, 768)):
        self.size_px, self.calls, self.gone = size_px, [], False

    def open(self):
        self.calls.append("open")
        return "output"

    def close(self):
        self.calls.append("close")

    def load(self, sequence, role):
        self.calls.append(("load", role))

    def show(self, index):
        self.calls.append(("show", index))
        return 12.5

    def idle(self):
        self.calls.append("idle")

    def check(self):
        if self.gone:
            raise DeviceAbsent("the display has gone")


class Bench(Lab):
    def __init__(self, size_px=(1024, 768), manner=None, **options):
        super().__init__(manner=manner)
        self.options = HitachiOptions(port="/dev/projector", **options)
        self.output = Output(size_px)
        self.control = control_of(self.options, self.cable, self.clock)
        self.device = HitachiProjector(self.control, self.output, self.clock, self.options)

    def opened(self):
        """Open as the daemon does: again and again until it works."""
        for _ in range(100):
            try:
                self.identity = self.device.open()
                return self
            except DeviceError:
                self.device.close()
                self.clock.sleep(1.0)
        raise AssertionError("it never opened")


def test_it_is_a_projector_that_can_be_watched():
    bench = Bench()
    assert isinstance(bench.device, Watched)
    protocol: Projector = bench.device
    assert protocol.size_px == (1024, 768) and not protocol.simulated


def test_opening_switches_the_lamp_on_and_says_how_long_it_takes():
    bench = Bench()
    with pytest.raises(DeviceError, match=r"/dev/projector: the lamp warms up, ready in about 30 s; it is tried again"):
        bench.device.open()
    assert bench.device.lamp_state == "WARMING"
    assert bench.output.calls == []
    bench.device.close()
    bench.opened()
    assert bench.identity == "HITACHI projector at /dev/projector, lamp 812 h, filter 90 h; output"
    assert bench.device.lamp_state == "ON"
    assert bench.projector.counts["switched on"] == 1


def test_patterns_pass_through_to_the_output():
    bench = Bench().opened()
    bench.device.load(None, "object")
    assert bench.device.show(3) == 12.5
    bench.device.idle()
    bench.device.close()
    bench.device.close()
    assert bench.output.calls[-5:] == [("load", "object"), ("show", 3), "idle", "close", "close"]


def test_a_lamp_that_is_off_stays_off_where_the_options_say_so_until_it_is_switched_on():
    bench = Bench(power_on=False)
    assert bench.device.open() == "HITACHI projector at /dev/projector, its lamp off; output"
    bench.device.check()
    with pytest.raises(DeviceError, match=r"the lamp is off: switch it on, by `fringe device set projector lamp on`"):
        bench.device.load(None, "object")
    assert "switched on" not in bench.projector.counts
    bench.device.adjust("lamp", "on")
    with pytest.raises(DeviceError, match="the lamp warms up"):
        bench.device.check()
    bench.device.close()
    bench.opened().device.load(None, "object")


def test_a_lamp_that_somebody_switches_off_stays_off_until_it_is_switched_on_again():
    bench = Bench().opened()
    bench.projector._until = ("COOLING", bench.clock.now() + 90.0)  # the remote control
    bench.clock.sleep(11.0)
    with pytest.raises(DeviceError, match=r"cools down, ready in about .*; the projector is opened afresh"):
        bench.device.check()
    bench.device.close()
    assert "its lamp off" in bench.device.open()
    for _ in range(20):
        bench.clock.sleep(11.0)
        bench.device.check()
    assert bench.device.lamp_state == "STANDBY"
    assert bench.projector.counts["switched on"] == 1
    bench.projector._on = True  # the remote control again
    bench.clock.sleep(11.0)
    with pytest.raises(DeviceError, match="the lamp is on; the projector is opened afresh"):
        bench.device.check()
    bench.device.close()
    bench.opened().device.load(None, "object")


def test_a_projector_that_lost_its_mains_is_switched_on_again():
    bench = Bench().opened()
    bench.projector._on = False
    bench.clock.sleep(11.0)
    with pytest.raises(DeviceError, match="the lamp is off; it is tried again by itself"):
        bench.device.check()
    bench.device.close()
    bench.opened().device.load(None, "object")
    assert bench.projector.counts["switched on"] == 2


def test_settings_are_read_and_set():
    bench = Bench().opened()
    assert isinstance(bench.device, Adjustable)
    read = {setting.name: setting.value for setting in bench.device.settings()}
    assert read == {
        "lamp": "on", "error": "normal", "lamp_hours": 812, "filter_hours": 90, "input": "rgb1", "blank": False,
        "freeze": False, "picture": "neutral",
    }  # fmt: skip
    assert not any(setting.verified for setting in bench.device.settings())
    bench.projector.registers[codes.KEYSTONE] = 4
    for name, value in (("input", "rgb2"), ("blank", True), ("freeze", True)):
        bench.device.adjust(name, value)
    read = {setting.name: setting.value for setting in bench.device.settings()}
    assert (read["input"], read["blank"], read["freeze"]) == ("rgb2", True, True)
    assert "keystone is 4" in read["picture"]
    bench.device.adjust("picture", "neutral")
    assert bench.projector.registers[codes.KEYSTONE] == 0
    with pytest.raises(UsageError, match="projector lamp_hours can be read only"):
        bench.device.adjust("lamp_hours", 3)


def test_the_lamp_is_switched_off_by_its_setting_and_tells_less_then():
    bench = Bench().opened()
    bench.device.adjust("lamp", "standby")
    assert [setting.name for setting in bench.device.settings()] == ["lamp", "error", "lamp_hours", "filter_hours"]
    with pytest.raises(UsageError, match=r"cools down, ready in about .* it can be switched then"):
        bench.device.adjust("lamp", "on")
    bench.device.close()
    assert "its lamp off" in bench.device.open()
    bench.clock.sleep(100.0)
    bench.device.adjust("lamp", "on")
    with pytest.raises(UsageError, match=r"warms up.* it can be switched then"):
        bench.device.adjust("lamp", "standby")


def test_blank_freeze_and_another_input_are_undone_at_opening():
    bench = Bench(input="rgb2").opened()
    assert bench.projector.registers[codes.INPUT] == 4
    bench.device.close()
    bench.projector.registers |= {codes.BLANK: 1, codes.FREEZE: 1, codes.INPUT: 2}
    bench.opened()
    registers = bench.projector.registers
    assert (registers[codes.BLANK], registers[codes.FREEZE], registers[codes.INPUT]) == (0, 0, 4)


def test_a_keystone_that_somebody_sets_stops_the_next_set_and_says_what_to_reset():
    bench = Bench(recheck_s=10.0).opened()
    bench.projector.registers[codes.KEYSTONE] = 9
    bench.clock.sleep(11.0)
    with pytest.raises(
        DeviceError, match=r"nothing is measured: keystone is 9; expected 0 .resamples every pixel.\. Reset"
    ):
        bench.device.load(None, "object")
    bench.projector.registers[codes.KEYSTONE] = 0
    bench.device.load(None, "object")


def test_it_resets_the_picture_where_the_options_say_so_and_judges_nothing_where_they_say_that():
    bench = Bench(reset_picture=True)
    bench.projector.registers |= {codes.KEYSTONE: 9, codes.MAGNIFY: 5}
    bench.opened()
    assert bench.projector.registers[codes.KEYSTONE] == bench.projector.registers[codes.MAGNIFY] == 0
    bench = Bench(check_picture=False)
    bench.projector.registers[codes.KEYSTONE] = 9
    bench.opened()
    assert bench.projector.registers[codes.KEYSTONE] == 9


def test_errors_stop_and_warnings_are_logged(caplog):
    bench = Bench().opened()
    bench.device.close()
    bench.projector.registers[codes.ERRORS] = 4
    with pytest.raises(DeviceError, match=r"reports an error: it is too hot. Mend that first"):
        bench.device.open()
    bench.projector.registers[codes.ERRORS] = 8
    bench.opened()
    assert "works, and reports: the filter is clogged or due" in caplog.text


def test_an_output_of_another_size_would_be_resampled_and_is_refused():
    bench = Bench(size_px=(1280, 720))
    with pytest.raises(AssertionError, match="never opened"):
        bench.opened()
    with pytest.raises(
        DeviceError, match="has 1280 x 720 pixels and the projector's panel 1024 x 768: it would resample"
    ):
        bench.device.open()


def test_checking_sees_a_lost_line_and_a_lost_output():
    bench = Bench().opened()
    bench.device.check()
    bench.cable.plugged = False
    with pytest.raises(DeviceAbsent):
        bench.device.check()
    bench.cable.plugged = True
    bench.device.check()
    bench.output.gone = True
    with pytest.raises(DeviceAbsent, match="the display has gone"):
        bench.device.check()


def test_checking_keeps_a_network_port_from_hanging_up():
    bench = Bench(manner=Manner(0, wrapped=True, idle_s=30.0), framing="wrapped").opened()
    openings = bench.cable.openings
    for _ in range(200):
        bench.clock.sleep(0.4)
        bench.device.check()
    assert bench.cable.openings == openings


@pytest.mark.parametrize(
    ("raw", "told"),
    [
        ({}, "neither port nor host is not allowed; expected one of them: port = "),
        ({"port": "/dev/x", "host": "h"}, "both port and host"),
        ({"port": "/dev/x", "password": "p"}, "serial ports know no passwords"),
        ({"port": "/dev/x", "neutral": {"colour": 3}}, "projector.options.neutral.colour: this key"),
        ({"port": "/dev/x", "output_driver": "hitachi"}, "'hitachi' is not allowed; expected a video output: 'window'"),
        ({"port": "/dev/x", "input": "hdmi"}, "projector.options.input: 'hdmi' is not allowed; expected"),
        ({"port": "/dev/x", "keep_alive_s": 30}, "projector.options.keep_alive_s"),
        ({"port": "/dev/x", "unchecked": ["colour"]}, "projector.options.unchecked"),
    ],
)
def test_options_that_cannot_be_meant_say_what_can(raw, told):
    with pytest.raises(ConfigurationError) as caught:
        create(validate(raw, HITACHI.Options, "projector.options"), SimpleNamespace(station="s", clock=None))
    assert told in str(caught.value)


def test_the_options_choose_transport_and_framing():
    serial, network = HitachiOptions(port="usb:serial=A5"), HitachiOptions(host="10.0.0.5", tcp_port=9715, password="p")
    assert isinstance(transport_of(serial), SerialPort) and transport_of(serial).name == "usb:serial=A5"
    assert isinstance(transport_of(network), TcpPort) and transport_of(network).name == "tcp://10.0.0.5:9715"


def test_the_video_output_is_built_by_its_own_driver(monkeypatch):
    class OutputOptions(Params, frozen=True):
        display: int = 0

    made = []
    driver = Driver("tube", OutputOptions, lambda options, context: made.append((options, context.station)) or Output())
    monkeypatch.setattr("fringed.devices.building.built_in", lambda kind, name: driver if name == "tube" else None)
    context = SimpleNamespace(station="s", clock=None)
    raw = {"port": "/dev/x", "output_driver": "tube", "output": {"display": 2}}
    device = create(validate(raw, HITACHI.Options, "projector.options"), context)
    assert device.size_px == (1024, 768)
    assert made == [(OutputOptions(display=2), "s")]
    with pytest.raises(ConfigurationError, match=r"projector.options.output.colour: this key"):
        create(validate({**raw, "output": {"colour": 1}}, HITACHI.Options, "projector.options"), context)
