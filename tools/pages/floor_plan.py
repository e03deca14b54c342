"""Pictures under a map, within the page itself: a floor plan, and what is known of its cells."""

import base64
import io

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.map.building import Building

from .plan import Plan
from .svg import element

_MOST_PIXELS = 1400
"""A side: the map is 1000 points wide, and a page with the plan in it should stay small."""


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


def png(pixels: np.ndarray, *, colours: int = 0) -> bytes:
    """A picture's file; `colours`: how many shades of grey are enough, 0: as many as it has."""
    from PIL import Image  # half of those who draw pages draw no pictures

    picture, data = Image.fromarray(pixels), io.BytesIO()
    (picture.quantize(colours) if colours else picture).save(data, "png", optimize=True)
    return data.getvalue()
