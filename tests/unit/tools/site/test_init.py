import shutil
import subprocess
import tomllib
from configparser import ConfigParser
from pathlib import Path

import msgspec
import pytest
from msgspec import Struct
from support.builders import site_text
from support.commands import Cli

from trigpoint.cli import run
from trigpoint.site import config
from trigpoint.site.config import (
    BusConfig,
    CameraConfig,
    FusionConfig,
    MapConfig,
    MavlinkConfig,
    MetricsConfig,
    OdometryNoise,
    PointConfig,
    PriorConfig,
    RecorderConfig,
    RobotConfig,
    RouterConfig,
    SafetyConfig,
    Site,
    TlsConfig,
    WheelConfig,
    load_site,
    parse_site,
)
from trigpoint.site.target import load_target
from trigpoint.site.toml_file import toml_value
from trigpoint.tools.site.file import full_site_text

# The tables of a site file.
TABLES = {
    "bus": BusConfig,
    "bus.tls": TlsConfig,
    "cameras.c1": CameraConfig,
    "robots.r1": RobotConfig,
    "robots.r1.wheels": WheelConfig,
    "robots.r1.mavlink": MavlinkConfig,
    "robots.r1.odometry": OdometryNoise,
    "robots.r1.safety": SafetyConfig,
    "fusion": FusionConfig,
    "fusion.priors": PriorConfig,
    "recorder": RecorderConfig,
    "router": RouterConfig,
    "metrics": MetricsConfig,
    "map": MapConfig,
    "map.points.c1": PointConfig,
}
# What a first site has in place of a default: nothing announces a lens that nobody has measured,
# a robot without a port is another kind of robot, and the prior of a clock depends on the source.
WRITTEN = {"intrinsics": "estimate", "port": "/dev/ttyUSB0", "time_offset_sigma": 0.0}


@pytest.mark.parametrize("options", [[], ["--full"], ["--systemd"]])
def test_written_files_load(tmp_path: Path, options: list[str]) -> None:
    assert run(["init", "--directory", str(tmp_path), *options]) == 0
    site = load_site(tmp_path / "site.toml")
    assert site.camera("c1").estimates_intrinsics
    target = load_target(site.path(site.target_name("r1")))
    assert [face.id for face in target.faces] == [0, 1, 2]


def test_full_file_holds_the_defaults_of_every_struct() -> None:
    site = parse_site(full_site_text(), directory=Path())
    camera, robot = site.camera("c1"), site.robot("r1")
    # No lens is announced that nobody has measured, so a first site has its lenses estimated.
    assert camera == CameraConfig(source=camera.source, intrinsics="estimate")
    assert robot == RobotConfig(port=robot.port)
    assert (site.bus, site.fusion, site.recorder) == (
        BusConfig(),
        FusionConfig(),
        RecorderConfig(),
    )


def test_full_file_has_every_table() -> None:
    structs = {
        struct
        for struct in vars(config).values()
        if isinstance(struct, type) and issubclass(struct, Struct) and struct is not Site
    }
    assert structs == set(TABLES.values())


@pytest.mark.parametrize("table", TABLES)
def test_full_file_has_every_key_with_its_default_and_what_it_is(table: str) -> None:
    """Optional ones as comments."""
    [rows] = [
        [line.removeprefix("# ") for line in block.splitlines()[1:]]
        for block in full_site_text().split("\n\n")
        if block.removeprefix("# ").startswith(f"[{table}]")
    ]
    assert all("  # " in row for row in rows)
    values = tomllib.loads("\n".join(rows))
    names = {*TABLES, "map.points"}
    fields = [
        field
        for field in msgspec.structs.fields(TABLES[table])
        if f"{table}.{field.name}" not in names
    ]
    assert list(values) == [field.name for field in fields]
    for field in fields:
        default = WRITTEN.get(field.name, field.default)
        is_example = default is None or default is msgspec.NODEFAULT
        assert is_example or toml_value(values[field.name]) == toml_value(default), field.name


def test_targets_faces_look_ahead_left_and_right(tmp_path: Path) -> None:
    run(["init", "--directory", str(tmp_path)])
    normals = [
        (-face.base_from_face.rotation[:, 2]).round(6).tolist()
        for face in load_target(tmp_path / "target.toml").faces
    ]
    assert normals == [[1, 0, 0], [0, 1, 0], [0, -1, 0]]


def test_files_that_exist_are_kept_unless_forced(tmp_path: Path, cli: Cli) -> None:
    kept = tmp_path / "target.toml"
    kept.write_text("mine")
    assert "target.toml exists already; add --force" in cli.refused("init", "--directory", tmp_path)
    assert kept.read_text() == "mine"
    assert not (tmp_path / "site.toml").exists()
    cli("init", "--directory", tmp_path, "--force")
    assert load_target(kept).name == "box"


