from pathlib import Path

import msgspec
import pytest
from msgspec import Struct

from trigpoint.cli import run
from trigpoint.config import (
    BusConfig,
    CameraConfig,
    FusionConfig,
    OdometryNoise,
    RecorderConfig,
    RobotConfig,
    SafetyConfig,
    load_site,
    parse_site,
)
from trigpoint.target import load_target
from trigpoint.tools.site_file import COMMENTS, full_site_text

STRUCTS = (
    BusConfig,
    CameraConfig,
    RobotConfig,
    OdometryNoise,
    SafetyConfig,
    FusionConfig,
    RecorderConfig,
)


@pytest.mark.parametrize("options", [[], ["--full"]])
def test_written_files_load(tmp_path: Path, options: list[str]) -> None:
    assert run(["init", "--directory", str(tmp_path), *options]) == 0
    site = load_site(tmp_path / "site.toml")
    target = load_target(site.path(site.target_name("r1")))
    assert [face.id for face in target.faces] == [0, 1, 2]


def test_full_file_holds_the_defaults_of_every_struct() -> None:
    site = parse_site(full_site_text(), directory=Path())
    camera, robot = site.camera("c1"), site.robot("r1")
    assert camera == CameraConfig(source=camera.source)
    assert robot == RobotConfig(port=robot.port)
    assert (site.bus, site.fusion, site.recorder) == (
        BusConfig(),
        FusionConfig(),
        RecorderConfig(),
    )


@pytest.mark.parametrize("struct", STRUCTS)
def test_full_file_explains_every_key(struct: type[Struct]) -> None:
    lines = full_site_text().splitlines()
    for field in msgspec.structs.fields(struct):
        if not isinstance(field.default, Struct):
            start, end = f"{field.name} = ", f"  # {COMMENTS[struct, field.name]}"
            assert any(line.lstrip("# ").startswith(start) and line.endswith(end) for line in lines)


def test_full_file_has_no_key_that_is_gone() -> None:
    for struct, name in COMMENTS:
        assert name in {field.name for field in msgspec.structs.fields(struct)}


def test_targets_faces_look_ahead_left_and_right(tmp_path: Path) -> None:
    run(["init", "--directory", str(tmp_path)])
    normals = [
        (-face.base_from_face.rotation[:, 2]).round(6).tolist()
        for face in load_target(tmp_path / "target.toml").faces
    ]
    assert normals == [[1, 0, 0], [0, 1, 0], [0, -1, 0]]


def test_files_that_exist_are_kept_unless_forced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "target.toml"
    kept.write_text("mine")
    assert run(["init", "--directory", str(tmp_path)]) == 2
    assert "target.toml exists already; add --force" in capsys.readouterr().err
    assert kept.read_text() == "mine"
    assert not (tmp_path / "site.toml").exists()
    assert run(["init", "--directory", str(tmp_path), "--force"]) == 0
    assert load_target(kept).name == "box"


def test_folder_that_cannot_be_made_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert run(["init", "--directory", str(tmp_path / "file")]) == 1
    assert "nothing can be written there" in capsys.readouterr().err
