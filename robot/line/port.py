"""A serial port: the one place that knows pyserial. Opens any URL that pyserial opens.

A port is locked while it is open. If a device comes back under another name, `PortOpener` finds it
by its USB descriptor.
"""

import errno
import os
import select
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import serial
from serial.tools import list_ports

from trigpoint.base.closing import Closing
from trigpoint.base.errors import PortError

READ_TIMEOUT_S = 0.1
WRITE_TIMEOUT_S = 0.5
_CHUNK = 4096
BY_ID = Path("/dev/serial/by-id")


class PortTimeoutError(PortError):
    """The other side takes no bytes; the data to be written is lost."""


class Port(Closing):
    """An open port. One thread may read while another writes; `close` stops both.

    Raises PortError with a one-line message if the port cannot be opened or is lost.
    """

    def __init__(self, url: str, baud: int) -> None:
        self.url = url
        self._trouble: PortError | None = None
        try:
            self._serial = serial.serial_for_url(
                url,
                baudrate=baud,
                timeout=READ_TIMEOUT_S,
                write_timeout=WRITE_TIMEOUT_S,
                exclusive=True if is_device(url) else None,
            )
        except (serial.SerialException, ValueError, OSError) as reason:
            raise PortError(_why_not_open(url, reason)) from None
        self._hurry()

    def _hurry(self) -> None:
        """Have the driver deliver bytes at once: FTDI's collects them for 16 ms. Few other drivers
        have this setting."""
        hurry = getattr(self._serial, "set_low_latency_mode", None)
        if hurry is not None:
            with suppress(ValueError, OSError):
                hurry(True)

    def read(self) -> tuple[bytes, int]:
        """The bytes received, and the monotonic clock (ns) when all of them were here; no bytes
        after `READ_TIMEOUT_S`. On a busy machine this is much later than the first byte; with the
        first byte's time, the later bytes would seem to have been sent after they arrived."""
        if self._trouble is not None:
            raise self._trouble
        first = b""
        try:
            if is_device(self.url):
                return self._read_device()
            first = self._serial.read(1)
            waiting = min(self._serial.in_waiting, _CHUNK)
            received_ns = time.monotonic_ns()
            if not first:
                return b"", received_ns
            return first + (self._serial.read(waiting) if waiting else b""), received_ns
        except (serial.SerialException, OSError, TypeError) as reason:
            # TypeError: pyserial's read on a port that another thread has just closed.
            trouble = PortError(f"Port {self.url} was lost; is it plugged in?")
            trouble.__cause__ = reason
            if not first:
                raise trouble from reason
            self._trouble = trouble  # bytes that came before the loss are kept
            return first, time.monotonic_ns()

    def _read_device(self) -> tuple[bytes, int]:
        """The same for a port with a descriptor to wait on: a third of pyserial's system calls."""
        descriptor = self._serial.fileno()
        ready, _, _ = select.select([descriptor], [], [], READ_TIMEOUT_S)
        data = os.read(descriptor, _CHUNK) if ready else b""
        received_ns = time.monotonic_ns()
        if ready and not data:
            raise OSError(errno.EIO, "the device is gone")
        return data, received_ns

    def write(self, data: bytes) -> None:
        """Pass all bytes to the system; raise PortTimeoutError if it does not take them."""
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise PortTimeoutError(f"Port {self.url} takes no bytes; is the robot on?") from None
        except (serial.SerialException, OSError, TypeError) as reason:
            raise PortError(f"Port {self.url} was lost; is it plugged in?") from reason

    def close(self) -> None:
        """Close it; may be called twice, and from another thread."""
        try:
            self._serial.close()
        except (serial.SerialException, OSError) as reason:
            raise PortError(f"Port {self.url} did not close ({_plain(reason)}).") from None


def is_device(url: str) -> bool:
    """Whether this is a device of this machine, not one of pyserial's URLs."""
    return "://" not in url


class PortOpener:
    """Opens one robot's port, repeatedly, even if the system has renamed it."""

    def __init__(self, url: str, baud: int) -> None:
        self._url, self._baud = url, baud
        self._identity: tuple[object, ...] | None = None

    def open(self) -> Port:
        """Open it; raise PortError with a one-line message if that fails."""
        url = self._url
        if is_device(url):
            if self._identity is not None and not Path(url).exists():
                url = self._other_name() or url
            self._identity = identity(url) or self._identity
        return Port(url, self._baud)

    def _other_name(self) -> str | None:
        ports = list_ports.comports()
        return next((port.device for port in ports if _descriptor(port) == self._identity), None)


def _descriptor(port: Any) -> tuple[object, ...] | None:
    """What distinguishes a USB device from every other; None if nothing does."""
    found = (port.vid, port.pid, port.serial_number)
    return found if all(found) else None


def identity(url: str) -> tuple[object, ...] | None:
    """Identity of the device behind a path, also through a link; None if it has none."""
    real = os.path.realpath(url)
    ports = list_ports.comports()
    return next((_descriptor(port) for port in ports if port.device == real), None)


def lasting_name(url: str) -> str:
    """The device's name under /dev/serial/by-id, which other devices do not change; or ""."""
    real = os.path.realpath(url)
    if not is_device(url) or not BY_ID.is_dir():
        return ""
    links = (link for link in sorted(BY_ID.iterdir()) if os.path.realpath(link) == real)
    return str(next(links, ""))


def present_ports() -> list[str]:
    """This machine's serial ports with a device behind them, by their lasting names."""
    devices = sorted(port.device for port in list_ports.comports())
    return [lasting_name(device) or device for device in devices]


def _why_not_open(url: str, reason: Exception) -> str:
    code = getattr(reason, "errno", None)
    if isinstance(reason, BlockingIOError) or code in (errno.EAGAIN, errno.EBUSY):
        return f"Port {url} is busy; stop the other bridge."
    if code in (errno.EACCES, errno.EPERM):
        return f"Port {url} may not be opened by this user; add the user to the group «dialout»."
    if is_device(url) and not Path(url).exists():
        ports = ", ".join(present_ports()) or "none"
        return f"Port {url} does not exist; this machine has {ports}. Plug it in or correct `port`."
    return f"Port {url} does not open ({_plain(reason)}); correct `port` in site.toml."


def _plain(reason: Exception) -> str:
    """The reason in one short line."""
    text = str(reason).splitlines()[0] if str(reason) else type(reason).__name__
    return text if len(text) < 120 else text[:117] + "…"