def test_folder_that_cannot_be_made_is_one_line(tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "file").write_text("")
    assert (
        "nothing can be written there"
        in cli("init", "--directory", tmp_path / "file", status=1).err
    )


def service_of(file: Path) -> dict[str, str]:
    """The [Service] keys of a unit."""
    parser = ConfigParser(strict=False, interpolation=None)
    parser.read_string(file.read_text())
    assert parser["Install"]["WantedBy"] == "multi-user.target"
    return dict(parser["Service"])


def test_units_are_watched_and_started_again(tmp_path: Path) -> None:
    folder = tmp_path / "a site 100%"
    assert run(["init", "--systemd", "--directory", str(folder)]) == 0
    names = {f"trigpoint-{name}" for name in ("edge@", "robot@", "fusion", "recorder", "router")}
    files = {file.stem: file for file in (folder / "systemd").glob("*.service")}
    assert files.keys() == names
    for file in files.values():
        service = service_of(file)
        assert (service["type"], service["restart"]) == ("notify", "always")
        assert int(service["watchdogsec"]) == 30
        assert f'--site "{tmp_path}/a site 100%%/site.toml"' in service["execstart"]
    assert "-m trigpoint edge --camera %i" in service_of(files["trigpoint-edge@"])["execstart"]


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd-analyze is not here")
@pytest.mark.parametrize("unit", ["edge@", "robot@", "fusion", "recorder", "router"])
def test_units_are_shut_in(tmp_path: Path, unit: str) -> None:
    """By systemd's own judge, which counts what a service could do that it need not."""
    assert run(["init", "--systemd", "--directory", str(tmp_path)]) == 0
    file = tmp_path / "systemd" / f"trigpoint-{unit}.service"
    judged = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=30", str(file)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert judged.returncode == 0, judged.stdout.splitlines()[-1:] + judged.stderr.splitlines()[-3:]


def test_nothing_runs_as_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("getpass.getuser", lambda: "root")
    assert run(["init", "--systemd", "--directory", str(tmp_path)]) == 0
    for file in (tmp_path / "systemd").glob("*.service"):
        assert service_of(file)["user"] == "trigpoint"
    made = (tmp_path / "systemd" / "trigpoint.conf").read_text().splitlines()
    assert made[0] == f'u trigpoint - "Trigpoint" {tmp_path}'
    assert made[1:] == ["m trigpoint dialout", "m trigpoint video"]


def test_recorder_may_write_where_the_site_file_says(tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text(site_text(more='[recorder]\ndirectory = "/srv/sessions"'))
    assert run(["init", "--systemd", "--directory", str(tmp_path)]) == 0
    unit = (tmp_path / "systemd" / "trigpoint-recorder.service").read_text()
    assert 'ReadWritePaths="-/srv/sessions"' in unit
    assert "ReadWritePaths" not in (tmp_path / "systemd" / "trigpoint-edge@.service").read_text()


def test_units_are_written_for_a_site_that_exists_and_is_kept(tmp_path: Path, cli: Cli) -> None:
    site = tmp_path / "site.toml"
    site.write_text(site_text(cameras=2))
    words = ("init", "--systemd", "--directory", tmp_path)
    assert "trigpoint-edge@c1 trigpoint-edge@c2 trigpoint-robot@r1" in cli(*words).out
    assert site.read_text() == site_text(cameras=2)
    assert "exists already; add --force" in cli.refused(*words)


def test_camera_and_robot_that_are_said_stand_in_the_file(tmp_path: Path) -> None:
    words = ["--camera", "rtsp://hall/1", "--robot", "/dev/ttyACM0", "--protocol", "create2"]
    assert run(["init", "--directory", str(tmp_path), *words, "--keep-target"]) == 0
    site = load_site(tmp_path / "site.toml")
    assert site.camera("c1").source == "rtsp://hall/1"
    assert (site.robot("r1").port, site.robot("r1").protocol) == ("/dev/ttyACM0", "create2")
    assert not (tmp_path / "target.toml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--camera", "video0"], "source «video0» is no URL"),
        (["--full", "--camera", "v4l2:///dev/video0"], "--full writes examples"),
    ],
)
def test_camera_that_is_none_is_one_clear_line_and_no_file(
    tmp_path: Path, cli: Cli, words: list[str], message: str
) -> None:
    assert message in cli.refused("init", "--directory", tmp_path, *words)
    assert list(tmp_path.iterdir()) == []
