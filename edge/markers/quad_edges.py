"""Where the edges of dark quadrilaterals lie, between pixels."""

import numpy as np

from trigpoint.edge.image.sampling import sampled
from trigpoint.geometry.rotation import Array

# Where along a side its edge is looked for, and how far across it, pixels.
_ALONG = np.linspace(0.2, 0.8, 7)
_ACROSS = np.linspace(-2.0, 2.0, 9)
_MOST_MENDED_PX = 4.0


def straightened(grey: np.ndarray, quads: Array) -> Array:
    """The quads (n, 4, 2) between straight lines along their edges in the picture.

    An outline rounds the corners off, by two pixels where a slanted marker is pointed; its sides it
    meets. Where lines lead far from a corner it is left as it is.
    """
    if len(quads) == 0:
        return quads
    along = np.roll(quads, -1, axis=1) - quads
    length = np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1) / length
    places = quads[:, :, None] + along[:, :, None] * _ALONG[:, None]
    across = places[..., None, :] + outward[:, :, None, None] * _ACROSS[:, None]
    values = sampled(grey, across.reshape(len(quads), -1, 2)).reshape(across.shape[:-1])
    rise = np.maximum(np.diff(values, axis=-1), 0.0) ** 2
    weight = rise.sum(axis=-1)
    edge = rise @ ((_ACROSS[1:] + _ACROSS[:-1]) / 2) / np.maximum(weight, 1e-9)
    first, last = _line(edge, weight)
    begin = quads + outward * first[..., None]
    end = quads + along + outward * last[..., None]
    corners = _crossing(np.roll(begin, 1, axis=1), np.roll(end, 1, axis=1), begin, end)
    far = np.linalg.norm(corners - quads, axis=2) > np.minimum(
        _MOST_MENDED_PX, 0.3 * length[..., 0]
    )
    return np.where(far[..., None], quads, corners)


def _line(edge: Array, weight: Array) -> tuple[Array, Array]:
    """Where the line through edges (…, k) at _ALONG of a side begins and ends, (…,) each."""
    total = np.maximum(weight.sum(axis=-1), 1e-9)
    middle, mean = (weight @ _ALONG) / total, (weight * edge).sum(axis=-1) / total
    apart = _ALONG - middle[..., None]
    spread = (weight * apart**2).sum(axis=-1)
    slope = (weight * apart * edge).sum(axis=-1) / np.maximum(spread, 1e-9)
    return mean - slope * middle, mean + slope * (1 - middle)


def _crossing(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Where the lines through a and b and through c and d cross, (…, 2); c where they do not."""
    first, second, apart = b - a, d - c, c - a
    turn = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    is_parallel = np.abs(turn) < 1e-6
    share = (apart[..., 0] * second[..., 1] - apart[..., 1] * second[..., 0]) / np.where(
        is_parallel, 1.0, turn
    )
    return np.where(is_parallel[..., None], c, a + share[..., None] * first)
