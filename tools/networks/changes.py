"""Which cameras moved between two networks, and how surely.

Each run has its own map, as its first robot starts elsewhere. So the two maps are aligned by the
cameras that stayed, which are those that agree with the most others. A camera's remaining
difference, against its uncertainty in both and that of the alignment, says whether it moved.
"""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.base.terminal import table
from trigpoint.geometry import Pose
from trigpoint.geometry.chi_square import chi2_limit, chi2_tail
from trigpoint.geometry.rotation import Array, exp
from trigpoint.geometry.uncertainty import lever, turned_axes
from trigpoint.map.network import Network

_DIMENSIONS = 6
_CHANCE = 1e-3
"""Probability of reporting any unmoved camera as moved in a whole comparison."""
_FEWEST = 3
_ROUNDS = 10
_SETTLED = 1e-12  # metres and radians


class Change(Struct, frozen=True, rename={"moved_m": "moved", "turned_rad": "turned"}):
    """One camera: how far it moved and turned, χ² with six degrees of freedom, and the probability
    of at least as much for a camera that stayed."""

    camera: str
    moved_m: float
    turned_rad: float
    chi2: float
    probability: float
    has_moved: bool


class _Pairs(Struct, frozen=True, eq=False):
    """Cameras (n) in both networks: their poses and covariances (n, 6, 6)."""

    old: Pose
    old_covariance: Array
    new: Pose
    new_covariance: Array

    def where(self, chosen: Sequence[int]) -> "_Pairs":
        rows = np.asarray(chosen)
        old, new = self.old[rows], self.new[rows]
        return _Pairs(old, self.old_covariance[rows], new, self.new_covariance[rows])


def changes(old: Network, new: Network) -> list[Change]:
    """Every camera located in both; raise InputError if there are fewer than three: with two, it is
    undecidable which one moved."""
    names = [name for name in old.located if name in new.located]
    if len(names) < _FEWEST:
        raise InputError(
            f"located in both networks: {len(names)}; at least {_FEWEST} cameras are needed to "
            "say which one moved"
        )
    pairs = _Pairs(*_placed(old, names), *_placed(new, names))
    limit = chi2_limit(_DIMENSIONS, _CHANCE / len(names))
    stayed = _stayed(pairs, limit)
    found = []
    for number, name in enumerate(names):
        others = [i for i in stayed if i != number]
        laid = _laid(pairs.where(others or stayed[:1]), _onto(pairs, stayed[0]))
        [left], [spread] = _left(pairs.where([number]), *laid)
        distance = float(left @ np.linalg.solve(spread, left))
        found.append(
            Change(
                name,
                float(np.linalg.norm(left[:3])),
                float(np.linalg.norm(left[3:])),
                distance,
                chi2_tail(_DIMENSIONS, distance),
                distance > limit,
            )
        )
    return found


def changes_table(found: Sequence[Change]) -> str:
    head = ("camera", "moved cm", "turned deg", "chi²", "by chance", "")
    rows = [
        (
            one.camera,
            f"{100 * one.moved_m:.2f}",
            f"{np.degrees(one.turned_rad):.3f}",
            f"{one.chi2:.1f}",
            f"{one.probability:.2g}",
            "moved" if one.has_moved else "stayed",
        )
        for one in found
    ]
    colours = ["red" if one.has_moved else "" for one in found]
    return table(head, rows, left=(0, 5), colours=colours)


def changes_json(found: Sequence[Change]) -> str:
    return msgspec.json.format(msgspec.json.encode({"cameras": found}), indent=1).decode()


def check_file(path: Path) -> Path:
    """The path; raise InputError if it is a table of distances instead of a network."""
    if path.suffix == ".csv":
        raise InputError(f"{path}: a tape measure's distances are given with --measured")
    return path


def _placed(network: Network, names: Sequence[str]) -> tuple[Pose, Array]:
    """Where located cameras are: poses (n) and covariances (n, 6, 6)."""
    records = [network.cameras[name] for name in names]
    poses = [r.map_from_camera.pose for r in records if r.map_from_camera is not None]
    # If both take something as known without error, only rounding remains.
    rounding = 1e-12 * np.eye(_DIMENSIONS)
    return Pose.stack(poses), np.array([r.covariance_matrix for r in records]) + rounding


def _stayed(pairs: _Pairs, limit: float) -> list[int]:
    """Indices of the largest set of cameras that agree with one of them; that one first."""
    best: tuple[int, float, list[int]] = (0, 0.0, [])
    for seed in range(len(pairs.old)):
        left, spread = _left(pairs, *_laid(pairs.where([seed]), _onto(pairs, seed)))
        distances = np.sum(left * np.linalg.solve(spread, left[..., None])[..., 0], axis=-1)
        agreeing = [i for i in np.flatnonzero(distances < limit).tolist() if i != seed]
        score = (len(agreeing), -float(distances[agreeing].sum()))
        if score > best[:2] or not best[2]:
            best = (*score, [seed, *agreeing])
    return best[2]


def _onto(pairs: _Pairs, number: int) -> Pose:
    """new_from_old by which one camera stayed where it was."""
    return pairs.new[number] @ pairs.old[number].inverse()


def _laid(pairs: _Pairs, new_from_old: Pose) -> tuple[Pose, Array]:
    """new_from_old and its covariance (6, 6) by least squares over the pairs, from a first one."""
    information = np.eye(_DIMENSIONS)
    for _ in range(_ROUNDS):
        left, spread = _left(pairs, new_from_old, np.zeros((_DIMENSIONS, _DIMENSIONS)))
        derivative = lever((new_from_old @ pairs.old).translation)
        weighted = np.swapaxes(np.linalg.solve(spread, derivative), -1, -2)
        information = np.sum(weighted @ derivative, axis=0)
        step = np.linalg.solve(information, np.sum(weighted @ left[..., None], axis=0)[..., 0])
        new_from_old = Pose(exp(step[3:]), step[:3]) @ new_from_old
        if np.abs(step).max() < _SETTLED:
            break
    return new_from_old, np.linalg.inv(information)


def _left(pairs: _Pairs, new_from_old: Pose, covariance: Array) -> tuple[Array, Array]:
    """The cameras' differences in the new map (n, 6), metres and radians, and their covariances
    (n, 6, 6); `covariance` (6, 6): new_from_old's."""
    expected = new_from_old @ pairs.old
    turned = turned_axes(new_from_old.rotation)
    spread = pairs.new_covariance + turned @ pairs.old_covariance @ turned.T
    moved = lever(expected.translation)
    spread = spread + moved @ covariance @ np.swapaxes(moved, -1, -2)
    return pairs.new.difference(expected), spread
