"""Ports: finding the board's, opening it, losing it, and what is said about each."""

import errno
import os
import pty
import socket
from typing import Any

import pytest
import serial
from serial.tools import list_ports

from echowing.errors import EchowingError
from echowing.rig import ports
from echowing.rig.ports import PortLostError, UsbDevice, find_port, open_wire, usb_devices

MEGA = UsbDevice("/dev/ttyACM0", "Arduino Mega 2560", "2341:0042")
PILOT = UsbDevice("/dev/ttyACM1", "Pixhawk1-1M", "1209:5740")


class Terminal:
    """A pseudo-terminal: the other end of a serial device."""

    def __init__(self) -> None:
        self.master, slave = pty.openpty()
        self.name = os.ttyname(slave)
        os.close(slave)

    def unplug(self) -> None:
        os.close(self.master)


@pytest.fixture
def terminal() -> Terminal:
    return Terminal()


class TestFinding:
    def test_the_only_one(self) -> None:
        assert find_port(lambda: [MEGA]) == "/dev/ttyACM0"

    def test_none(self) -> None:
        with pytest.raises(
            EchowingError, match=r"no board found: .*cable that carries data.*--por"
        ):
            find_port(list)

    def test_several_are_named(self) -> None:
        with pytest.raises(EchowingError) as error:
            find_port(lambda: [MEGA, PILOT])
        assert str(error.value) == (
            "2 serial ports are on USB: /dev/ttyACM0 (Arduino Mega 2560, USB 2341:0042), "
            "/dev/ttyACM1 (Pixhawk1-1M, USB 1209:5740). Say which with --port, "
            "as --port /dev/ttyACM0"
        )

    def test_only_what_is_on_usb_counts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        class Info:
            def __init__(self, device: str, vid: int | None, product: str | None = None) -> None:
                self.device, self.vid, self.pid = device, vid, 0x0042
                self.product, self.description = product, "n/a"

        found = [Info("/dev/ttyS0", None), Info("/dev/ttyACM0", 0x2341, "Arduino Mega 2560")]
        monkeypatch.setattr(list_ports, "comports", lambda: found)
        assert usb_devices() == [MEGA]


class TestOpening:
    def refused(self, monkeypatch: pytest.MonkeyPatch, error: Exception) -> str:
        """What is said when pyserial refuses like this."""

        def refuse(*_: Any, **__: Any) -> None:
            raise error

        monkeypatch.setattr(serial, "Serial", refuse)
        monkeypatch.setattr(ports, "usb_devices", lambda: [MEGA])
        with pytest.raises(EchowingError) as said:
            open_wire("/dev/ttyACM5", 115_200)
        return str(said.value)

    def test_no_such_device_names_those_there_are(self, monkeypatch: pytest.MonkeyPatch) -> None:
        words = self.refused(monkeypatch, serial.SerialException(errno.ENOENT, "no"))
        assert words == (
            "/dev/ttyACM5: no such device; on USB there is "
            "/dev/ttyACM0 (Arduino Mega 2560, USB 2341:0042)"
        )

    @pytest.mark.parametrize("number", [errno.EBUSY, errno.EAGAIN])
    def test_busy(self, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
        words = self.refused(monkeypatch, serial.SerialException(number, "in use"))
        assert "the port is busy: another program has it open" in words

    def test_busy_on_windows(self, monkeypatch: pytest.MonkeyPatch) -> None:
        told = "could not open port 'COM5': PermissionError(13, 'Access is denied.', None, 5)"
        assert "the port is busy" in self.refused(monkeypatch, serial.SerialException(told))

    def test_forbidden(self, monkeypatch: pytest.MonkeyPatch) -> None:
        words = self.refused(monkeypatch, serial.SerialException(errno.EACCES, "denied"))
        assert "not allowed to open it" in words
        assert "sudo usermod -a -G dialout $USER" in words

    def test_a_strange_baud_rate(self, monkeypatch: pytest.MonkeyPatch) -> None:
        words = self.refused(monkeypatch, ValueError("Failed to set custom baud rate"))
        assert "does not support 115200 baud" in words

    def test_anything_else_is_told_as_it_is(self, monkeypatch: pytest.MonkeyPatch) -> None:
        words = self.refused(monkeypatch, serial.SerialException(errno.EIO, "Input/output error"))
        assert words == "/dev/ttyACM5: Input/output error"

    @pytest.mark.parametrize("path", ["/dev/null", "/tmp"])
    def test_what_is_no_serial_port(self, path: str) -> None:
        with pytest.raises(EchowingError, match=f"{path}: is not a serial port"):
            open_wire(path)

    def test_the_second_one_to_open_it_is_refused(self, terminal: Terminal) -> None:
        first = open_wire(terminal.name)
        with pytest.raises(EchowingError, match="the port is busy"):
            open_wire(terminal.name)
        first.close()
        open_wire(terminal.name).close()

    def test_a_string_of_no_kind(self) -> None:
        with pytest.raises(EchowingError, match="no such kind; write udpin"):
            open_wire("ttyACM0")


class TestSerial:
    def test_bytes_both_ways(self, terminal: Terminal) -> None:
        wire = open_wire(terminal.name)
        assert wire.read(0.0) == b""
        os.write(terminal.master, b"range")
        assert wire.read(10.0) == b"range"
        wire.write(b"aim")
        assert os.read(terminal.master, 10) == b"aim"
        wire.close()

    def test_an_unplugged_cable(self, terminal: Terminal) -> None:
        wire = open_wire(terminal.name)
        terminal.unplug()
        with pytest.raises(PortLostError, match=r"the cable was unplugged .* start again"):
            wire.read(10.0)
        with pytest.raises(PortLostError, match="the cable was unplugged"):
            wire.write(b"aim")


class TestSockets:
    def test_tcp_both_ways_until_the_other_end_goes(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            wire = open_wire(f"tcp:127.0.0.1:{server.getsockname()[1]}")
            peer, _ = server.accept()
        peer.sendall(b"range")
        assert wire.read(10.0) == b"range"
        wire.write(b"aim")
        assert peer.recv(10) == b"aim"
        peer.close()
        with pytest.raises(PortLostError, match="the other end has closed it"):
            wire.read(10.0)
        wire.close()

    def test_nobody_listens(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
        with pytest.raises(EchowingError, match="nothing listens there"):
            open_wire(f"tcp:127.0.0.1:{port}").read(10.0)

    def test_who_spoke_mavlink_is_answered(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
            board.bind(("127.0.0.1", 0))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            wire = open_wire(f"udpin:127.0.0.1:{port}")
            board.sendto(b"range", ("127.0.0.1", port))
            assert wire.read(10.0) == b"range"
            wire.understood()
            wire.write(b"aim")
            board.settimeout(10.0)
            assert board.recv(10) == b"aim"
            wire.close()

    def test_a_port_that_is_taken(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 0))
            with pytest.raises(EchowingError, match="the port is taken"):
                open_wire(f"udpin:127.0.0.1:{other.getsockname()[1]}")
