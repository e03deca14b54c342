"""A camera's intrinsics from views of the target: which views, which model, how well known.

1. A start from views that differ in place, size and slant.
2. Views that this lens does not explain at all are rejected, and of a board that is in two places
   of one picture the one that it explains less; all others are used.
3. The model is chosen by its error on views that were left out.
4. What the views leave open is said by name.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import OperationError
from trigpoint.base.words import counted
from trigpoint.geometry import CameraModel
from trigpoint.geometry.rotation import Array

from .calibration_choice import Candidate, candidates, choose
from .calibration_doubts import FEWEST_LOOKS, Doubt, doubts
from .calibration_fit import Fit, Placed, place
from .calibration_information import most_informative, view_information
from .calibration_knowledge import Knowledge, knowledge
from .calibration_looks import looks_of
from .calibration_places import losers_of, off_px, rivals_of
from .calibration_start import equidistant_start
from .calibration_views import View

FEWEST_VIEWS = 4
# More views than so many make a fit slow and hardly better.
MOST_VIEWS = 200
_START_VIEWS = 25
# A view is bad where its median corner is off so many times as far as the median view's. Views at
# the rim of a fisheye lens, or of a board that moved, are off by two or three times.
_BAD_FACTOR = 6.0
_LEAST_RMS_PX = 1e-3


class Rejected(Struct, frozen=True):
    """A view that the lens does not explain; `rms_px`: of its corners' distances; `is_double`: the
    board is in another place of that picture too, which the lens explains better."""

    name: str
    rms_px: float
    is_double: bool = False


class Calibration(Struct, frozen=True, eq=False):
    """A camera as its pictures say it is.

    `used`: the views that the fit is of; `spare`: how many more were good, but told nothing new;
    `tried`: every model, the chosen one among them; `looks`: how many of those used differ;
    `doubts`: what the views do not determine, none where the lens can be trusted.
    """

    fit: Fit
    known: Knowledge
    used: tuple[View, ...]
    spare: int
    rejected: tuple[Rejected, ...]
    tried: tuple[Candidate, ...]
    looks: int
    doubts: tuple[Doubt, ...]

    @property
    def camera(self) -> CameraModel:
        return self.fit.camera

    @property
    def has_sigmas(self) -> bool:
        """Whether looks can be held against each other at all, which is what sigmas rest on."""
        return self.looks >= FEWEST_LOOKS

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
    """Work out a camera of `size` (width, height) from views; raises OperationError where they
    lead to no lens at all. Deterministic; some seconds for 60 views."""
    if len(views) < FEWEST_VIEWS:
        raise OperationError(_too_few(len(views), len(views)))
    start, placed, losers = _begun(views, size)
    good = _are_good(placed, losers)
    if good.sum() < FEWEST_VIEWS:
        raise OperationError(_too_few(len(views), int(good.sum())))
    taken = _selected(start, views, placed, good, most)
    used = [views[i] for i in taken]
    looks = looks_of(used, size[0])
    at = [one for i in taken if (one := placed[i]) is not None]
    first = Fit(start, tuple(one.camera_from_face for one in at), tuple(one.error for one in at))
    tried = tuple(candidates(used, size, start=first, looks=looks))
    chosen, known = _chosen(tried, used, looks)
    return Calibration(
        fit=chosen,
        known=known,
        used=tuple(used),
        spare=int(good.sum()) - len(used),
        rejected=tuple(
            Rejected(views[i].name, one.rms_px if (one := placed[i]) else np.inf, i in losers)
            for i in np.flatnonzero(~good).tolist()
        ),
        tried=tried,
        looks=int(looks.max()) + 1,
        doubts=doubts(chosen, known, used, looks),
    )


def _chosen(
    tried: Sequence[Candidate], used: Sequence[View], looks: np.ndarray
) -> tuple[Fit, Knowledge]:
    chosen = choose(tried)
    if chosen is None or chosen.fit is None:
        raise OperationError(_TOO_ALIKE)
    try:
        return chosen.fit, knowledge(chosen.fit, used, looks)
    except ValueError:
        raise OperationError(_TOO_ALIKE) from None


_TOO_ALIKE = (
    "no lens fits these views; show the board near and far, slanted up to 45 degrees to all sides, "
    "and in every corner of the picture"
)


def _too_few(found: int, good: int) -> str:
    were = "was" if found == 1 else "were"
    text = f"{counted(found, 'view')} of the target {were} found"
    text += f", {good} of them good" if good < found else ""
    return f"{text}; a calibration needs {FEWEST_VIEWS}, better 20: add pictures"


def _start(views: Sequence[View], size: tuple[int, int]) -> CameraModel:
    """A first lens from views that differ most; raises OperationError where there is none."""
    chosen = [views[i] for i in _spread(views, size, _START_VIEWS)]
    found = equidistant_start(chosen, size)
    if found is None:
        raise OperationError(_TOO_ALIKE)
    return found.camera


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


def _begun(
    views: Sequence[View], size: tuple[int, int]
) -> tuple[CameraModel, list[Placed | None], set[int]]:
    """A first lens, all views under it, and which of them show a board that is elsewhere in the
    same picture: at first the smaller ones, then those that the lens explains less."""
    rivals = rivals_of(views)
    losers = {i for same in rivals for i in same[1:]}
    while True:
        start = _start([view for i, view in enumerate(views) if i not in losers], size)
        placed = [place(start, view) for view in views]
        better = losers_of(rivals, placed)
        if better == losers or not rivals:
            return start, placed, losers
        losers, rivals = better, []


def _are_good(placed: Sequence[Placed | None], losers: set[int]) -> np.ndarray:
    """Which views' median corners are not far beyond those of the median view, (views,) bool;
    those that lose against another place of the same board are not."""
    off = np.array([np.inf if i in losers else off_px(one) for i, one in enumerate(placed)])
    counted = [one for i, one in enumerate(off.tolist()) if i not in losers]
    usual = max(float(np.median(counted)), _LEAST_RMS_PX)
    return np.isfinite(off) & (off <= _BAD_FACTOR * usual)


def _selected(
    camera: CameraModel,
    views: Sequence[View],
    placed: Sequence[Placed | None],
    good: np.ndarray,
    most: int,
) -> list[int]:
    """The good views, in the order in which they were given; of more than `most` those that tell
    most."""
    usable = np.flatnonzero(good).tolist()
    if len(usable) <= most:
        return usable
    kept = [(i, one) for i in usable if (one := placed[i]) is not None]
    information = [
        view_information(camera, one.camera_from_face, views[i])
        / max(one.rms_px, _LEAST_RMS_PX) ** 2
        for i, one in kept
    ]
    chosen = most_informative(information, fewest=most, most=most, gain=0.0)
    return sorted(kept[i][0] for i in chosen)
