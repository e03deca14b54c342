"""What doctor finds of clocks and certificates, and what --fix does about a machine."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from support.builders import TARGET_TEXT, make_site, site_text
from support.commands import Cli

from trigpoint.base.checks import Check
from trigpoint.cli import run
from trigpoint.site.config import load_site, parse_site
from trigpoint.tools.doctor import command as doctor
from trigpoint.tools.doctor import fixes as machine_fixes
from trigpoint.tools.doctor.certificates import check_certificates
from trigpoint.tools.doctor.fixes import RULES, Fix, apply, needed
from trigpoint.tools.doctor.machine import check_time_service

# `chronyc -c tracking` of chrony 4.3, and `timedatectl timesync-status` of systemd 252.
CHRONY = (
    "C0A80101,192.168.1.1,3,1700000000.123456789,{offset},0.000012,0.000034,-12.345,0.001,0.02,"
    "0.00123,0.00045,64.5,{leap}\n"
)
TIMESYNCD = """\
       Server: 192.168.1.1 (192.168.1.1)
Poll interval: 34min 8s (min: 32s; max 34min 8s)
         Leap: normal
      Version: 4
      Stratum: 2
    Reference: C0A80101
    Precision: 1us (-24)
Root distance: 12.771ms (max: 5s)
       Offset: {offset}
        Delay: 1.234ms
       Jitter: 321us
 Packet count: 12
"""
CLOCK_OK, CLOCK_BAD = Check("clock", "ok", ""), Check("clock", "warning", "not synchronised")


def answering(program: str, text: str) -> Callable[[list[str]], str]:
    return lambda words: text if words[0] == program else ""


@pytest.mark.parametrize(
    ("program", "text", "level", "message"),
    [
        ("chronyc", CHRONY.format(offset="0.000123", leap="Normal"), "ok", "chrony: +0.123 ms off"),
        ("chronyc", CHRONY.format(offset="-0.0071", leap="Normal"), "error", "bears 6.0 ms"),
        ("chronyc", CHRONY.format(offset="0.0", leap="Not synchronised"), "warning", "neither"),
        ("chronyc", "506 Cannot talk to daemon\n", "warning", "neither"),
        ("timedatectl", TIMESYNCD.format(offset="-321us"), "ok", "timesyncd: -0.321 ms off"),
        ("timedatectl", TIMESYNCD.format(offset="+7.5ms"), "error", "bears 6.0 ms"),
        ("timedatectl", TIMESYNCD.format(offset="n/a"), "warning", "neither"),
        ("other", "", "warning", "neither"),
    ],
)
def test_time_service_is_asked_for_its_offset(
    program: str, text: str, level: str, message: str
) -> None:
    found = check_time_service(make_site(), answering(program, text))
    assert (found.level, message in found.message) == (level, True), found


def test_odometry_that_errs_more_bears_more() -> None:
    text = CHRONY.format(offset="0.0071", leap="Normal")
    coarse = parse_site(
        site_text().replace('port = "loop://"', 'port = "loop://"\nodometry.distance = 0.02'),
        directory=Path(),
    )
    assert check_time_service(coarse, answering("chronyc", text)).level == "ok"


def devices() -> str:
    return (
        'site = "lab"\ntarget = "target.toml"\n[cameras.c1]\nsource = "v4l2:///dev/video0"\n'
        '[robots.r1]\nport = "/dev/ttyUSB0"\n'
    )


def test_what_the_sites_devices_need_is_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine_fixes, "_is_member", lambda _user, group: group == "video")
    monkeypatch.setattr("shutil.which", lambda name: name if name == "timedatectl" else None)
    site, rules = parse_site(devices(), directory=tmp_path), tmp_path / "rules.d" / "70.rules"
    found = needed(site, user="anna", rules=rules, clock=CLOCK_BAD)
    assert [(fix.name, fix.commands[0]) for fix in found] == [
        ("group dialout", ("usermod", "-aG", "dialout", "anna")),
        ("udev rules", ("udevadm", "control", "--reload")),
        ("clock", ("systemctl", "enable", "--now", "systemd-timesyncd")),
    ]
    rules.parent.mkdir()
    rules.write_text(RULES)
    monkeypatch.setattr(machine_fixes, "_is_member", lambda _user, _group: True)
    assert needed(site, user="anna", rules=rules, clock=CLOCK_OK) == []


def test_simulated_site_needs_nothing(tmp_path: Path) -> None:
    assert needed(make_site(), user="anna", rules=tmp_path / "x", clock=CLOCK_OK) == []


def test_fix_writes_its_file_and_says_what_fails(tmp_path: Path) -> None:
    path = tmp_path / "rules.d" / "70.rules"
    done = apply(Fix("udev rules", "it is written", (("true",),), path, RULES))
    assert (done.level, path.read_text()) == ("ok", RULES)
    failed = apply(Fix("group", "", (("sh", "-c", "echo no such group >&2; exit 6"),)))
    assert (failed.level, failed.message.endswith("no such group")) == ("error", True)
    missing = apply(Fix("group", "", (("no_such_program",),)))
    assert (missing.level, "is not installed" in missing.message) == ("error", True)


def test_fix_wants_root_and_a_site(monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert "run it with sudo" in cli.refused("doctor", "--fix")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert "say which with --site" in cli.refused("doctor", "--fix")


def test_mended_things_are_findings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    monkeypatch.setattr(doctor, "examine", lambda _site: [])
    monkeypatch.setattr(doctor, "fixed_user", lambda: "anna")
    monkeypatch.setattr(doctor, "needed", lambda *_, **__: [Fix("clock", "kept", (("true",),))])
    path = tmp_path / "site.toml"
    path.write_text(site_text())
    (tmp_path / "target.toml").write_text(TARGET_TEXT)
    [row] = json.loads(cli("doctor", "--fix", "--json", "--site", path).out)
    assert (row["name"], row["level"], row["message"]) == ("clock", "ok", "mended: kept")


def test_certificates_of_this_machine_are_looked_at(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(site_text(bus='listen = ["tls/127.0.0.1:7447"]\n[bus.tls]', cameras=3))
    site = load_site(path)
    assert [check.level for check in check_certificates(site)] == ["error"]
    words = ["--site", str(path)]
    run(["secure", "init", *words])
    for name in ("c1", "c2", "c3"):
        days = ["--days", "10"] if name == "c2" else []
        run(["secure", "node", "camera", name, *words, *days])
    old = (tmp_path / "secure" / "camera-c3.key").read_bytes()
    certificate = (tmp_path / "secure" / "camera-c3.pem").read_bytes()
    run(["secure", "revoke", "camera", "c3", *words])
    (tmp_path / "secure" / "camera-c3.pem").write_bytes(certificate)
    (tmp_path / "secure" / "camera-c3.key").write_bytes(old)
    (tmp_path / "secure" / "camera-c3.key").chmod(0o600)
    found = check_certificates(site)
    assert [check.level for check in found] == ["ok", "warning", "error"]
    assert "runs out in 9 days" in found[1].message
    assert "does not know it" in found[2].message
