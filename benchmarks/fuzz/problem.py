"""A small least-squares problem of every kind of term, as the core's tables: the same structure
each time, with other numbers."""

import numpy as np

# Lens parameters; first column of pose, lens and clock.
_CAMERAS = ((9, 0, 12, 21), (8, 6, -1, -1))
# Nodes, motions, faces, in the plane, held; first column of scales, faces and the last node.
_ROBOTS = ((4, 3, 1, 1, 1, 23, 25, 31), (3, 0, 2, 0, 0, -1, -1, 34))
_COLUMNS = 40
_INNER = 3 * 3 + 2 * 6
# Camera, robot, node, corners, whether the robot deviates.
_PICTURES = (
    *((0, 0, 0, 6, 0), (0, 0, 3, 6, 1), (1, 0, 1, 4, 1)),
    *((1, 1, 0, 6, 0), (0, 1, 1, 6, 1), (0, 1, 2, 6, 1)),
)


def problem(rng: np.random.Generator) -> list[object]:
    """The arguments of `tp_minimised` but for the equations."""
    corners = sum(picture[3] for picture in _PICTURES)
    faces = rng.normal(size=(3, 3))
    cameras = _poses(rng, 2, (0.0, 0.0, -4.0))
    return [
        cameras,
        np.tile([200.0, 200.0, 50.0, 40.0, *[0.0] * 8], (2, 1)),
        0.01 * rng.normal(size=(2, 2)),
        _poses(rng, 7, (0.0, 0.0, 0.0)),
        _poses(rng, 3, faces),
        0.1 * rng.normal(size=(2, 2)),
        *(np.array(_CAMERAS), np.array(_ROBOTS)),
        *(_poses(rng, 3, (0.1, 0.0, 0.0)), np.zeros((2, 2))),
        *(np.tile(1e-4 * np.eye(6), (3, 1, 1)), rng.normal(size=(3, 6, 2))),
        np.array(_PICTURES),
        _poses(rng, 6, (0.0, 0.0, 0.0)),
        *(rng.normal(size=(6, 2)), rng.normal(size=(6, 6)), rng.uniform(1e-6, 1e-2, (6, 6))),
        rng.integers(0, 1, corners),
        *(rng.normal(size=(corners, 3)), 100 * rng.normal(size=(corners, 2))),
        rng.choice([0.0, 1.0, 5.0], corners),
        np.arange(12, 25),
        rng.uniform(0.1, 1.0, (13, 2)),
        *(_poses(rng, 3, faces), rng.uniform(1e-6, 1e-2, (3, 6))),
        *(np.array([1, 2]), np.vstack([cameras[1:], _poses(rng, 1, faces[:1])])),  # c1, a face
        *(np.array([12, 21, 23]), 0.1 * rng.normal(size=3), 1e4 * np.eye(15)),
        *(_COLUMNS, 1e13, float(rng.choice([3.0, np.inf])), 1e-3, 12, np.empty(4)),
    ]


def reduced() -> list[object]:
    """Those of `tp_reduced`."""
    return [np.empty((_COLUMNS, _COLUMNS)), np.empty(_COLUMNS)]


def full_system() -> list[object]:
    """Those of `tp_full_system`."""
    size = _INNER + _COLUMNS
    return [np.empty((size, size)), np.empty(size), np.empty(1)]


def _poses(rng: np.random.Generator, count: int, at: object) -> np.ndarray:
    """Poses (count, 12) near the identity."""
    turns = np.linalg.qr(np.eye(3) + 0.05 * rng.normal(size=(count, 3, 3)))[0]
    turns *= np.sign(np.diagonal(turns, axis1=1, axis2=2))[:, None]
    shifts = np.broadcast_to(np.asarray(at, float), (count, 3)) + 0.05 * rng.normal(size=(count, 3))
    return np.hstack([turns.reshape(count, 9), shifts])
