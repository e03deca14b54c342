"""`trigpoint doctor`: what is wrong on this machine, and what to do."""

import importlib
import os
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from trigpoint.checks import Check
from trigpoint.config import CameraConfig, Site, load_site, parse_site
from trigpoint.errors import InputError, TargetError
from trigpoint.target import load_target
from trigpoint.words import counted

from .clock_checks import check_time_service
from .machine_checks import (
    EXTRAS,
    check_clock,
    check_disk,
    check_extra,
    check_loopback,
    check_python,
    check_ros2,
    check_site_bus,
    missing_packages,
)
from .machine_fixes import apply, fixed_user, needed

_SIGNS = {"ok": "ok     ", "warning": "warning", "error": "ERROR  "}
_LIVE = ("v4l2", "rtsp")
_NO_SITE = """
site = "doctor"
target = "target.toml"
cameras.c1.source = "v4l2:///dev/video0"
robots.r1.port = "/dev/ttyUSB0"
"""


def main(
    site: Annotated[Path | None, typer.Option(help="Look at this site's files too.")] = None,
    json: Annotated[bool, typer.Option("--json", help="A JSON list of findings.")] = False,
    fix: Annotated[
        bool,
        typer.Option("--fix", help="As root: mend groups, udev rules, the keeping of the clock."),
    ] = False,
) -> None:
    """Say what is missing or wrong on this machine and what to do; exit 1 if something is wrong."""
    loaded = load_site(site) if site else None
    mended = _mend(loaded) if fix else []
    findings = [*mended, *examine(loaded)]
    if json:
        typer.echo(msgspec.json.encode(findings).decode())
    else:
        typer.echo("\n".join(_line(finding) for finding in findings))
    if any(finding.level == "error" for finding in findings):
        raise typer.Exit(1)


def _mend(site: Site | None) -> list[Check]:
    user = fixed_user()
    if site is None:
        raise InputError("doctor --fix mends what a site needs; say which with --site")
    return [apply(one) for one in needed(site, user=user, clock=check_clock())]


def examine(site: Site | None) -> list[Check]:
    """All findings: this machine's, each installed part's, and the site's if one is given."""
    some_site = site or parse_site(_NO_SITE, directory=Path())
    findings = [check_python(), check_clock(), check_time_service(site)]
    findings.append(check_disk(site.path(site.recorder.directory) if site else Path()))
    findings.append(check_loopback(some_site))
    for extra in EXTRAS:
        findings.append(check_extra(extra))
        if not missing_packages(extra):
            findings += _part_checks(extra)
    if site:
        findings.append(check_site_bus(site))
        findings += _check_security(site)
        findings += [_check_target(site, robot) for robot in site.robots]
        findings += [finding for name in site.cameras for finding in _check_camera(site, name)]
        findings += [finding for name in site.robots for finding in _check_port(site, name)]
        findings += check_ros2(site)
    return findings


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
    from .certificate_checks import check_certificates

    return check_certificates(site)


def _part_checks(part: str) -> list[Check]:
    return importlib.import_module(f"trigpoint.{part}.checks").checks()


def _check_target(site: Site, robot: str) -> Check:
    try:
        target = load_target(site.path(site.target_name(robot)))
    except TargetError as reason:
        return Check(f"target of {robot}", "error", str(reason), "try `trigpoint target check`")
    return Check(
        f"target of {robot}", "ok", f"«{target.name}», {counted(len(target.faces), 'face')}"
    )


def _check_camera(site: Site, name: str) -> list[Check]:
    findings = [] if site.camera(name).intrinsics else [_no_lens(name)]
    scheme, _, place = site.camera(name).source.partition("://")
    if scheme == "v4l2":
        device = _check_device(f"camera {name}", _device(place.partition("?")[0]), "video")
        if device.level != "ok":
            return [*findings, device, _shutter(name, site.camera(name))]
    if not missing_packages("edge"):
        from .camera_checks import check_camera  # needs the edge extra

        findings += check_camera(site, name)
    if scheme in _LIVE:
        findings.append(_shutter(name, site.camera(name)))
    return findings + _check_boards(site, name)


def _check_boards(site: Site, name: str) -> list[Check]:
    """Boards in a camera's pictures that differ from the target files."""
    if missing_packages("edge"):
        return []
    from .board_checks import check_boards

    return check_boards(site, name)


def _shutter(name: str, camera: CameraConfig) -> Check:
    text = "all rows are taken to be exposed at once; if it rolls, as most do, write line_delay"
    if camera.line_delay:
        text = f"rolls over a picture in {1e3 * camera.readout_s:.1f} ms, stamped at the middle row"
    return Check(f"shutter of {name}", "ok", text)


def _device(place: str) -> Path:
    return Path(f"/dev/video{place}" if place.isdigit() else place)


def _no_lens(name: str) -> Check:
    remedy = 'make them with `trigpoint intrinsics`, or write intrinsics = "estimate"'
    text = "no intrinsics; what it sees is not used unless its source itself knows its lens"
    return Check(f"lens of {name}", "warning", text, remedy)


def _check_port(site: Site, name: str) -> list[Check]:
    port = site.robot(name).port
    if port is None or not port.startswith("/dev/"):
        return []
    return [_check_device(f"robot {name}", Path(port), "dialout")]


def _check_device(name: str, device: Path, group: str) -> Check:
    if not device.exists():
        remedy = "fine where it is on another machine; else plug it in or correct the site file"
        return Check(name, "warning", f"{device} is not on this machine", remedy)
    if not os.access(device, os.R_OK | os.W_OK):
        remedy = f"sudo usermod -aG {group} $USER, then log in again"
        return Check(name, "error", f"you may not open {device}", remedy)
    return Check(name, "ok", f"{device} can be opened")


def _line(finding: Check) -> str:
    line = f"{_SIGNS[finding.level]}  {finding.name}: {finding.message}"
    return f"{line}\n         → {finding.remedy}" if finding.remedy else line
