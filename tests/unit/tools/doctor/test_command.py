import json
import shutil
import threading
from collections import namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import pytest
from support.builders import TARGET_TEXT, make_site, site_text
from support.commands import Cli
from support.pictures.boards import checkerboard, picture_of, placed

from trigpoint.base.checks import Check
from trigpoint.edge.sources.frames import Unreadable
from trigpoint.site.config import load_site
from trigpoint.tools.doctor import cameras
from trigpoint.tools.doctor import command as doctor
from trigpoint.tools.doctor import machine as machine_checks
from trigpoint.tools.doctor.command import examine
from trigpoint.tools.doctor.machine import (
    EXTRAS,
    check_clock,
    check_disk,
    check_extra,
    check_loopback,
    check_python,
    check_site_bus,
)

Usage = namedtuple("Usage", "free")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out what takes seconds and has tests of its own."""
    monkeypatch.setattr(doctor, "check_loopback", lambda _: Check("bus", "ok", "found"))
    monkeypatch.setattr(doctor, "check_site_bus", lambda _: Check("site's bus", "ok", "opens"))
    monkeypatch.setattr(doctor, "_part_checks", lambda part: [Check(f"{part} part", "ok", "fine")])


def write_site(folder: Path, more: str = "") -> Path:
    path = folder / "site.toml"
    path.write_text(site_text(more=more))
    (folder / "target.toml").write_text(TARGET_TEXT)
    return path


def test_this_machine_can_run_the_tests() -> None:
    assert check_python().level == "ok"
    assert check_loopback(make_site()).level == "ok"
    assert check_clock().name == "clock"


def test_missing_extra_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXTRAS, "robot", ("serial", "no_such_package"))
    finding = check_extra("robot")
    assert (finding.level, finding.message) == ("warning", "not installed (no_such_package)")
    assert "pip install -c constraints.txt 'trigpoint[robot] @ file:" in finding.remedy


@pytest.mark.parametrize(("free", "level"), [(100e9, "ok"), (5e9, "warning"), (0.5e9, "error")])
def test_full_disk_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, free: float, level: str
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(free))
    finding = check_disk(tmp_path / "not" / "yet" / "there")
    assert finding.level == level
    assert ("`directory` under [recorder]" in finding.remedy) is (level != "ok")


def test_unreachable_meeting_point_of_the_site_is_an_error(free_port: Callable[[], int]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    finding = check_site_bus(make_site(bus=f'connect = ["{endpoint}"]'), patience_s=0.3)
    assert (finding.level, finding.message) == ("error", f"{endpoint} cannot be reached")


def test_nobody_on_the_default_bus_is_no_error() -> None:
    finding = check_site_bus(make_site(name="doctor_alone"), patience_s=0.3)
    assert finding.level == "ok"


def test_clock_that_is_not_synchronised_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_checks, "_read_clock", lambda: (5, 0))
    assert check_clock().level == "warning"
    monkeypatch.setattr(machine_checks, "_read_clock", lambda: (0, 1500))
    assert check_clock() == Check("clock", "ok", "synchronised, at most 1.5 ms off")


def test_parts_are_asked_where_they_are_installed(
    quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXTRAS, "robot", ("no_such_package",))
    names = [finding.name for finding in examine(None)]
    assert "edge part" in names
    assert "robot part" not in names


@pytest.mark.parametrize("part", list(EXTRAS))
def test_every_parts_own_checks_open(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is at this machine's serial ports is not spoken to."""
    monkeypatch.setattr("trigpoint.robot.line.guess.guessed", lambda _: None)
    for finding in doctor._part_checks(part):
        assert finding.level in ("ok", "warning", "error")
        assert finding.message
        assert finding.level == "ok" or finding.remedy


@pytest.mark.parametrize(
    ("port", "level"),
    [("/dev/no_port", "warning"), ("tcp://robot:4000", "warning"), ("/dev/null", "error")],
)
def test_protocol_that_is_not_here_is_wrong_only_where_the_port_is(
    quick: None, tmp_path: Path, port: str, level: str
) -> None:
    """What has it need be installed only on the machine of the robot's bridge."""
    more = f'[robots.r9]\nport = "{port}"\nprotocol = "trigpiont"\n'
    findings = {finding.name: finding for finding in examine(load_site(write_site(tmp_path, more)))}
    assert findings["robot r9"].level == level
    assert "no protocol «trigpiont»" in findings["robot r9"].message
    told = (findings["robot r9"].remedy or "").startswith("fine where it is on another machine")
    assert told == (level == "warning")
    assert "create2" in (findings["robot r9"].remedy or "")


def test_sites_devices_and_targets_are_looked_at(quick: None, tmp_path: Path) -> None:
    more = '[cameras.c9]\nsource = "v4l2:///dev/no_camera"\n[robots.r9]\nport = "/dev/no_port"\n'
    more = f'[cameras.c8]\nsource = "rtsp://a"\nheight = 481\nline_delay = 30e-6\n{more}'
    path = write_site(tmp_path, f'{more}target = "lost.toml"')
    findings = {finding.name: finding for finding in examine(load_site(path))}
    assert findings["target of r1"].level == "ok"
    assert findings["target of r9"].level == "error"
    assert "lost.toml" in findings["target of r9"].message
    assert findings["camera c9"].message == "/dev/no_camera is not on this machine"
    assert findings["lens of c9"].message.startswith("no intrinsics")
    assert "write line_delay" in findings["shutter of c9"].message
    assert "rolls over a picture in 14.4 ms" in findings["shutter of c8"].message
    assert findings["robot r9"].level == "warning"


