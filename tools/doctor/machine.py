"""`doctor`'s checks of every machine: Python, the clock and what keeps it (chrony or
systemd-timesyncd), disk, extras, bus."""

import ctypes
import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from msgspec.structs import replace

from trigpoint.base.checks import Check, Level
from trigpoint.base.disk import free_bytes
from trigpoint.base.errors import BusError
from trigpoint.base.words import install_command
from trigpoint.bus.bus import Bus
from trigpoint.contract.topics import ODOMETRY
from trigpoint.site.config import ROS2_PROTOCOL, BusConfig, OdometryNoise, Site
from trigpoint.zenoh import open_bus

EXTRAS: dict[str, tuple[str, ...]] = {
    "edge": ("cv2",),
    "robot": ("serial",),
    "fusion": ("cv2",),
    "recorder": ("mcap", "rerun"),
}
"""Extra -> the packages that show that it is installed."""

_PASSES_S = 5.0
OLDEST_PYTHON = (3, 11)
_GIGABYTE = 1_000_000_000
_NOT_SYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)


SITE_EXTRAS: dict[str, tuple[str, ...]] = {"secure": ("cryptography",), "streams": ("av",)}
"""The same for extras that a site file may require of a machine."""


def missing_packages(extra: str) -> list[str]:
    """Packages of an extra that are not installed here."""
    wanted = EXTRAS.get(extra) or SITE_EXTRAS[extra]
    return [name for name in wanted if importlib.util.find_spec(name) is None]


def check_python() -> Check:
    version = ".".join(str(number) for number in sys.version_info[:3])
    if sys.version_info < OLDEST_PYTHON:
        return Check("python", "error", f"Python {version} is too old", "install 3.11 or later")
    return Check("python", "ok", f"Python {version}")


def check_extra(extra: str) -> Check:
    """Whether a part is installed; a machine needs only the parts that it runs."""
    missing = missing_packages(extra)
    if not missing:
        return Check(f"extra {extra}", "ok", "installed")
    remedy = f"where this machine runs that part: {install_command(extra)}"
    return Check(f"extra {extra}", "warning", f"not installed ({', '.join(missing)})", remedy)


def check_clock() -> Check:
    """Whether the kernel considers its clock synchronised."""
    if not sys.platform.startswith("linux"):
        return Check(
            "clock",
            "warning",
            "only Linux tells whether its clock is synchronised",
            "see that this machine keeps time by NTP",
        )
    state, error_us = _read_clock()
    if state != _NOT_SYNCHRONISED:
        return Check("clock", "ok", f"synchronised, at most {error_us / 1000:.1f} ms off")
    return Check(
        "clock",
        "warning",
        "this machine's clock is not synchronised; with several machines, times will differ",
        "run chrony or systemd-timesyncd against one server, or use one machine alone",
    )


def _read_clock() -> tuple[int, int]:
    """adjtimex(2) as a reading: the clock's state and its largest error, microseconds."""
    timex = ctypes.create_string_buffer(512)  # modes = 0
    state = ctypes.CDLL(None, use_errno=True).adjtimex(timex)
    if state < 0:
        return _NOT_SYNCHRONISED, 0
    (error_us,) = struct.unpack_from("l", timex, struct.calcsize("Illl") - struct.calcsize("l"))
    return state, error_us


def check_disk(directory: Path) -> Check:
    existing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    free = free_bytes(existing)
    text = f"{free / _GIGABYTE:.1f} GB free in {existing.absolute()}"
    if not os.access(existing, os.W_OK):
        return Check("disk", "error", f"{existing} cannot be written", "choose another directory")
    level: Level = "ok" if free > 10 * _GIGABYTE else "warning" if free > _GIGABYTE else "error"
    remedy = "make room, or set `directory` under [recorder] to another disk"
    return Check("disk", level, text, "" if level == "ok" else remedy)


def check_loopback(site: Site) -> Check:
    """Whether two sessions on this machine find each other, as they must without `[bus]`."""
    alone = replace(site, name=f"doctor_{os.getpid()}", bus=BusConfig())
    try:
        with open_bus(alone) as one, open_bus(alone) as other:
            if _passes(one, other):
                return Check("bus", "ok", "two sessions of this machine found each other")
    except BusError as reason:
        return Check("bus", "error", str(reason), "see that the loopback interface is up")
    return Check(
        "bus",
        "error",
        "two sessions of this machine did not find each other by multicast on loopback",
        'allow UDP port 7446 on loopback, or write [bus] listen = ["tcp/127.0.0.1:7447"] in one '
        'site file and connect = ["tcp/127.0.0.1:7447"] in those of the other processes',
    )


