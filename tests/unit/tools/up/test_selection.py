"""Which parts of a site belong to this machine."""

from collections.abc import Collection
from pathlib import Path

import pytest

from trigpoint.base.errors import ConfigError, InputError
from trigpoint.site.config import Site, parse_site
from trigpoint.tools.up.command import parts_of
from trigpoint.tools.up.selection import Choice, Selection, selected

SITE = """
site = "hall"
target = "target.toml"
{more}
[cameras.c1]
source = "v4l2:///dev/video0"
[cameras.c2]
source = "v4l2:///dev/video2?fourcc=MJPG"
[cameras.c3]
source = "rtsp://10.0.0.7/stream"
[cameras.c4]
source = "file://clip.mp4"
[robots.r1]
port = "/dev/ttyUSB0"
[robots.r2]
port = "./r2.port"
[robots.r3]
protocol = "ros2"
"""
CONNECTS = '[bus]\nconnect = ["{}/10.0.0.1:7447"]\n'
HERE = ("/dev/video0", "/dev/ttyUSB0")


def site(more: str = "") -> Site:
    return parse_site(SITE.format(more=more), directory=Path("/site"))


def chosen(loaded: Site, paths: Collection[str], choice: Choice | None = None) -> Selection:
    return selected(loaded, choice or Choice(), exists=lambda path: str(path) in paths)


def test_machine_of_its_own_has_all_whose_devices_are_here() -> None:
    found = chosen(site(), [*HERE, "/site/clip.mp4"])
    assert found.cameras == ("c1", "c3", "c4")
    assert found.robots == ("r1", "r3")
    assert found.has_fusion
    assert found.has_recorder
    assert found.has_board
    assert found.left_out == ("camera c2: no /dev/video2 here", "robot r2: no /site/r2.port here")


def test_machine_that_connects_elsewhere_has_its_devices_alone() -> None:
    found = chosen(site(CONNECTS.format("tcp")), HERE)
    assert (found.cameras, found.robots) == (("c1",), ("r1",))
    assert not (found.has_fusion)
    assert not (found.has_recorder)
    assert not (found.has_board)
    assert "fusion fusion: it runs where tcp/10.0.0.1:7447 is" in found.left_out


def test_camera_may_be_said_by_its_number() -> None:
    text = 'site = "hall"\n[cameras.c1]\nsource = "v4l2://0"\n'
    assert chosen(parse_site(text, directory=Path("/site")), HERE).cameras == ("c1",)


def test_loopback_is_not_elsewhere() -> None:
    loaded = site('[bus]\nconnect = ["tcp/127.0.0.1:7447"]\n')
    assert chosen(loaded, HERE).has_fusion


def test_keys_say_what_belongs_here_on_a_secured_site() -> None:
    secured = site(CONNECTS.format("tls") + "[bus.tls]\n")
    keys = ["camera-c3", "robot-r2", "recorder-main"]
    found = chosen(secured, [*HERE, *(f"/site/secure/{key}.key" for key in keys)])
    assert (found.cameras, found.robots) == (("c3",), ("r2",))
    assert found.has_recorder
    assert not found.has_fusion
    assert "camera c1: no key camera-c1.key here" in found.left_out


def test_server_of_a_secured_site_needs_no_keys_of_its_nodes() -> None:
    loaded = site('[bus]\nlisten = ["tls/0.0.0.0:7447"]\n[bus.tls]\n')
    found = chosen(loaded, HERE)
    assert found.has_fusion
    assert found.has_recorder
    assert found.cameras == ("c1", "c3")


def test_what_is_named_runs_whatever_is_here() -> None:
    found = chosen(site(), (), Choice.of(site(), ["c2"], ["r2"], ["recorder"]))
    assert (found.cameras, found.robots, found.has_recorder) == (("c2",), ("r2",), False)
    assert found.has_fusion


def test_kinds_that_are_left_out_do_not_run_and_are_not_told_of() -> None:
    choice = Choice.of(site(), [], [], ["camera", "robot", "fusion", "recorder"])
    found = chosen(site(), HERE, choice)
    assert found.is_empty
    assert found.left_out == ()


def test_fusion_is_left_out_where_no_robot_is() -> None:
    text = 'site = "hall"\n[cameras.c1]\nsource = "v4l2:///dev/video0"\n'
    found = chosen(parse_site(text, directory=Path("/site")), HERE)
    assert not found.has_fusion
    assert "no robot" in found.left_out[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((["c9"], [], []), "no camera «c9» in the site file; it has c1"),
        (([], ["r9"], []), "no robot «r9»"),
        (([], [], ["fusin"]), "did you mean «fusion»"),
    ],
)
def test_names_that_there_are_not_are_one_clear_line(
    words: tuple[list[str], list[str], list[str]], message: str
) -> None:
    with pytest.raises((ConfigError, InputError), match=message):
        Choice.of(site(), *words)


def test_every_part_is_a_command_with_the_site() -> None:
    found = chosen(site(), HERE)
    names = {spec.name: spec.command for spec in parts_of(site(), Path("s.toml"), found)}
    assert {"recorder", "fusion", "robot r1", "robot r3", "board"} <= names.keys()
    assert all(command[command.index("--site") + 1] == "s.toml" for command in names.values())
    cameras = [word for command in names.values() for word in command if word in ("c1", "c3")]
    assert sorted(cameras) == ["c1", "c3"]


def test_each_part_serves_metrics_on_a_port_of_its_own() -> None:
    loaded = site('[metrics]\nlisten = "127.0.0.1:65534"\n')
    choice = Choice.of(loaded, ["c1"], ["r1"], ["board"])
    specs = parts_of(loaded, Path("s.toml"), chosen(loaded, HERE, choice))
    served = [spec.command[spec.command.index("--metrics") + 1] for spec in specs]
    assert served == ["127.0.0.1:65534", "127.0.0.1:65535", "off", "off"]
