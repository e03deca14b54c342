"""A camera's intrinsics as a file: ROS's YAML (`camera_info`), or what another tool writes."""

import io
import logging
from pathlib import Path
from typing import Any

import numpy as np

from trigpoint.base.errors import InputError, read_text
from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel

from .lens_dialects import read_dialect

_log = logging.getLogger(__name__)


def read_camera_info(path: Path) -> CameraModel:
    """Read a lens file of any known dialect; raise an InputError that names file, key and
    remedy."""
    return parse_camera_info(read_text(path, "camera_info file", InputError), file=str(path))


def parse_camera_info(text: str, *, file: str = "camera_info") -> CameraModel:
    """Like `read_camera_info`, from text."""
    found = read_dialect(text, file)
    (fx, _, cx), (_, fy, cy), _ = found.matrix.tolist()
    distortion = _shortened(np.array(found.distortion), found.model)
    try:
        camera = CameraModel(found.width, found.height, fx, fy, cx, cy, distortion, found.model)
        camera.check()
    except ValueError as reason:
        raise InputError(f"{file}: {reason}; calibrate again or correct the file") from None
    if share := camera.folded_share():
        _log.warning(
            "%s: the distortion folds back within the picture, so %.1f %% of it, at its edge, is "
            "not used; calibrate again with the board there",
            file,
            100 * share,
        )
    return camera


def format_camera_info(camera: CameraModel, name: str) -> str:
    """The YAML text of a camera; `name` is its camera_name."""
    from ruamel.yaml import YAML  # who only reads sessions needs none

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


def _shortened(distortion: np.ndarray, model: LensModel) -> tuple[float, ...]:
    """The coefficients without zeros beyond the model's: OpenCV's rational files carry 12 or 14."""
    used = distortion[: len(model.coefficients)]
    return tuple(distortion.tolist() if np.any(distortion[len(used) :]) else used.tolist())


def _matrix(values: np.ndarray) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": values.reshape(-1).tolist()}
