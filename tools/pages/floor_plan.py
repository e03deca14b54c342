"""Pictures under a map, within the page itself: a floor plan, and what is known of its cells."""

import base64
import struct
import zlib

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.map.building import Building

from .plan import Plan
from .svg import element

_MOST_PIXELS = 1400
"""A side: the map is 1000 points wide, and a page with the plan in it should stay small."""
_GREY, _RGBA, _NO_FILTER = 0, 6, 0


def floor_plan_image(building: Building, plan: Plan) -> str:
    """The plan where it lies under the map; "" where there is none."""
    if building.plan is None:
        return ""
    floor = building.plan.reduced(_MOST_PIXELS)
    corners = building.frame_from_map.inverse() @ floor.corners
    return picture_on_map(floor.pixels, corners[:, :2], plan, class_="floor-plan")


def picture_on_map(pixels: np.ndarray, corners: Array, plan: Plan, *, class_: str) -> str:
    """A picture, grey (rows, columns) or with colours and opacity (rows, columns, 4), uint8, where
    its corners (4, 2) lie in the map: counter-clockwise from the lower left one."""
    rows, columns = pixels.shape[:2]
    matrix = " ".join(f"{value:.6g}" for value in picture_matrix(plan(corners), columns, rows))
    return element(
        "image",
        href=f"data:image/png;base64,{base64.b64encode(png(pixels)).decode()}",
        width=columns,
        height=rows,
        transform=f"matrix({matrix})",
        preserveAspectRatio="none",
        class_=class_,
    )


def picture_matrix(corners: Array, columns: int, rows: int) -> list[float]:
    """A picture's columns and rows to where its corners (4, 2) lie, counter-clockwise from the
    lower left one: six numbers, as SVG orders them."""
    low, right, _, top = corners
    return [float(value) for value in (*(right - low) / columns, *(low - top) / rows, *top)]


def png(pixels: np.ndarray) -> bytes:
    """The file of a picture as `picture_on_map` takes it (PNG, W3C, 5 and 11): PIL takes longer to
    import than all else of a page."""
    rows, columns = pixels.shape[:2]
    lines = np.insert(pixels.reshape(rows, -1), 0, _NO_FILTER, axis=1)
    parts = (
        (
            b"IHDR",
            struct.pack(">2I5B", columns, rows, 8, _GREY if pixels.ndim == 2 else _RGBA, *3 * [0]),
        ),
        (b"IDAT", zlib.compress(lines.tobytes(), zlib.Z_BEST_COMPRESSION)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
