"""The serial transport on pseudo-terminals."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import tty
from contextlib import suppress
from errno import EACCES

import pytest
import serial

from fringed.errors import DeviceAbsent, DeviceError, UsageError
from fringed.transports import serial_port
from fringed.transports.serial_port import SerialPort, SerialSettings

PATIENCE_S = 10.0


@pytest.fixture
def line():
    """Yield a pseudo-terminal's master and the name of its slave, which nobody has open."""
    master, slave = os.openpty()
    name = os.ttyname(slave)
    tty.setraw(slave)
    os.close(slave)
    yield master, name
    with suppress(OSError):
        os.close(master)


def test_bytes_pass_both_ways_unchanged(line):
    master, name = line
    port = SerialPort(name)
    port.open()
    every = bytes(range(256))
    port.write(every)
    assert os.read(master, 1000) == every
    os.write(master, every)
    got = b""
    while len(got) < 256:
        got += port.read(PATIENCE_S)
    assert got == every
    assert port.read(0.0) == b""
    port.close()
    port.close()
    with pytest.raises(DeviceAbsent, match="is closed: open it"):
        port.read(0)


def test_it_opens_again_after_it_was_closed(line):
    master, name = line
    port = SerialPort(name, SerialSettings(9600))
    for _ in range(3):
        port.open()
        port.open()
        port.write(b"x")
        assert os.read(master, 10) == b"x"
        port.close()


def test_an_unplugged_line_is_absent_at_once(line):
    master, name = line
    port = SerialPort(name)
    port.open()
    os.close(master)
    with pytest.raises(DeviceAbsent, match="was unplugged, or its adapter failed"):
        port.read(PATIENCE_S)
    with pytest.raises(DeviceAbsent, match="is closed: open it"):
        port.write(b"x")


def test_a_port_that_another_program_holds_names_it(line):
    _, name = line
    holder = subprocess.Popen(
        [sys.executable, "-c", f"f=open({name!r},'rb',0); print('held',flush=True); input()"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    with holder:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(DeviceAbsent, match=rf"is taken by python\S* \(pid {holder.pid}\): end it"):
            SerialPort(name).open()
        holder.stdin.close()
    port = SerialPort(name)
    port.open()
    port.close()


def test_a_port_that_this_program_holds_elsewhere_is_taken(line):
    _, name = line
    first = serial.Serial(name, exclusive=True)
    with pytest.raises(DeviceAbsent, match="is taken by another program"):
        SerialPort(name).open()
    first.close()


def test_a_missing_permission_names_the_group(line, monkeypatch):
    _, name = line

    def refuse(*args, **kwargs):
        raise serial.SerialException(EACCES, "could not open port: Permission denied")

    monkeypatch.setattr(serial_port.serial, "Serial", refuse)
    monkeypatch.setattr(serial_port, "_group", lambda number: "dialout")
    with pytest.raises(
        DeviceAbsent, match=r"no permission to open /dev/pts/\d+ \(crw.*group dialout\).*usermod -aG dialout"
    ):
        SerialPort(name).open()


def test_what_is_no_serial_port_says_so(tmp_path):
    with pytest.raises(DeviceError, match="/dev/null is no serial port, or refuses 19200 8N1"):
        SerialPort("/dev/null").open()
    with pytest.raises(DeviceAbsent, match="there is no /dev/nonsense"):
        SerialPort("/dev/nonsense").open()


def test_wrong_settings_are_named(line):
    _, name = line
    with pytest.raises(DeviceError, match=r"refuses 19200 11N1"):
        SerialPort(name, SerialSettings(data_bits=11)).open()
    with pytest.raises(UsageError, match="at 0 baud cannot be"):
        SerialPort(name, SerialSettings(0))


def test_closing_ends_a_read_in_another_thread(line):
    _, name = line
    port, seen, reading = SerialPort(name), [], threading.Event()
    port.open()

    def read():
        reading.set()
        try:
            seen.append(port.read(PATIENCE_S * 6))
        except DeviceAbsent as error:
            seen.append(error)

    thread = threading.Thread(target=read)
    thread.start()
    reading.wait()
    port.close()
    thread.join(PATIENCE_S)
    assert not thread.is_alive() and len(seen) == 1
