"""How far off this machine's clock is, according to chrony or systemd-timesyncd."""

import re
import shutil
import subprocess
from collections.abc import Callable

from trigpoint.base.checks import Check
from trigpoint.site.config import OdometryNoise, Site

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
