"""A camera's residuals over its picture, and how large they are in sigmas."""

from html import escape

import numpy as np

from trigpoint.base.words import counted
from trigpoint.fusion.estimators.residuals import CameraResiduals
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import quantile

from .axes import Axes
from .svg import drawing, element, group, largest_factor, lines, polyline

_WIDTH = 480.0
_COLUMNS, _ROWS = 16, 12
_MOST_VECTORS, _MOST_WILD = 160, 80
_LONGEST = 20.0  # of an ordinary residual, in the drawing
_CROSS = 3.0 * np.array([[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]])
_FEWEST_IN_FIELD = 3
_BARS, _REACH = 33, 4.125  # sigmas: the middle bar lies around 0


def residual_figures(residuals: CameraResiduals, width: int, height: int, *, name: str) -> str:
    """Both drawings of a camera, each with what it shows below; `width`, `height`: of its
    picture."""
    figures = _picture(residuals, width, height, name=name), _histogram(residuals, name=name)
    shown = [
        element("figure", drawn, element("figcaption", escape(words))) for drawn, words in figures
    ]
    return element("div", *shown, class_="pair")


def covered_share(residuals: CameraResiduals, width: int, height: int) -> float:
    """Which share of the picture's 16 × 12 fields holds a used corner."""
    return float(np.mean(_fields(residuals, width, height) > 0))


def _picture(residuals: CameraResiduals, width: int, height: int, *, name: str) -> tuple[str, str]:
    """The picture with its residuals, and in words what is drawn."""
    scale = _WIDTH / width
    used = np.flatnonzero(residuals.used)
    shown = _spread(used, _MOST_VECTORS)
    factor = _magnification(residuals.residual_px[used], scale)
    places = (residuals.pixels + 0.5) * scale
    begins = places[shown]
    vectors = np.stack([begins, begins + factor * scale * residuals.residual_px[shown]], axis=1)
    wild = places[_spread(np.flatnonzero(~residuals.used), _MOST_WILD)]
    frame = element(
        "rect", x=0.5, y=0.5, width=_WIDTH - 1, height=height * scale - 1, class_="picture"
    )
    picture = drawing(
        _WIDTH,
        height * scale,
        frame,
        _shade(residuals, width, height, scale),
        lines(vectors, class_="residuals"),
        lines(np.stack([begins, begins], axis=1), class_="corners"),
        lines(_means(residuals, width, height, factor) * scale, class_="means"),
        lines(wild[:, None, None] + _CROSS, class_="wild"),
        label=f"The picture of camera {name} with its residuals",
    )
    count = f"{len(shown)} of " if len(shown) < len(used) else ""
    words = (
        f"From where a corner was seen to where it is expected: {count}{len(used)} corners, "
        f"{factor} times larger. Bold: the means of fields, long where a model does not fit"
    )
    covered = covered_share(residuals, width, height)
    words += (
        f". The shade tells how many there are; {100 * covered:.0f} % of the picture is covered."
    )
    left_out = len(residuals.used) - len(used)
    if left_out:
        words += f" Crosses: {counted(left_out, 'corner')} left out."
    return picture, words


def _histogram(residuals: CameraResiduals, *, name: str) -> tuple[str, str]:
    """How many coordinates are how many sigmas off, beside the normal distribution, and in words
    how wide that is."""
    values = residuals.in_sigmas.reshape(-1)
    counts, edges = np.histogram(np.clip(values, -_REACH, _REACH), _BARS, (-_REACH, _REACH))
    across = np.linspace(-_REACH, _REACH, 120)
    normal = np.exp(-(across**2) / 2) / np.sqrt(2 * np.pi) * len(values) * (edges[1] - edges[0])
    top = max(float(counts.max()), float(normal.max())) * 1.12
    axes = Axes.of(_WIDTH, 300.0, x=(-_REACH, _REACH), y=(0.0, top))
    chart = axes.chart(
        "residual of a coordinate, in sigmas",
        "coordinates",
        *axes.bars(counts, edges),
        polyline(axes.points(across, normal), class_="normal"),
        label=f"Histogram of the residuals of camera {name} in sigmas",
    )
    mean = np.mean(values).round(2) + 0.0  # no -0.00
    words = (
        f"Standard deviation {np.std(values):.2f} sigmas, mean {mean:+.2f}; the line is what noise "
        "of the stated size would give."
    )
    return chart, words


def _fields(
    residuals: CameraResiduals, width: int, height: int, weights: Array | None = None
) -> Array:
    """How many used corners lie in each field of the picture, or the sum of their `weights`,
    (columns, rows)."""
    x, y = residuals.pixels[residuals.used].T
    span = ((-0.5, width - 0.5), (-0.5, height - 0.5))
    return np.histogram2d(x, y, bins=(_COLUMNS, _ROWS), range=span, weights=weights)[0]


def _means(residuals: CameraResiduals, width: int, height: int, factor: float) -> Array:
    """From the middles of the fields with corners enough by their mean residuals, so many times
    larger, (n, 2, 2), pixels of the picture."""
    counts = _fields(residuals, width, height)
    sums = [
        _fields(residuals, width, height, each) for each in residuals.residual_px[residuals.used].T
    ]
    has_enough = counts >= _FEWEST_IN_FIELD
    size = np.array([width / _COLUMNS, height / _ROWS])
    middles = (np.argwhere(has_enough) + 0.5) * size
    means = np.stack([each[has_enough] / counts[has_enough] for each in sums], axis=-1)
    return np.stack([middles, middles + factor * means], axis=1)


def _shade(residuals: CameraResiduals, width: int, height: int, scale: float) -> str:
    counts = _fields(residuals, width, height)
    across, down = width * scale / _COLUMNS, height * scale / _ROWS
    most = max(float(counts.max()), 1.0)
    cells = [
        element(
            "rect", x=i * across, y=j * down, width=across, height=down,
            fill_opacity=0.05 + 0.27 * float(counts[i, j]) / most,
        )
        for i, j in zip(*np.nonzero(counts), strict=True)
    ]  # fmt: skip
    return group(*cells, class_="shade")


def _magnification(residual_px: Array, scale: float) -> int:
    if not len(residual_px):
        return 1
    ordinary = quantile(np.linalg.norm(residual_px, axis=1), 0.9) * scale
    return largest_factor(ordinary, _LONGEST)


def _spread(indices: np.ndarray, most: int) -> np.ndarray:
    if len(indices) <= most:
        return indices
    return indices[np.linspace(0, len(indices) - 1, most).round().astype(int)]