def test_pyav_is_wanted_where_a_camera_is_a_stream(
    quick: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(machine_checks.SITE_EXTRAS, "streams", ("no_such_av",))
    path = write_site(tmp_path, '[cameras.c8]\nsource = "rtsp://a"\n')
    findings = {finding.name: finding for finding in examine(load_site(path))}
    assert findings["extra streams"].level == "warning"
    assert "trigpoint[streams]" in findings["extra streams"].remedy


def test_command_exits_1_where_something_is_wrong(quick: None, tmp_path: Path, cli: Cli) -> None:
    path = write_site(tmp_path, "")
    assert "ok       target of r1: «two-plane», 2 faces" in cli("doctor", "--site", path).out
    (tmp_path / "target.toml").unlink()
    findings = json.loads(cli("doctor", "--site", path, "--json", status=1).out)
    assert [f["name"] for f in findings if f["level"] == "error"] == ["target of r1"]


def write_site_of_shots(folder: Path) -> Path:
    """A site whose first camera is a folder, which is empty yet."""
    site = write_site(folder)
    text = site.read_text()
    [source] = [line for line in text.splitlines() if line.startswith("source")][:1]
    site.write_text(text.replace(source, 'source = "dir://shots"', 1))
    (folder / "shots").mkdir()
    return site


def test_board_that_the_file_describes_the_wrong_way_round_is_told_with_what_to_write(
    quick: None, tmp_path: Path
) -> None:
    site = write_site_of_shots(tmp_path)
    face = 'pattern = "checkerboard"\ncolumns = 6\nrows = 8\nsquare = 0.03\n'
    here = "translation = [0.0, 0.0, 0.0]\nquaternion = [0.0, 0.0, 0.0, 1.0]\n"
    (tmp_path / "target.toml").write_text(f'name = "t"\n[[faces]]\nid = 0\n{face}{here}')
    cv2.imwrite(str(tmp_path / "shots" / "0.png"), picture_of([placed(checkerboard(8, 6))]))
    findings = [one for one in examine(load_site(site)) if one.name.startswith("boards of ")]
    assert [one.level for one in findings] == ["error"]
    assert "write columns = 8 and rows = 6" in findings[0].remedy


@pytest.mark.parametrize(
    ("divisor", "said", "remedy"),
    [
        (20, "each of the first pictures is nearly one grey", "see to the lens's cap, light"),
        (1, "3 of the first pictures show a board of 8 × 6 squares", "compare its pattern"),
    ],
)
def test_what_pictures_show_in_place_of_the_target_is_told_with_its_own_remedy(
    quick: None, tmp_path: Path, divisor: int, said: str, remedy: str
) -> None:
    site = write_site_of_shots(tmp_path)
    picture = picture_of([placed(checkerboard(8, 6))]) // divisor
    for number in range(3):
        cv2.imwrite(str(tmp_path / "shots" / f"{number}.png"), picture)
    [found] = [one for one in examine(load_site(site)) if one.name.startswith("boards of ")]
    assert found.level == "warning"
    assert found.message.startswith(said)
    assert ("none of the target file's" in found.message) is (divisor == 1)
    assert found.remedy.startswith(remedy)


def test_camera_one_of_whose_pictures_is_damaged_is_looked_at(quick: None, tmp_path: Path) -> None:
    site = write_site_of_shots(tmp_path)
    (tmp_path / "shots" / "0.png").write_bytes(b"\x89PNG")
    cv2.imwrite(str(tmp_path / "shots" / "1.png"), picture_of([placed(checkerboard(8, 6))]))
    findings = {finding.name: finding for finding in examine(load_site(site))}
    assert "640 × 480, 1 picture at" in findings["camera c1"].message


class Spoilt:
    """A source whose pictures all come damaged, between pauses."""

    skipped = 0

    def __init__(self, *_given: object, **_more: object) -> None:
        pass

    def frames(self, _stopping: threading.Event) -> Iterator[Unreadable | None]:
        yield from (None, Unreadable("a picture came damaged"), None)

    def close(self) -> None:
        pass


def test_camera_all_of_whose_pictures_are_damaged_is_told_so(
    quick: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cameras, "open_source", Spoilt)
    site = load_site(write_site(tmp_path, '[cameras.c8]\nsource = "rtsp://a"\n'))
    [finding] = cameras.check_camera(site, "c8")
    assert finding.level == "error"
    assert finding.message == "opens, but gave no picture that can be read; a picture came damaged"
    assert "whether it is on" not in finding.remedy


def test_target_of_a_site_without_robots_is_looked_at(quick: None, tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text('site = "lab"\ntarget = "lost.toml"\n[cameras.c1]\nsource = "rtsp://a"\n')
    findings = {finding.name: finding for finding in examine(load_site(path))}
    assert findings["target"].level == "error"
    assert "lost.toml" in findings["target"].message
