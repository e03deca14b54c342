"""What the views that were kept lack yet, and what to do next: where, how tilted, how near.

A lens is told by views all over the picture (its distortion), slanted to all sides (its focal
length; Zhang, «A Flexible New Technique for Camera Calibration», 2000), near and far. Each need has
a share by which it is met; the kind that is met least comes next, and of it the least met need.
"""

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.edge.lens.calibration import Calibration
from trigpoint.edge.lens.calibration_start import pose_through
from trigpoint.edge.lens.calibration_text import THINLY_COVERED, advice
from trigpoint.edge.lens.calibration_views import View
from trigpoint.geometry import CameraModel
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import CameraConfig

from .seen import area_px

FIELDS = 9
"""The picture is looked at in so many fields a side, as a calibration's own coverage is."""
_TILT_DEG = 25.0
"""Between the slant by which views count as different, 12°, and the best, 30 to 45."""
_NEAR, _FAR = 0.4, 0.2
"""What a board's inner corners span, as a share of the picture's width and height (their geometric
mean): the board is one and a half times as large."""
_HOLD_STILL = (
    "hold the board still for a moment (a camera that reads row after row bends what moves; with "
    "--global-shutter that is not asked)"
)
_ROWS, _COLUMNS = ("upper", "", "lower"), ("left", "", "right")
_TILTS = {"left": (-1, 0), "right": (1, 0), "upper": (0, -1), "lower": (0, 1)}
"""The edge that is nearer to the camera, and where the board's normal then leans in the picture."""


class Kind(StrEnum):
    """What is to differ from view to view."""

    PLACE = "place"
    TILT = "tilt"
    DISTANCE = "distance"


class Need(Struct, frozen=True):
    """`share`: how far it is met, 1 where it is; `advice`: what to do for it."""

    kind: Kind
    name: str
    share: float
    advice: str

    @property
    def is_met(self) -> bool:
        return self.share >= 1


def coverage(views: Sequence[View], size: tuple[int, int]) -> Array:
    """How many corners were seen in each field of the picture, (9, 9), rows."""
    pixels = np.concatenate([np.empty((0, 2)), *(view.pixels for view in views)])
    bounds = [[-0.5, size[1] - 0.5], [-0.5, size[0] - 0.5]]
    return np.histogram2d(pixels[:, 1], pixels[:, 0], bins=FIELDS, range=bounds)[0]


def needs(views: Sequence[View], camera: CameraModel) -> tuple[Need, ...]:
    """Everything that is needed; `camera`: the lens as far as it is known, with which slants are
    told."""
    size = (camera.width, camera.height)
    return (*_places(coverage(views, size)), *_tilts(views, camera), *_distances(views, size))


class Step(Struct, frozen=True):
    """What to do now, and the name of the need that it is for, "" of none."""

    advice: str
    name: str = ""


class Guide:
    """What to do now, by the views that are kept; worked out anew where those are others."""

    def __init__(self, config: CameraConfig) -> None:
        self._config = config
        self._names: frozenset[str] = frozenset()
        self._found: Calibration | None = None
        self.needs: tuple[Need, ...] = ()
        self.coverage: list[int] = [0] * FIELDS**2

    def look(self, views: Sequence[View], size: tuple[int, int], found: Calibration | None) -> None:
        names = frozenset(view.name for view in views)
        if self.needs and names == self._names and found is self._found:
            return
        self._names, self._found = names, found
        supposed = replace(self._config, width=size[0], height=size[1]).nominal()
        self.needs = needs(views, supposed if found is None else found.camera)
        self.coverage = [int(count) for count in coverage(views, size).reshape(-1)]

    def step(
        self, *, is_seen: bool, is_held: bool, is_taken: bool, is_done: bool, is_working: bool
    ) -> Step:
        """`is_held`: nothing that is seen moves too fast; `is_taken`: whether a lens is wanted at
        all; `is_working`: a newer one is being worked out; `is_done`: it is there."""
        if is_done:
            return Step("the lens is taken")
        if not is_seen:
            return Step("show the board, all of it")
        if not is_taken:
            return Step("")
        if not is_held:
            return Step(_HOLD_STILL)
        need = next_need(self.needs)
        return (
            Step(need.advice, need.name)
            if need is not None
            else Step(self._more(is_working=is_working))
        )

    def _more(self, *, is_working: bool) -> str:
        """What the newest lens lacks where the needs are met."""
        found = self._found
        if found is None or is_working:
            return "go on: the lens is being worked out"
        return found.doubts[0].do if found.doubts else advice(found) or "go on for a moment"


def next_need(wanted: Sequence[Need]) -> Need | None:
    """What to do next; None where everything is met."""
    left = [need for need in wanted if not need.is_met]
    if not left:
        return None
    progress = {
        kind: float(np.mean([min(need.share, 1.0) for need in wanted if need.kind is kind]))
        for kind in Kind
        if any(need.kind is kind for need in left)
    }
    kind = min(progress, key=lambda one: progress[one])
    return min((need for need in left if need.kind is kind), key=lambda need: need.share)


def _places(covered: Array) -> list[Need]:
    """One for each ninth of the picture, the middle first."""
    side = FIELDS // len(_ROWS)
    found = []
    for i, row in enumerate(_ROWS):
        for j, column in enumerate(_COLUMNS):
            part = covered[i * side : (i + 1) * side, j * side : (j + 1) * side]
            name = " ".join(filter(None, (row, column))) or "middle"
            where = name if (row and column) or name == "middle" else f"{name} edge"
            share = float((part > 0).mean()) / THINLY_COVERED
            text = f"bring the board to the {where} of the picture"
            found.append(Need(Kind.PLACE, name, share, text))
    return sorted(found, key=lambda need: need.name != "middle")


def _tilts(views: Sequence[View], camera: CameraModel) -> list[Need]:
    """One for each edge that is to come nearer."""
    poses = [pose for view in views if (pose := pose_through(camera, view)) is not None]
    normals = np.array([pose.rotation[:, 2] for pose in poses]).reshape(-1, 3)
    found = []
    for edge, (x, y) in _TILTS.items():
        lean_deg = np.degrees(np.arctan2(normals[:, :2] @ [x, y], normals[:, 2]))
        share = max(0.0, float(lean_deg.max(initial=0.0))) / _TILT_DEG
        text = f"tilt the board now: its {edge} edge nearer to the camera"
        found.append(Need(Kind.TILT, f"{edge} edge nearer", share, text))
    return found


def _distances(views: Sequence[View], size: tuple[int, int]) -> list[Need]:
    sizes = [math.sqrt(area_px(view.pixels) / (size[0] * size[1])) for view in views]
    near, far = max(sizes, default=0.0) / _NEAR, _FAR / max(min(sizes, default=math.inf), 1e-9)
    return [
        Need(Kind.DISTANCE, "near", near, "closer: let the board fill most of the picture"),
        Need(
            Kind.DISTANCE,
            "far",
            far,
            "farther away: let the board be a third as wide as the picture",
        ),
    ]
