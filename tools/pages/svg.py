"""Small helpers that write markup: elements, text, lines; no library, no script."""

from html import escape

import numpy as np

from trigpoint.geometry.rotation import Array

_NICE = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_COLOURS = 8  # of cameras, k0 … k7 in style.css


def element(name: str, *content: str, **attributes: object) -> str:
    """`<name attributes>content</name>`; `content` is markup, attributes are escaped here.

    An underscore in an attribute's name is written as a hyphen, one at its end is left out; an
    attribute that is None is left out; numbers are written with two decimals at most.
    """
    pairs = [
        f' {key.rstrip("_").replace("_", "-")}="{_value(value)}"'
        for key, value in attributes.items()
        if value is not None
    ]
    inside = "".join(content)
    return f"<{name}{''.join(pairs)}>{inside}</{name}>"


def text(x: float, y: float, words: str, **attributes: object) -> str:
    """Words at a point; escaped."""
    return element("text", escape(words), x=x, y=y, **attributes)


def line(x1: float, y1: float, x2: float, y2: float, **attributes: object) -> str:
    return element("line", x1=x1, y1=y1, x2=x2, y2=y2, **attributes)


def lines(ends: Array, **attributes: object) -> str:
    """Lines from ends (n, 2) to others, (n, 2, 2), as one element; of no length, they are dots."""
    drawn = (f"M{a:.1f},{b:.1f}L{c:.1f},{d:.1f}" for a, b, c, d in ends.reshape(-1, 4).tolist())
    return element("path", d="".join(drawn), **attributes)


def polyline(points: Array, **attributes: object) -> str:
    """A line through points (n, 2)."""
    return element("polyline", points=_points(points), **attributes)


def polygon(points: Array, **attributes: object) -> str:
    return element("polygon", points=_points(points), **attributes)


def circle(x: float, y: float, r: float, *content: str, **attributes: object) -> str:
    return element("circle", *content, cx=x, cy=y, r=r, **attributes)


def group(*content: str, **attributes: object) -> str:
    return element("g", *content, **attributes)


def camera_colour(number: int) -> str:
    """The class of a camera's marks, by its place among the cameras."""
    return f"k{number % _COLOURS}"


def drawing(width: float, height: float, *content: str, label: str, **attributes: object) -> str:
    """A whole drawing that scales with the page; `label` says what it shows."""
    box = f"0 0 {_value(float(width))} {_value(float(height))}"
    return element(
        "svg", *content, viewBox=box, role="img", aria_label=label, **attributes
    )  # no xmlns: it stands in a page


def ellipse_points(centre: Array, covariance: Array, sigmas: float) -> Array:
    """The outline of a 2 × 2 covariance at `sigmas` around a centre (2,); (48, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return centre + sigmas * (unit * np.sqrt(np.maximum(values, 0))) @ vectors.T


def thinned(points: Array, most: int) -> Array:
    """About as many of (n, 2) points as a drawing can show, the last among them."""
    step = max(1, len(points) // most)
    return np.concatenate([points[::step], points[-1:]])


def largest_factor(size: float, largest: float) -> int:
    """The largest round number of times that something can be enlarged to `largest` at most."""
    fitting = [factor for factor in _NICE if factor * size <= largest]
    return fitting[-1] if fitting else 1


def _points(points: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in np.asarray(points, dtype=float).tolist())


def _value(value: object) -> str:
    """An attribute's, escaped."""
    if isinstance(value, (float, np.floating)):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return escape(str(value))
