"""Lens files as other programs write them; `key` says how the keys that differ are spelled."""

import json
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel


def _numbers(values: Iterable[float], between: str = ", ") -> str:
    return between.join(f"{value:.17g}" for value in values)


def of_opencv(c: CameraModel, key: Callable[[str], str]) -> str:
    """FileStorage's YAML, as calibration samples write it."""

    def matrix(name: str, rows: int, values: Sequence[float]) -> str:
        head = f"{key(name)}: !!opencv-matrix\n   rows: {rows}\n   cols: {len(values) // rows}\n"
        return f"{head}   dt: d\n   data: [ {_numbers(values)} ]\n"

    fisheye = f"fisheye_model: {int(c.model is LensModel.EQUIDISTANT)}\n"
    size = f"{key('image_width')}: {c.width}\n{key('image_height')}: {c.height}\n{fisheye}"
    matrices = matrix("camera_matrix", 3, c.matrix.ravel().tolist())
    return f"%YAML:1.0\n---\n{size}{matrices}{matrix('distortion_coefficients', 1, c.distortion)}"


def of_opencv_xml(c: CameraModel, key: Callable[[str], str]) -> str:
    def matrix(name: str, values: Iterable[float]) -> str:
        data = f"<rows>3</rows><cols>3</cols><dt>d</dt><data>\n{_numbers(values, ' ')}</data>"
        return f'<{key(name)} type_id="opencv-matrix">{data}</{key(name)}>'

    size = f"<image_size>\n  {c.width} {c.height}</image_size>"
    fisheye = f"<fisheye_model>{int(c.model is LensModel.EQUIDISTANT)}</fisheye_model>"
    matrices = matrix("camera_matrix", c.matrix.ravel()) + matrix("dist_coeffs", c.distortion)
    head = '<?xml version="1.0"?>\n<opencv_storage>'
    return f"{head}\n{size}{fisheye}{matrices}</opencv_storage>"


def of_opencv_json(c: CameraModel, key: Callable[[str], str]) -> str:
    def matrix(values: Iterable[float]) -> dict[str, object]:
        return {"type_id": "opencv-matrix", "rows": 1, "data": list(values)}

    return json.dumps(
        {
            key("image_size"): [c.width, c.height],
            key("camera_matrix"): matrix(c.matrix.ravel()),
            key("dist_coeffs"): matrix(c.distortion),
            "fisheye_model": c.model is LensModel.EQUIDISTANT,
        },
        indent="\t",
    )


def of_nested_lists(c: CameraModel, key: Callable[[str], str]) -> str:
    """As people dump numpy's arrays."""
    return json.dumps(
        {
            key("width"): c.width,
            key("height"): c.height,
            "K": c.matrix.tolist(),
            "dist": [list(c.distortion)],
            "model": {"plumb_bob": "OPENCV", "equidistant": "OPENCV_FISHEYE"}.get(c.model, c.model),
        }
    )


def of_kalibr(
    c: CameraModel, _key: Callable[[str], str], *, coefficients: int | None = None
) -> str:
    """With the first coefficients of the distortion, or all; Kalibr itself has four."""
    name = {LensModel.PLUMB_BOB: "radtan"}.get(c.model, c.model.value)
    distortion = _numbers(c.distortion[:coefficients])
    return (
        f"cam0:\n  camera_model: pinhole\n  intrinsics: [{_numbers(c.parameters[:4])}]\n"
        f"  distortion_model: {name}\n  distortion_coeffs: [{distortion}]\n"
        f"  resolution: [{c.width}, {c.height}]\n  rostopic: /front/image_raw\n"
    )


def of_ros_ini(c: CameraModel, _key: Callable[[str], str]) -> str:
    rows = "\n".join(_numbers(row, " ") for row in c.matrix)
    size = f"[image]\n\nwidth\n{c.width}\n\nheight\n{c.height}\n\n"
    unit = "rectification\n1 0 0\n0 1 0\n0 0 1\n"
    lens = f"[c1]\n\ncamera matrix\n{rows}\n\ndistortion\n{_numbers(c.distortion, ' ')}\n\n"
    return f"# oST version 5.0 parameters\n\n\n{size}{lens}{unit}"


def of_ros_echo(c: CameraModel, _key: Callable[[str], str]) -> str:
    """The output of `rostopic echo -n1`."""
    return (
        f"header:\n  seq: 7\nheight: {c.height}\nwidth: {c.width}\n"
        f'distortion_model: "{c.model.value}"\nD: [{_numbers(c.distortion)}]\n'
        f"K: [{_numbers(c.matrix.ravel())}]\nroi:\n  height: 0\n  width: 0\n---\n"
    )


def of_orb_slam(c: CameraModel, _key: Callable[[str], str]) -> str:
    kind = "KannalaBrandt8" if c.model is LensModel.EQUIDISTANT else "PinHole"
    names = {
        LensModel.EQUIDISTANT: ("k1", "k2", "k3", "k4"),
        LensModel.PLUMB_BOB: ("k1", "k2", "p1", "p2", "k3"),
        LensModel.RATIONAL_POLYNOMIAL: ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    }[c.model]
    given = zip(("fx", "fy", "cx", "cy", *names), c.parameters, strict=True)
    lines = "".join(f"Camera.{name}: {value:.17g}\n" for name, value in given)
    size = f"Camera.width: {c.width}\nCamera.height: {c.height}\n"
    return f'%YAML:1.0\n\nCamera.type: "{kind}"\n{lines}{size}'


def of_matlab(c: CameraModel, _key: Callable[[str], str], *, radial: int = 3) -> str:
    """`jsonencode(toStruct(cameraParams))`, whose first pixel is (1, 1), with two or three radial
    coefficients."""
    k1, k2, p1, p2, k3 = c.distortion
    matrix = c.matrix + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    return json.dumps(
        {
            "RadialDistortion": [k1, k2, k3][:radial],
            "TangentialDistortion": [p1, p2],
            "ImageSize": [c.height, c.width],
            "IntrinsicMatrix": matrix.T.tolist(),
        }
    )
