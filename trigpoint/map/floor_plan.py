"""A floor plan as ROS's map_server writes it: a picture, and a YAML file that places it.

`origin` (x, y, heading) is the pose of the picture's lower left corner in the building's frame,
`resolution` the side of a pixel in metres.
"""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import ConfigError, read_text
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

_MOST_PIXELS = 100e6
"""A hall of 300 m at 3 cm; larger plans take more memory than a viewer has."""


class FloorPlan(Struct, frozen=True, eq=False):
    """`pixels`: (rows, columns) uint8 grey, dark where something stands; `frame_from_plan`: the
    plan's own frame has its origin in the picture's lower left corner, x to the right, y up."""

    pixels: np.ndarray
    resolution_m: float
    frame_from_plan: Pose

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        rows, columns = self.pixels.shape
        return columns * self.resolution_m, rows * self.resolution_m

    @property
    def corners(self) -> Array:
        """(4, 3) in the frame, counter-clockwise from the lower left one."""
        width, height = self.size_m
        own = np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
        return self.frame_from_plan @ own

    def position(self, pixel: tuple[float, float]) -> Array:
        """(2,) in the frame, m, of a column and row; (0, 0): the centre of the top left pixel."""
        rows = self.pixels.shape[0]
        own = self.resolution_m * np.array([pixel[0] + 0.5, rows - 0.5 - pixel[1], 0.0])
        return (self.frame_from_plan @ own)[:2]

    def reduced(self, most: int) -> "FloorPlan":
        """The plan with at most so many pixels per row or column. Each block keeps its darkest
        pixel, so that thin walls remain; the lower left corner stays in place."""
        step = math.ceil(max(self.pixels.shape) / most)
        if step == 1:
            return self
        rows, columns = (step * math.ceil(side / step) for side in self.pixels.shape)
        padded = np.full((rows, columns), 255, dtype=np.uint8)
        padded[rows - self.pixels.shape[0] :, : self.pixels.shape[1]] = self.pixels
        blocks = padded.reshape(rows // step, step, columns // step, step)
        return FloorPlan(blocks.min(axis=(1, 3)), step * self.resolution_m, self.frame_from_plan)


def load_floor_plan(path: Path) -> FloorPlan:
    """Read the YAML file and its picture; raise ConfigError with a one-line message."""
    text = read_text(path, "floor plan", ConfigError)
    picture = path.parent / picture_of(text, file=str(path))
    try:
        data = picture.read_bytes()
    except OSError as reason:
        raise ConfigError(
            f"{path}: the plan's picture {picture} cannot be read ({reason.strerror})"
        ) from None
    return parse_floor_plan(text, data, file=str(path))


def picture_of(text: str, *, file: str) -> str:
    """The picture's path, relative to the YAML file's folder."""
    return str(_document(text, file)["image"])


def parse_floor_plan(text: str, picture: bytes, *, file: str) -> FloorPlan:
    """Like `load_floor_plan`, from a session's attachments."""
    document = _document(text, file)
    try:
        resolution_m = float(document["resolution"])
        x, y, heading_rad = (float(value) for value in document["origin"])
        is_inverted = bool(int(document.get("negate", 0)))
    except (TypeError, ValueError):
        raise ConfigError(
            f"{file}: `resolution` is a number of metres, `origin` [x, y, heading]; correct them"
        ) from None
    if not (0 < resolution_m < math.inf and math.isfinite(x + y + heading_rad)):
        raise ConfigError(f"{file}: `resolution` must be above 0 and `origin` finite; correct them")
    pixels = _grey(picture, f"{file}: {document['image']}")
    if is_inverted:
        pixels = 255 - pixels
    return FloorPlan(pixels, resolution_m, Pose.planar(x, y, heading_rad))


def _document(text: str, file: str) -> dict[str, Any]:
    from ruamel.yaml import YAML, YAMLError  # few sites have a plan

    try:
        document = YAML(typ="safe").load(text)
    except YAMLError as reason:
        said = " ".join(str(reason).split())
        raise ConfigError(f"{file}: not valid YAML ({said}); give map_server's file") from None
    missing = [
        key
        for key in ("image", "resolution", "origin")
        if not isinstance(document, dict) or key not in document
    ]
    if missing:
        raise ConfigError(f"{file}: a floor plan needs the key «{missing[0]}»; add it")
    return document


def _grey(data: bytes, where: str) -> np.ndarray:
    from PIL import Image  # installed with the parts that draw; the others do not need it

    try:
        with Image.open(io.BytesIO(data)) as picture:
            if picture.width * picture.height > _MOST_PIXELS:
                raise ConfigError(
                    f"{where} has {picture.width} × {picture.height} pixels; make it smaller"
                )
            has_alpha = "A" in picture.getbands() or "transparency" in picture.info
            if has_alpha:  # transparent pixels are paper
                clear = Image.new("RGBA", picture.size, "white")
                picture = Image.alpha_composite(clear, picture.convert("RGBA"))
            return np.asarray(picture.convert("L"), dtype=np.uint8).copy()
    except (OSError, ValueError, Image.DecompressionBombError) as reason:
        raise ConfigError(f"{where} is no picture ({reason}); give a PNG or PGM") from None
