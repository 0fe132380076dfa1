"""`fringed doctor` on the ports and hosts that a configuration names."""

from __future__ import annotations

import pytest

from fringed.cli.doctor_configured import configured_findings, panel_px
from fringed.config import StationConfig, validate
from fringed.errors import DeviceAbsent
from fringed.finding import Machine, User

UNIT = "[Service]\nIPAddressDeny=any\nIPAddressAllow=localhost\n"


def findings(root, values, find_port=lambda name: name):
    config = validate(values, StationConfig)
    machine = Machine(root, User("root", 0, frozenset()))
    found = {item.what: item for item in configured_findings(config, machine, find_port)}
    assert all(item.do for item in found.values() if item.level != "ok")
    return found


def projector(**options):
    return {"projector": {"driver": "hitachi", "options": options}}


def service(root, drop_in=""):
    folder = root / "etc/systemd/system"
    (folder / "fringed.service.d").mkdir(parents=True)
    (folder / "fringed.service").write_text(UNIT)
    (folder / "fringed.service.d" / "override.conf").write_text(f"[Service]\n{drop_in}\n")


def test_port_that_is_there_is_said_with_its_node(tmp_path):
    found = findings(tmp_path, projector(port="usb:serial=FTA1"), lambda name: "/dev/null")
    assert found["port of the projector"].found == "usb:serial=FTA1: /dev/null"


def test_port_that_is_not_there_repeats_what_the_driver_would_say(tmp_path):
    def absent(name):
        raise DeviceAbsent(f"no serial port fits {name}; there are: none")

    found = findings(tmp_path, projector(port="usb:serial=X"), absent)["port of the projector"]
    assert found.level == "warn" and "no serial port fits usb:serial=X" in found.found


def test_real_finder_is_used(tmp_path):
    found = findings(tmp_path, projector(port="/dev/fringed/nowhere"), None)
    assert "there is no /dev/fringed/nowhere" in found["port of the projector"].found


def test_options_that_name_nothing_say_nothing(tmp_path):
    assert findings(tmp_path, {}) == {}
    assert findings(tmp_path, projector(port="", host="")) == {}
    assert findings(tmp_path, projector(host="10.0.0.5")) == {}  # no service is installed


@pytest.mark.parametrize(
    ("drop_in", "host", "level"),
    [
        ("", "10.0.0.5", "warn"),
        ("", "beamer", "warn"),
        ("IPAddressAllow=10.0.0.0/24", "10.0.0.5", "ok"),
        ("IPAddressAllow=192.168.7.0/24", "10.0.0.5", "warn"),
        ("IPAddressAllow=10.0.0.5", "beamer", "ok"),
        ("IPAddressAllow=any", "10.0.0.5", "ok"),
    ],
)
def test_host_that_the_service_may_not_reach(tmp_path, drop_in, host, level):
    service(tmp_path, drop_in)
    assert findings(tmp_path, projector(host=host))["host of the projector"].level == level


def test_clients_over_tcp_need_their_network(tmp_path):
    service(tmp_path)
    tcp = {"tcp": {"bind": "0.0.0.0", "keys_dir": "/etc/fringed/keys"}}
    assert findings(tmp_path, tcp)["clients over TCP"].level == "warn"
    assert findings(tmp_path, {"tcp": tcp["tcp"] | {"bind": "127.0.0.1"}}) == {}


def test_panel_is_the_driver_s_option_or_the_cp_x260_s():
    assert panel_px({}) == (1024, 768)
    assert panel_px({"size_px": [1920, 1080]}) == panel_px({"panel_px": [1920, 1080]}) == (1920, 1080)
    assert panel_px({"size_px": "wide"}) == (1024, 768)
