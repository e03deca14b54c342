"""Arguments of the live filter's kernels that fit together, which drawn ones hardly ever do."""

import numpy as np

Arguments = list[object]
_LENS = np.array([200.0, 200.0, 50.0, 40.0, 0.1, 0.01, 0.001, 0.0, 0.0])


def _rows(rng: np.random.Generator, count: int) -> np.ndarray:
    """Poses (n, 12), a metre or so before a camera at the origin."""
    shifts = rng.normal([0.0, 0.0, 2.0], 0.3, (count, 3))
    return np.concatenate([np.tile(np.eye(3).reshape(-1), (count, 1)), shifts], axis=1)


def _tangent(rng: np.random.Generator) -> np.ndarray:
    return np.array([0, 1, 5]) if rng.random() < 0.5 else np.arange(6)


def _motion(rng: np.random.Generator) -> Arguments:
    """A track of odometry, two moments of it, its noise and scales."""
    count = int(rng.integers(2, 30))
    stamps = np.cumsum(rng.integers(1, 50_000_000, count))
    twists = rng.normal(0.0, 0.02, (count, 6)) * (rng.random(count) < 0.8)[:, None]
    between = np.sort(rng.integers(stamps[0], stamps[-1] + 1, 2)).tolist()
    noise = rng.choice([0.0, 0.01], 7), 0.001, float(rng.choice([0.0, 0.01]))
    return [
        *(stamps, np.tile(np.eye(3), (count, 1, 1)), np.cumsum(twists[:, :3], axis=0), twists),
        *(rng.random(count) < 0.1, np.where(rng.random(count) < 0.1, 0.3, 0.0)),
        *(*between, *noise, rng.normal(0.0, 0.01, 2)),
    ]


def carried_on(rng: np.random.Generator) -> Arguments:
    return [*_motion(rng), _rows(rng, 1), np.eye(6), np.empty((1, 12)), np.empty((6, 6))]


def odometry_step(rng: np.random.Generator) -> Arguments:
    tangent = _tangent(rng)
    d = len(tangent)
    made = np.empty((d, d + 2)), np.empty(d), np.empty((d, d))
    return [*_motion(rng), _rows(rng, 1), _rows(rng, 1), tangent, *made]


def _table(rng: np.random.Generator, columns: int) -> np.ndarray:
    """Near columns that were just made so."""
    square, rows = np.eye(columns), rng.normal(size=(2, columns))
    return np.concatenate([square, square, np.zeros((columns, columns)), rows])


def near_extended(rng: np.random.Generator) -> Arguments:
    whole = rng.permutation(12)
    near, added = np.split(whole[: rng.integers(0, 12)], [rng.integers(0, 6)])
    count = len(near) + len(added)
    made = np.empty((3 * count + 2, count))
    return [rng.normal(size=12), np.eye(12), near, _table(rng, len(near)), added, made]


def near_moved(rng: np.random.Generator) -> Arguments:
    table, (m, q) = _table(rng, 8), rng.integers(0, 8, 2)
    rows, source = rng.permutation(8)[:m], rng.permutation(8)[:q]
    moved = rng.normal(size=(m, q)), rng.normal(size=m), np.eye(m)
    return [table, rows, source, *moved, np.empty_like(table)]


def near_updated(rng: np.random.Generator) -> Arguments:
    table, rows, r = _table(rng, 8), rng.permutation(8)[: rng.integers(1, 8)], rng.integers(1, 9)
    jacobian, free = rng.normal(size=(r, len(rows))), rows[: rng.integers(0, len(rows) + 1)]
    is_all = int(rng.integers(0, 2))
    given = [table, rows, jacobian, rng.normal(size=r), free, is_all]
    return [*given, np.empty_like(table), np.empty(r)]


def _equations(rng: np.random.Generator) -> tuple[Arguments, np.ndarray]:
    """The equations of a robot's pose, and the corners in its frame."""
    corners, tangent = int(rng.integers(1, 20)), _tangent(rng)
    known = int(rng.integers(0, 2))
    points = rng.normal(0.0, 0.1, (corners, 3))
    pixels = rng.uniform(0.0, 100.0, (corners, 2))
    root = 10.0 * np.eye(len(tangent))[: known * len(tangent)]
    camera = np.concatenate([np.eye(3).reshape(-1), np.zeros(3)])[None]
    weights = np.where(rng.random(corners) < 0.1, 0.0, 5.0)
    return [_LENS, camera, pixels, weights, _rows(rng, known), root, tangent], points


def aligned(rng: np.random.Generator) -> Arguments:
    given, points = _equations(rng)
    count = int(rng.integers(0, 4))
    many = np.tile(points, (count, 1, 1))
    return [*given, many, _rows(rng, count), np.empty((count, 12)), np.empty(count)]


def aligned_nearly(rng: np.random.Generator) -> Arguments:
    given, points = _equations(rng)
    count = int(rng.integers(0, 4))
    return [*given, np.tile(points, (count, 1, 1)), _rows(rng, 1), np.empty(count)]


def aligned_robustly(rng: np.random.Generator) -> Arguments:
    given, points = _equations(rng)
    return [*given, points, _rows(rng, 1), np.empty(len(points)), np.empty(1)]


def corner_factor(rng: np.random.Generator) -> Arguments:
    tangent, corners, faces = _tangent(rng), int(rng.integers(1, 20)), int(rng.integers(1, 4))
    moves, has_lens, has_faces = (int(rng.integers(0, 2)) for _ in range(3))
    columns = len(tangent) + 6 + 9 * has_lens + 2 * moves + 6 * faces * has_faces + 1
    camera = np.concatenate([np.eye(3).reshape(-1), np.zeros(3)])[None]
    return [
        *(_LENS, camera, _rows(rng, 1), _rows(rng, 1), _rows(rng, faces)),
        *(rng.integers(0, faces, (1, corners)), rng.normal(0.0, 0.1, (1, corners, 3))),
        *(rng.uniform(0.0, 100.0, (1, corners, 2)), np.full((1, corners), 5.0)),
        *(rng.normal(0.0, 0.1, (moves, 6)), np.array([3.0]), tangent, has_lens, has_faces),
        *(np.full(6 * int(rng.integers(0, 2)), 1e-4), np.empty((columns, columns))),
    ]
