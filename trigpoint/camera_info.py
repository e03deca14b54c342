"""A camera's intrinsics as ROS's YAML file (`camera_info`, as its calibrators write it)."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML, YAMLError

from .errors import InputError, read_text
from .geometry import CameraModel
from .geometry.camera import LensModel


def read_camera_info(path: Path) -> CameraModel:
    """Read a camera_info YAML file; raise an InputError that names file, key and remedy."""
    return parse_camera_info(read_text(path, "camera_info file", InputError), file=str(path))


def parse_camera_info(text: str, *, file: str = "camera_info") -> CameraModel:
    """Like `read_camera_info`, from text."""
    document = _load(text, file)
    matrix = _numbers(document, "camera_matrix", file)
    if matrix.size != 9:
        raise InputError(f"{file}: camera_matrix has {matrix.size} numbers; it needs 9")
    model = _model(document, file)
    distortion = _numbers(document, "distortion_coefficients", file)
    size = (_size(document, "image_width", file), _size(document, "image_height", file))
    fx, _, cx, _, fy, cy, *_ = matrix.tolist()
    try:
        return CameraModel(*size, fx, fy, cx, cy, _shortened(distortion, model), model)
    except ValueError as reason:
        raise InputError(f"{file}: {reason}; calibrate again or correct the file") from None


def format_camera_info(camera: CameraModel, name: str) -> str:
    """The YAML text of a camera; `name` is its camera_name."""
    projection = np.hstack([camera.matrix, np.zeros((3, 1))])
    document = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(camera.matrix),
        "distortion_model": camera.model.value,
        "distortion_coefficients": _matrix(np.array([camera.distortion])),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(projection),
    }
    text = io.StringIO()
    yaml = YAML()  # unlike the safe dumper, it keeps the keys' order
    yaml.default_flow_style = None
    yaml.dump(document, text)
    return text.getvalue()


def write_camera_info(path: Path, camera: CameraModel, name: str) -> None:
    """Write a camera_info YAML file."""
    path.write_text(format_camera_info(camera, name), encoding="utf-8")


def _load(text: str, file: str) -> dict[str, Any]:
    try:
        document = YAML(typ="safe", pure=True).load(text)
    except YAMLError as reason:
        line = getattr(getattr(reason, "problem_mark", None), "line", None)
        where = file if line is None else f"{file}:{line + 1}"
        raise InputError(f"{where}: not valid YAML; mend that line") from None
    if not isinstance(document, dict):
        raise InputError(f"{file}: no camera_info (a mapping is needed); give a ROS camera_info")
    return document


def _value(document: dict[str, Any], key: str, file: str) -> Any:
    if key not in document:
        raise InputError(f"{file}: the key «{key}» is missing; give a ROS camera_info file")
    return document[key]


def _size(document: dict[str, Any], key: str, file: str) -> int:
    value = _value(document, key, file)
    if not isinstance(value, int) or isinstance(value, bool) or value <= 0:
        raise InputError(f"{file}: {key} is «{value}»; it must be a whole number above 0")
    return value


def _model(document: dict[str, Any], file: str) -> LensModel:
    name = _value(document, "distortion_model", file)
    if name not in set(LensModel):
        known = ", ".join(LensModel)
        raise InputError(f"{file}: distortion_model «{name}» is not known; use one of {known}")
    return LensModel(name)


def _numbers(document: dict[str, Any], key: str, file: str) -> np.ndarray:
    matrix = _value(document, key, file)
    data = matrix.get("data") if isinstance(matrix, dict) else None
    try:
        numbers = np.asarray(data, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if data is None or not np.all(np.isfinite(numbers)):
        raise InputError(f"{file}: {key} needs rows, cols and data (finite numbers); correct it")
    return numbers


def _shortened(distortion: np.ndarray, model: LensModel) -> tuple[float, ...]:
    """The coefficients without zeros beyond the model's: OpenCV's rational files carry 12 or 14."""
    used = distortion[: model.coefficients]
    return tuple(distortion.tolist() if np.any(distortion[len(used) :]) else used.tolist())


def _matrix(values: np.ndarray) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": values.reshape(-1).tolist()}
