"""camera_info YAML: what is written reads back, and what is wrong is named."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.camera_info import (
    format_camera_info,
    parse_camera_info,
    read_camera_info,
    write_camera_info,
)
from trigpoint.errors import InputError
from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel

FOCAL = st.floats(1.0, 1e5)
COEFFICIENT = st.floats(-2.0, 2.0)
CAMERA = CameraModel(640, 480, 500.0, 501.0, 319.5, 239.5, (-0.3, 1e-05, 1e-4, 0.0, 0.0))


@given(
    model=st.sampled_from(list(LensModel)),
    focal=st.tuples(FOCAL, FOCAL),
    coefficients=st.lists(COEFFICIENT, min_size=8, max_size=8),
)
def test_written_camera_reads_back(model, focal, coefficients) -> None:
    distortion = tuple(coefficients[: model.coefficients])
    camera = CameraModel(1280, 720, focal[0], focal[1], 640.25, 359.5, distortion, model)
    assert parse_camera_info(format_camera_info(camera, "c1")) == camera


def test_file_reads_back(tmp_path: Path) -> None:
    write_camera_info(tmp_path / "c1.yaml", CAMERA, "c1")
    assert read_camera_info(tmp_path / "c1.yaml") == CAMERA


def test_file_of_ros_calibrator_is_read() -> None:
    text = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [1.2e+03, 0., 320.5, 0., 1201., 240.5, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-1e-01, 0.02, 0, 0, 0]}
"""
    camera = parse_camera_info(text)
    assert (camera.fx, camera.cx, camera.distortion[0]) == (1200.0, 320.5, -0.1)


def test_zeros_beyond_the_model_are_dropped() -> None:
    text = format_camera_info(CAMERA, "c1").replace("0.0, 0.0]", "0.0, 0.0, 0, 0, 0]", 1)
    assert parse_camera_info(text).distortion == CAMERA.distortion


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("plumb_bob", "thin_prism", "thin_prism"),
        ("image_width: 640", "image_width: wide", "image_width"),
        ("image_width: 640\n", "", "image_width"),
        ("[500.0", "[-500.0", "focal"),
        ("[500.0", "[.nan", "camera_matrix"),
        ("[500.0, 0.0,", "[500.0,", "camera_matrix"),
        ("image_height: 480", "image_height: 480 :", "c1.yaml:2"),
        ("0.0, 0.0]", "0.0, 0.0, 0.5, 0.5, 0.5, 0.5]", "coefficients"),
    ],
)
def test_wrong_file_is_named_with_its_fault(old: str, new: str, named: str) -> None:
    text = format_camera_info(CAMERA, "c1").replace(old, new, 1)
    with pytest.raises(InputError, match=r"c1\.yaml") as caught:
        parse_camera_info(text, file="c1.yaml")
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such camera_info file"):
        read_camera_info(tmp_path / "none.yaml")


@pytest.mark.parametrize("text", ["3", "[]", "", "a: ["])
def test_foreign_yaml_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="camera_info"):
        parse_camera_info(text)
