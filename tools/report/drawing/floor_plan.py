"""A floor plan as a picture under a map, within the page itself."""

import base64
import io

import numpy as np
from PIL import Image

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
    rows, columns = floor.pixels.shape
    corners = building.frame_from_map.inverse() @ floor.corners
    low, right, _, top = plan(corners[:, :2])
    across, down = (right - low) / columns, (low - top) / rows
    matrix = " ".join(f"{value:.6g}" for value in (*across, *down, *top))
    return element(
        "image",
        href=f"data:image/png;base64,{_png(floor.pixels)}",
        width=columns,
        height=rows,
        transform=f"matrix({matrix})",
        preserveAspectRatio="none",
        class_="floor-plan",
    )


def _png(pixels: np.ndarray) -> str:
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "png", optimize=True)
    return base64.b64encode(data.getvalue()).decode()
