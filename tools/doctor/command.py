"""`trigpoint doctor`: what is wrong on this machine, and what to do."""

import importlib
import os
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from trigpoint.base.checks import Check
from trigpoint.base.errors import InputError, TargetError
from trigpoint.base.terminal import waiting
from trigpoint.base.words import counted
from trigpoint.edge.sources.frames import STREAMED
from trigpoint.site.config import CameraConfig, Site, load_site, parse_site
from trigpoint.site.option import site_here
from trigpoint.site.target import load_target

from .fixes import apply, fixed_user, needed
from .machine import (
    EXTRAS,
    check_clock,
    check_disk,
    check_extra,
    check_loopback,
    check_python,
    check_ros2,
    check_site_bus,
    check_time_service,
    missing_packages,
)

_SIGNS = {"ok": "ok     ", "warning": "warning", "error": "ERROR  "}
_ELSEWHERE = "fine where it is on another machine; else"
_LIVE = ("v4l2", "rtsp")
_NO_SITE = """
site = "doctor"
target = "target.toml"
cameras.c1.source = "v4l2:///dev/video0"
robots.r1.port = "/dev/ttyUSB0"
"""


def main(
    site: Annotated[
        Path | None,
        typer.Option(help="Look at this site's files too; by default ./site.toml, if there."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="A JSON list of findings.")] = False,
    fix: Annotated[
        bool,
        typer.Option("--fix", help="As root: mend groups, udev rules, the keeping of the clock."),
    ] = False,
) -> None:
    """Say what is missing or wrong on this machine and what to do; exit 1 if something is wrong."""
    site = site or site_here()
    loaded = load_site(site) if site else None
    mended = _mend(loaded) if fix else []
    findings = []
    for finding in chain(mended, examine(loaded)):
        findings.append(finding)
        if not json:
            typer.echo(_line(finding))
    if json:
        typer.echo(msgspec.json.encode(findings).decode())
    if any(finding.level == "error" for finding in findings):
        raise typer.Exit(1)


def _mend(site: Site | None) -> list[Check]:
    user = fixed_user()
    if site is None:
        raise InputError("doctor --fix mends what a site needs; say which with --site")
    return [apply(one) for one in needed(site, user=user, clock=check_clock())]


def examine(site: Site | None) -> Iterator[Check]:
    """All findings, each as it is made: this machine's, each installed part's, and the site's if
    one is given. A terminal shows what is being looked at."""
    some_site = site or parse_site(_NO_SITE, directory=Path())
    yield from (check_python(), check_clock(), check_time_service(site))
    yield check_disk(site.path(site.recorder.directory) if site else Path())
    yield from _looking("the loopback", lambda: [check_loopback(some_site)])
    for extra in EXTRAS:
        yield check_extra(extra)
        if not missing_packages(extra):
            yield from _looking(f"part {extra}", partial(_part_checks, extra))
    if site is None:
        return
    yield from _looking("the bus", lambda: [check_site_bus(site)])
    yield from _check_security(site)
    for name in dict.fromkeys(site.target_names):
        yield _check_target(site, name)
    for name in site.cameras:
        yield from _looking(f"camera {name}", partial(_check_camera, site, name))
    for name in site.robots:
        yield from _check_port(site, name)
    yield from _looking("the ROS 2 robots", lambda: check_ros2(site))


def _looking(at: str, look: Callable[[], list[Check]]) -> list[Check]:
    with waiting(f"looks at {at}"):
        return look()


def _check_security(site: Site) -> list[Check]:
    """The certificates on this machine, and endpoints open to anyone."""
    open_doors = [
        Check("bus", "warning", f"{door} is open without certificates", "secure the site")
        for door in site.bus.open_doors
    ]
    if site.bus.tls is None:
        return open_doors
    if missing_packages("secure"):
        return [check_extra("secure")]
    from .certificates import check_certificates

    return check_certificates(site)


def _part_checks(part: str) -> list[Check]:
    return importlib.import_module(f"trigpoint.{part}.checks").checks()


def _check_target(site: Site, name: str) -> Check:
    bearers = [robot for robot in site.robots if site.target_name(robot) == name]
    whose = f"target of {', '.join(bearers)}" if bearers else "target"
    try:
        target = load_target(site.path(name))
    except TargetError as reason:
        return Check(whose, "error", str(reason), "try `trigpoint target check`")
    return Check(whose, "ok", f"«{target.name}», {counted(len(target.faces), 'face')}")


def _check_camera(site: Site, name: str) -> list[Check]:
    camera = site.camera(name)
    findings = [] if camera.intrinsics else [_no_lens(name)]
    shutter = [_shutter(name, camera)] if camera.scheme in _LIVE else []
    if camera.scheme == "v4l2" and camera.file is not None:
        device = _check_device(f"camera {name}", Path(camera.file), "video")
        if device.level != "ok":
            return [*findings, device, *shutter]
    if camera.scheme in STREAMED and missing_packages("streams"):
        return [*findings, check_extra("streams")]
    if missing_packages("edge"):
        return findings + shutter
    from .cameras import check_boards, check_camera  # needs the edge extra

    return [*findings, *check_camera(site, name), *shutter, *check_boards(site, name)]


def _shutter(name: str, camera: CameraConfig) -> Check:
    text = "all rows are taken to be exposed at once; if it rolls, as most do, write line_delay"
    if camera.line_delay:
        text = f"rolls over a picture in {1e3 * camera.readout_s:.1f} ms, stamped at the middle row"
    return Check(f"shutter of {name}", "ok", text)


def _no_lens(name: str) -> Check:
    remedy = 'make them with `trigpoint intrinsics`, or write intrinsics = "estimate"'
    text = "no intrinsics; what it sees is not used unless its source itself knows its lens"
    return Check(f"lens of {name}", "warning", text, remedy)


def _check_port(site: Site, name: str) -> list[Check]:
    from trigpoint.robot.line.protocol import known_protocols

    robot, known = site.robot(name), known_protocols()
    device = Path(robot.port) if robot.port and robot.port.startswith("/dev/") else None
    if robot.protocol_name not in known:
        text = f"there is no protocol «{robot.protocol_name}» on this machine"
        remedy = f"write one of {', '.join(known)}, or install what has it"
        if device is not None and device.exists():
            return [Check(f"robot {name}", "error", text, remedy)]
        return [Check(f"robot {name}", "warning", text, f"{_ELSEWHERE} {remedy}")]
    return [_check_device(f"robot {name}", device, "dialout")] if device else []


def _check_device(name: str, device: Path, group: str) -> Check:
    if not device.exists():
        remedy = f"{_ELSEWHERE} plug it in or correct the site file"
        return Check(name, "warning", f"{device} is not on this machine", remedy)
    if not os.access(device, os.R_OK | os.W_OK):
        remedy = f"sudo usermod -aG {group} $USER, then log in again"
        return Check(name, "error", f"you may not open {device}", remedy)
    return Check(name, "ok", f"{device} can be opened")


def _line(finding: Check) -> str:
    line = f"{_SIGNS[finding.level]}  {finding.name}: {finding.message}"
    return f"{line}\n         → {finding.remedy}" if finding.remedy else line
