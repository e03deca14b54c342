"""Serial ports, with pyserial's loop and pseudo-terminals."""

import os
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from trigpoint.base.errors import PortError
from trigpoint.robot.line import port as port_module
from trigpoint.robot.line.port import Port, PortOpener, PortTimeoutError, is_device, lasting_name


class Pty:
    def __init__(self) -> None:
        self.ours, self.theirs = os.openpty()
        tty.setraw(self.theirs)
        self.path = os.ttyname(self.theirs)

    def unplug(self) -> None:
        for end in (self.ours, self.theirs):
            if end >= 0:
                os.close(end)
        self.ours = self.theirs = -1


@pytest.fixture
def pty() -> Iterator[Pty]:
    pair = Pty()
    yield pair
    pair.unplug()


def test_any_url_of_pyserial_opens() -> None:
    with Port("loop://", 115200) as port:
        port.write(b"hello")
        assert port.read()[0] == b"hello"
    assert not is_device("loop://")


def test_bytes_go_both_ways(pty: Pty) -> None:
    with Port(pty.path, 115200) as port:
        os.write(pty.ours, b"\0\1\xff")
        data, received_ns = port.read()
        assert (data, received_ns > 0) == (b"\0\1\xff", True)
        port.write(b"\r\n\0")
        assert os.read(pty.ours, 10) == b"\r\n\0"


def test_bytes_came_before_the_time_that_is_told(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    read, read_ns = os.read, list[int]()

    def reading(descriptor: int, count: int) -> bytes:
        data = read(descriptor, count)
        read_ns.append(time.monotonic_ns())
        return data

    monkeypatch.setattr(port_module.os, "read", reading)
    with Port(pty.path, 115200) as port:
        os.write(pty.ours, b"x")
        assert port.read()[1] >= read_ns[0]


def test_nothing_to_read_is_nothing(pty: Pty) -> None:
    with Port(pty.path, 115200) as port:
        assert port.read()[0] == b""


def test_busy_port_says_to_stop_the_other_bridge(pty: Pty) -> None:
    with (
        Port(pty.path, 115200),
        pytest.raises(PortError, match=f"^Port {pty.path} is busy; stop the other bridge\\.$"),
    ):
        Port(pty.path, 115200)


def test_port_can_be_opened_again_after_it_was_closed(pty: Pty) -> None:
    with Port(pty.path, 115200):
        pass
    with Port(pty.path, 115200) as port:
        port.write(b"again")
        assert os.read(pty.ours, 10) == b"again"


def test_port_that_does_not_exist_is_named_beside_those_that_do(tmp_path: Path) -> None:
    missing = tmp_path / "ttyUSB9"
    with pytest.raises(PortError) as caught:
        Port(str(missing), 115200)
    assert f"Port {missing} does not exist; this machine has " in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_port_without_permission_names_the_group(tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.touch(mode=0)
    with pytest.raises(PortError, match="dialout"):
        Port(str(locked), 115200)


def test_file_that_is_no_port_is_one_clear_line(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("x")
    with pytest.raises(PortError, match=r"does not open .*; correct `port` in site.toml"):
        Port(str(file), 115200)


def test_foreign_url_is_one_clear_line() -> None:
    with pytest.raises(PortError, match=r"correct `port` in site\.toml"):
        Port("nonsense://x", 115200)


def test_unplugged_port_is_lost(pty: Pty) -> None:
    with Port(pty.path, 115200) as port:
        pty.unplug()
        with pytest.raises(PortError, match=f"Port {pty.path} was lost"):
            port.read()


def test_port_that_takes_no_bytes_loses_them_and_says_so(pty: Pty) -> None:
    with Port(pty.path, 115200) as port, pytest.raises(PortTimeoutError, match="takes no bytes"):
        port.write(b"x" * 400_000)


class Device:
    """What pyserial says of a USB adapter."""

    vid, pid = 0x0403, 0x6015

    def __init__(self, device: str, serial_number: str = "DN01") -> None:
        self.device, self.serial_number = device, serial_number


def pulled_out(
    pty: Pty, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[PortOpener, list[Device]]:
    """An adapter's opener, which had it open before it was pulled out; what is plugged in now."""
    first = folder / "ttyUSB0"
    first.symlink_to(pty.path)
    plugged = [Device(pty.path)]
    monkeypatch.setattr(port_module.list_ports, "comports", lambda: plugged)
    opener = PortOpener(str(first), 115200)
    opener.open().close()
    first.unlink()
    plugged.clear()
    return opener, plugged


def test_adapter_that_comes_back_under_another_name_is_found(
    pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opener, plugged = pulled_out(pty, tmp_path, monkeypatch)
    with pytest.raises(PortError, match="does not exist"):
        opener.open()
    plugged.append(Device(pty.path))
    with opener.open() as port:
        assert port.url == pty.path


def test_another_adapter_is_not_taken_for_the_one_that_is_gone(
    pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opener, plugged = pulled_out(pty, tmp_path, monkeypatch)
    plugged.append(Device(pty.path, serial_number="DN02"))
    with pytest.raises(PortError, match="does not exist"):
        opener.open()


def test_name_that_stays_is_suggested(
    pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "usb-FTDI_DN01").symlink_to(pty.path)
    monkeypatch.setattr(port_module, "BY_ID", tmp_path)
    assert lasting_name(pty.path) == str(tmp_path / "usb-FTDI_DN01")
    assert lasting_name("loop://") == ""


def test_bytes_that_came_before_the_port_was_lost_are_not_lost_with_it() -> None:
    with Port("loop://", 115200) as port:
        port.write(b"last")
        read = port._serial.read
        monkey = iter([read, lambda _n: (_ for _ in ()).throw(OSError(5, "gone"))])
        port._serial.read = lambda n: next(monkey)(n)  # type: ignore[method-assign]
        assert port.read()[0] == b"l"
        with pytest.raises(PortError, match="was lost"):
            port.read()
