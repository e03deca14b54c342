"""camera_info YAML: what is written reads back, and what is wrong is named."""

import re
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec.structs import replace
from support.lens_dialects import (
    of_kalibr,
    of_matlab,
    of_nested_lists,
    of_opencv,
    of_opencv_json,
    of_opencv_xml,
    of_orb_slam,
    of_ros_echo,
    of_ros_ini,
)

from trigpoint.base.errors import InputError
from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel
from trigpoint.site.camera_info import (
    format_camera_info,
    parse_camera_info,
    read_camera_info,
    write_camera_info,
)

FOCAL = st.floats(100.0, 1e5)
COEFFICIENT = st.floats(-2.0, 2.0)
CAMERA = CameraModel(640, 480, 500.0, 501.0, 319.5, 239.5, (-0.3, 1e-05, 1e-4, 0.0, 0.0))


@given(
    model=st.sampled_from(list(LensModel)),
    focal=st.tuples(FOCAL, FOCAL),
    coefficients=st.lists(COEFFICIENT, min_size=8, max_size=8),
)
def test_written_camera_reads_back(model, focal, coefficients) -> None:
    distortion = tuple(coefficients[: len(model.coefficients)])
    camera = CameraModel(1280, 720, focal[0], focal[1], 640.25, 359.5, distortion, model)
    assume(camera.folded_share() < 0.5)
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
        ("distortion_coefficients", "distortion_coefs", "distortion_coefficients"),
        ("plumb_bob\n", "plumb_bob\ncamera_model: omni\n", "«omni»"),
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


def test_lens_of_a_driver_that_was_never_calibrated_is_called_so() -> None:
    matrix = re.compile(r"(camera_matrix:.*?data: )\[.*?\]", re.DOTALL)
    text = matrix.sub(r"\1[0, 0, 0, 0, 0, 0, 0, 0, 0]", format_camera_info(CAMERA, "c1"), count=1)
    with pytest.raises(InputError, match="before the camera is calibrated"):
        parse_camera_info(text, file="c1.yaml")


def test_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such camera_info file"):
        read_camera_info(tmp_path / "none.yaml")


def camel(key: str) -> str:
    first, *rest = key.split("_")
    return first + "".join(word.title() for word in rest)


@given(
    write=st.sampled_from(
        [
            *(of_opencv, of_opencv_xml, of_opencv_json, of_nested_lists, of_kalibr, of_ros_ini),
            *(of_ros_echo, of_orb_slam, of_matlab),
        ]
    ),
    key=st.sampled_from([str, camel, str.title, str.upper]),
    model=st.sampled_from(list(LensModel)),
    focal=st.tuples(st.floats(200.0, 5e3), st.floats(200.0, 5e3)),
    coefficients=st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8),
)
def test_lens_of_any_dialect_is_the_same_lens(write, key, model, focal, coefficients) -> None:
    # Where nothing names a rational model, its last coefficient does.
    values = [*coefficients[: len(model.coefficients) - 1], 0.125]
    camera = CameraModel(1280, 720, focal[0], focal[1], 640.25, 359.5, tuple(values), model)
    assume(camera.folded_share() < 0.5)
    if write is of_ros_ini:  # it names no model
        assume(model is not LensModel.EQUIDISTANT)
    if write is of_matlab:  # it has no other
        assume(model is LensModel.PLUMB_BOB)
    assert parse_camera_info(write(camera, key)).parameters == pytest.approx(camera.parameters)


@pytest.mark.parametrize(
    ("text", "written"),
    [
        (of_kalibr(CAMERA, str, coefficients=4), ", 0.0001, 0]\n"),
        (of_matlab(CAMERA, str, radial=2), '"RadialDistortion": [-0.3, 1e-05]'),
    ],
)
def test_coefficients_that_a_program_does_not_write_are_zero(text: str, written: str) -> None:
    assert written in text
    assert parse_camera_info(text).parameters == pytest.approx(CAMERA.parameters)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            of_kalibr(CAMERA, str)
            + of_kalibr(CAMERA, str).replace("cam0", "cam1").replace("500", "502"),
            "several lenses in it (cam0, cam1)",
        ),
        (of_kalibr(CAMERA, str).replace("pinhole", "omni"), "the lens model «omni» is not known"),
        (of_kalibr(CAMERA, str).replace("radtan", "fov"), "fov"),
        ("%YAML:1.0\nmtx: [500, 0, 319, 0, 500, 239, 0, 0, 1]\ndist: [0, 0, 0, 0]", "image_width"),
        ("<a><b></a>", ":1: not valid XML"),
        ("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 OPENCV 640 480 5", "COLMAP"),
        ("cameraParams = \n\n  cameraParameters with properties:\n", "jsonencode(toStruct"),
        ("% Intrinsic\nfc = [ 500 ; 500 ];\ncc = [ 319 ; 239 ];\n", "Calib_Results.m"),
        ("{'lensmodel': 'LENSMODEL_OPENCV8', 'intrinsics': [500,500]}", "mrcal"),
        ("<calibration>\n <projection>frame</projection>\n</calibration>", "Metashape"),
        ('{"K": [[500, 0, 0], [0, 500, 0], [319, 239, 1]], "w": 640, "h": 480}', "transposed"),
        ('{"K": [[500, 9, 319], [0, 500, 239], [0, 0, 1]], "w": 640, "h": 480}', "skew"),
        (
            '{"K": [500, 0, 319, 0, 500, 239, 0, 0, 1], "w": 640, "h": 480, '
            '"d": [0, 0, 0, 0, 0, 0, 0, 0, 1]}',
            "thin prism",
        ),
        (
            '{"K": [500, 0, 319, 0, 500, 239, 0, 0, 1], "w": 640, "h": 480, "model": "fisheye"}',
            "with 4 zeros",
        ),
        ('{"K": [500, 0, 319, 0, 500, 239, 0, 0, 1], "w": 640, "h": 480}', "with 5 zeros"),
    ],
)
def test_what_our_lenses_cannot_say_is_named(text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_camera_info(text, file="c1.yaml")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[500.0, 0.0, 319.5", "[500.0, 0.0, 1600.0", "principal point (1600, 239.5) lies far"),
        ("[500.0, 0.0, 319.5", "[500.0, 0.0, -900.0", "principal point"),
        ("image_height: 480", "image_height: 90", "principal point"),
        ("501.0", "0.0", "focal"),
        ("501.0", "3.6", "mm"),
        ("[-0.3, ", "[-9.0, ", "folds back"),
    ],
)
def test_lens_that_cannot_be_is_refused(old: str, new: str, said: str) -> None:
    text = format_camera_info(CAMERA, "c1")
    assert old in text
    with pytest.raises(InputError, match=r"c1\.yaml") as caught:
        parse_camera_info(text.replace(old, new), file="c1.yaml")
    assert said in str(caught.value)


def test_lens_that_folds_back_near_the_edge_is_used_and_said(
    caplog: pytest.LogCaptureFixture,
) -> None:
    lens = replace(CAMERA, distortion=(-0.5,))
    assert parse_camera_info(format_camera_info(lens, "c1"), file="c1.yaml") == lens
    assert "c1.yaml: the distortion folds back within the picture" in caplog.text


@pytest.mark.parametrize("text", ["3", "[]", "", "a: ["])
def test_foreign_yaml_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="camera_info"):
        parse_camera_info(text)