def _passes(one: Bus, other: Bus) -> bool:
    key = ODOMETRY.key("doctor", "r1")
    subscription = other.subscribe(ODOMETRY, key)
    one.publisher(ODOMETRY, key).put(b"")
    return subscription.take(_PASSES_S) is not None


def check_ros2(site: Site) -> list[Check]:
    """Whether a bridge to ROS 2 can reach the site, if one of its robots needs it."""
    robots = [name for name, robot in site.robots.items() if robot.protocol_name == ROS2_PROTOCOL]
    if not robots:
        return []
    name = f"robots on the bus ({', '.join(robots)})"
    if site.bus.listen or site.bus.connect:
        where = (*site.bus.connect, *site.bus.listen)[0]
        text = f"a ROS 2 bridge reaches the site: zenoh-bridge-ros2dds client -e {where}"
        return [Check(name, "ok", text)]
    text = "the site listens nowhere, so nothing passes from or to a ROS 2 bridge, silently"
    remedy = (
        'write listen = ["tcp/127.0.0.1:7447"] under [bus] and start zenoh-bridge-ros2dds as '
        "`client -e tcp/127.0.0.1:7447`, not in its default mode `router` (docs/how-to/ros2.md)"
    )
    return [Check(name, "warning", text, remedy)]


def check_site_bus(site: Site, *, patience_s: float = 3.0) -> Check:
    """Whether the site's bus opens and anyone is there."""
    try:
        with open_bus(site, patience_s=patience_s) as bus:
            deadline = threading.Event()
            while not bus.peers and not deadline.wait(0.2) and patience_s > 0:
                patience_s -= 0.2
            peers = len(bus.peers)
    except BusError as reason:
        return Check("site's bus", "error", str(reason), "correct [bus], or start what it names")
    if peers:
        return Check("site's bus", "ok", f"connected to {peers} sessions")
    if site.bus.connect:
        names = ", ".join(site.bus.connect)
        return Check(
            "site's bus", "error", f"{names} cannot be reached", "start it, or correct bus.connect"
        )
    return Check("site's bus", "ok", "opens; nobody else is on it now")


_ASK_S = 5.0
_UNITS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}
_OFFSET = re.compile(r"^\s*Offset: ([+-]?[0-9.]+)(us|ms|s|min)", re.MULTILINE)
_CHRONY_OFFSET, _CHRONY_LEAP = 4, 13
"""Fields of `chronyc -c tracking` (chronyc(1)): system time, leap status."""

Ask = Callable[[list[str]], str]
TimeService = tuple[str, float]
"""The name of what keeps the clock, and by how much it is off, s."""


def check_time_service(site: Site | None, ask: Ask | None = None) -> Check:
    """The time service's offset, compared with what the site's robots can bear."""
    service = time_service(ask or _output)
    if service is None:
        return Check(
            "time service",
            "warning",
            "neither chrony nor systemd-timesyncd says how far this machine's clock is off",
            "install chrony, with the same server on every machine of the site",
        )
    name, offset_s = service
    robots = site.robots.values() if site else ()
    noises = [robot.odometry for robot in robots] or [OdometryNoise()]
    limit_s = min(noise.bearable_clock_offset_s for noise in noises)
    text = f"{name}: {1e3 * offset_s:+.3f} ms off"
    if abs(offset_s) <= limit_s:
        return Check("time service", "ok", text)
    return Check(
        "time service",
        "error",
        f"{text}; the robots' odometry bears {1e3 * limit_s:.1f} ms",
        f"wait until {name} has settled, or give it a nearer server",
    )


def time_service(ask: Ask) -> TimeService | None:
    """The service that answers; None if none does, or none is synchronised."""
    return _chrony(ask(["chronyc", "-c", "tracking"])) or _timesyncd(
        ask(["timedatectl", "timesync-status", "--no-pager"])
    )


def _chrony(text: str) -> TimeService | None:
    fields = text.strip().split(",")
    if len(fields) <= _CHRONY_LEAP or fields[_CHRONY_LEAP] == "Not synchronised":
        return None
    try:
        return "chrony", float(fields[_CHRONY_OFFSET])
    except ValueError:
        return None


def _timesyncd(text: str) -> TimeService | None:
    match = _OFFSET.search(text)
    if match is None:
        return None
    return "systemd-timesyncd", float(match[1]) * _UNITS[match[2]]


def _output(words: list[str]) -> str:
    """A program's output, "" if it is missing or fails."""
    if shutil.which(words[0]) is None:
        return ""
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=_ASK_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""
