"""Which lens model: the simplest that predicts views it was not fitted to as well as the best.

Residuals of the fit itself always favour the model with more coefficients, and a criterion that
counts corners (BIC) is misled by boards that are not quite flat, whose errors within a view are
alike. So views are left out in turn, a fifth at a time, and what counts is the error on those,
view by view: another model must be better by more than two standard errors of the difference
(Hastie, Tibshirani and Friedman, «The Elements of Statistical Learning», 7.10, with one).
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array

from .calibration_fit import Fit, fit, place
from .calibration_knowledge import look_weights
from .calibration_views import View

MODELS = (LensModel.PLUMB_BOB, LensModel.EQUIDISTANT, LensModel.RATIONAL_POLYNOMIAL)
"""From the usual to the richest."""

_FOLDS = 5
_STANDARD_ERRORS = 2.0
# A fit to four fifths of the views begins at that to all of them, so it is near.
_FOLD_STEPS = 12
_WORST_FACTOR = 10.0


class Candidate(Struct, frozen=True, eq=False):
    """A model that was tried. `held_out`: mean squared error of a coordinate in each view when the
    lens was fitted without it, px², (views,); infinite where no lens could be fitted."""

    model: LensModel
    fit: Fit | None
    held_out: Array

    @property
    def held_out_px(self) -> float:
        """Root mean square of a coordinate's error on views that were left out; by the median view,
        since a single one at the picture's edge can be off by anything."""
        return float(np.sqrt(np.median(self.held_out)))


def candidates(
    views: Sequence[View],
    size: tuple[int, int],
    *,
    start: Fit | None = None,
    looks: np.ndarray | None = None,
) -> list[Candidate]:
    """Every model, fitted to all views and held out; `size`: width, height; `start`: a fit to these
    views; `looks`: (views,) which are alike, so left out together."""
    looks = np.arange(len(views)) if looks is None else looks
    weights = look_weights(looks)
    found = []
    for model in MODELS:
        own = fit(model, views, size, start=start, weights=weights)
        errors = np.full(len(views), np.inf)
        if own is not None:
            errors = held_out(own, views, size, looks)
        found.append(Candidate(model, own, errors))
    return found


def choose(tried: Sequence[Candidate]) -> Candidate | None:
    """The first of `tried` that none beats beyond chance; None where no model could be fitted."""
    fitted = [one for one in tried if one.fit is not None]
    if not fitted:
        return None
    errors = np.array([one.held_out for one in fitted])
    # One view that a model cannot place at all must not decide over all the others.
    bound = _WORST_FACTOR * np.median(errors.min(axis=0))
    errors = np.minimum(errors, bound) if np.isfinite(bound) else np.zeros_like(errors)
    best = errors[np.argmin(errors.mean(axis=1))]
    return next(one for one, own in zip(fitted, errors, strict=True) if _is_as_good(own, best))


def held_out(found: Fit, views: Sequence[View], size: tuple[int, int], looks: np.ndarray) -> Array:
    """The mean squared error of a coordinate in each view, its own pose allowed for, by a lens of
    the same model that was fitted without it and those like it; (views,), px²."""
    errors = np.full(len(views), np.inf)
    folds = looks % min(_FOLDS, int(looks.max()) + 1)
    for fold in range(folds.max() + 1):
        rest = np.flatnonzero(folds != fold).tolist()
        start = Fit(
            found.camera,
            tuple(found.camera_from_face[i] for i in rest),
            tuple(found.errors[i] for i in rest),
        )
        if not rest:
            continue
        weights = look_weights(looks[rest])
        model, some = found.camera.model, [views[i] for i in rest]
        known = fit(model, some, size, start=start, weights=weights, steps=_FOLD_STEPS)
        if known is None:
            continue
        for i in np.flatnonzero(folds == fold).tolist():
            errors[i] = _mean_square(known, views[i])
    return errors


def _mean_square(known: Fit, view: View) -> float:
    placed = place(known.camera, view)
    return np.inf if placed is None else float(np.sum(placed.error**2) / (placed.error.size - 6))


def _is_as_good(own: Array, best: Array) -> bool:
    worse = own - best
    standard_error = float(np.std(worse, ddof=1)) / np.sqrt(len(worse))
    return bool(worse.mean() <= _STANDARD_ERRORS * standard_error)
