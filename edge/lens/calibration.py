"""A camera's intrinsics from views of the target: which views, which model, how well known.

1. A start from views that differ in place, size and slant, by the model that fits them best.
2. Views that this lens does not explain are rejected.
3. Of the others the most informative are taken, until one more would tell next to nothing.
4. The model is chosen by its error on views that were left out, and fitted to those taken.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.errors import InputError
from trigpoint.geometry import CameraModel
from trigpoint.geometry.rotation import Array

from .calibration_choice import MODELS, Candidate, candidates, choose
from .calibration_fit import Fit, Placed, fit, place
from .calibration_information import Knowledge, knowledge, most_informative, view_information
from .calibration_views import View

FEWEST_VIEWS = 4
MOST_VIEWS = 60
_ENOUGH_VIEWS = 20
_START_VIEWS = 25
_LEAST_GAIN = 0.005
_BAD_FACTOR = 2.5
_ROUNDS = 3
_LEAST_RMS_PX = 1e-3


@dataclass(frozen=True, slots=True)
class Rejected:
    """A view that the lens does not explain; `rms_px`: of its corners' distances."""

    name: str
    rms_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A camera as its pictures say it is.

    `used`: the views that the fit is of; `spare`: how many more were good, but told nothing new;
    `tried`: every model, the chosen one among them.
    """

    fit: Fit
    known: Knowledge
    used: tuple[View, ...]
    spare: int
    rejected: tuple[Rejected, ...]
    tried: tuple[Candidate, ...]

    @property
    def camera(self) -> CameraModel:
        return self.fit.camera

    @property
    def coverage(self) -> Array:
        """How many corners lie in each ninth of the picture's width and height, (9, 9), rows."""
        pixels = np.concatenate([view.pixels for view in self.used])
        width, height = self.camera.width, self.camera.height
        bounds = [[-0.5, height - 0.5], [-0.5, width - 0.5]]
        return np.histogram2d(pixels[:, 1], pixels[:, 0], bins=9, range=bounds)[0]


def calibrate(
    views: Sequence[View], size: tuple[int, int], *, most: int = MOST_VIEWS
) -> Calibration:
    """Work out a camera of `size` (width, height) from views; raises InputError where they do not
    tell enough. Deterministic; some seconds for 60 views."""
    _check_count(len(views), len(views))
    start = _start(views, size)
    placed = [place(start, view) for view in views]
    rms_px = np.array([np.inf if one is None else one.rms_px for one in placed])
    good = _are_good(rms_px, views)
    _check_count(len(views), int(good.sum()))
    used = _selected(
        start, views, [one if ok else None for one, ok in zip(placed, good, strict=True)], most
    )
    chosen, known, tried = _chosen(used, size)
    return Calibration(
        fit=chosen,
        known=known,
        used=tuple(used),
        spare=int(good.sum()) - len(used),
        rejected=tuple(
            Rejected(views[i].name, float(rms_px[i])) for i in np.flatnonzero(~good).tolist()
        ),
        tried=tried,
    )


def _chosen(
    used: Sequence[View], size: tuple[int, int]
) -> tuple[Fit, Knowledge, tuple[Candidate, ...]]:
    tried = tuple(candidates(used, size))
    chosen = choose(tried)
    if chosen is None or chosen.fit is None:
        raise InputError(_TOO_ALIKE)
    try:
        return chosen.fit, knowledge(chosen.fit, used), tried
    except ValueError:
        raise InputError(_TOO_ALIKE) from None


_TOO_ALIKE = (
    "no lens fits these views; show the board near and far, slanted up to 45 degrees to all sides, "
    "and in every corner of the picture"
)


def _check_count(found: int, good: int) -> None:
    if good < FEWEST_VIEWS:
        text = f"{found} views of the target were found"
        text += f", {good} of them good" if good < found else ""
        raise InputError(f"{text}; a calibration needs {FEWEST_VIEWS}, better 20: add pictures")


def _start(views: Sequence[View], size: tuple[int, int]) -> CameraModel:
    """A first lens from views that differ most; raises InputError where there is none."""
    chosen = [views[i] for i in _spread(views, size, _START_VIEWS)]
    best = _best_fit(chosen, size)
    for _ in range(_ROUNDS):
        good = _are_good(best.view_rms_px, chosen)
        if good.all() or good.sum() < FEWEST_VIEWS:
            break
        chosen = [view for view, is_good in zip(chosen, good, strict=True) if is_good]
        best = _best_fit(chosen, size)
    return best.camera


def _best_fit(views: Sequence[View], size: tuple[int, int]) -> Fit:
    """Of every model's the one that fits the median view best."""
    found = [one for one in (fit(model, views, size) for model in MODELS) if one is not None]
    if not found:
        raise InputError(_TOO_ALIKE)
    return min(found, key=lambda one: float(np.median(one.view_rms_px)))


def _spread(views: Sequence[View], size: tuple[int, int], most: int) -> list[int]:
    """Views far from each other in where their outer corners are (farthest point first): that is
    place, size and slant at once, before any lens is known."""
    marks = np.array([outer_pixels(view) for view in views]) / size[0]
    middle = np.linalg.norm(marks - marks.mean(axis=0), axis=(1, 2))
    chosen = [int(np.argmin(middle))]
    distance = np.linalg.norm(marks - marks[chosen[0]], axis=(1, 2))
    while len(chosen) < min(most, len(views)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(marks - marks[chosen[-1]], axis=(1, 2)))
        distance[chosen] = -1.0
    return sorted(chosen)


def outer_pixels(view: View) -> Array:
    """The pixels of the corners nearest to the pattern's four ends, (4, 2)."""
    x, y = view.points[:, 0], view.points[:, 1]
    return view.pixels[[int(np.argmin(way)) for way in (x + y, y - x, -x - y, x - y)]]


def _are_good(view_rms_px: Array, views: Sequence[View]) -> np.ndarray:
    """Which views' residuals are not far above those of the median view, (views,) bool.

    A smeared view counts as bad too: the fit weighs all corners alike. Where few views let a lens
    fit too well, the detector's own sigmas say what is usual.
    """
    usual = float(np.median(view_rms_px))
    if len(views) < _ENOUGH_VIEWS:
        usual = max(usual, math.sqrt(2) * float(np.median([view.sigma for view in views])))
    return np.isfinite(view_rms_px) & (view_rms_px <= _BAD_FACTOR * usual)


def _selected(
    camera: CameraModel, views: Sequence[View], placed: Sequence[Placed | None], most: int
) -> list[View]:
    """The views that tell most of those that were placed, in the order in which they were given."""
    kept = [(view, at) for view, at in zip(views, placed, strict=True) if at is not None]
    information = [
        view_information(camera, at.camera_from_face, view) / max(at.rms_px, _LEAST_RMS_PX) ** 2
        for view, at in kept
    ]
    chosen = most_informative(information, fewest=_ENOUGH_VIEWS, most=most, gain=_LEAST_GAIN)
    return [kept[i][0] for i in sorted(chosen)]
