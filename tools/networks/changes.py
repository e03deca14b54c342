"""Which cameras moved between two networks, and how surely.

Each run has its own map, as its first robot starts elsewhere. So the two maps are aligned by the
cameras that stayed, which are those that agree with the most others. A camera's remaining
difference, against its uncertainty in both and that of the alignment, says whether it moved.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trigpoint.base.errors import InputError
from trigpoint.base.terminal import table
from trigpoint.geometry import Pose
from trigpoint.geometry.chi_square import chi2_limit, chi2_tail
from trigpoint.geometry.rotation import Array, exp, log
from trigpoint.map.network import CameraRecord, Network

_DIMENSIONS = 6
_CHANCE = 1e-3
"""Probability of reporting any unmoved camera as moved in a whole comparison."""
_FEWEST = 3
_ROUNDS = 10
_SETTLED = 1e-12  # metres and radians


@dataclass(frozen=True, slots=True)
class Change:
    """One camera: how far it moved and turned, χ² with six degrees of freedom, and the probability
    of at least as much for a camera that stayed."""

    camera: str
    moved_m: float
    turned_rad: float
    chi2: float
    probability: float
    has_moved: bool


@dataclass(frozen=True, slots=True)
class _Pair:
    old: Pose
    new: Pose
    old_covariance: Array
    new_covariance: Array


def changes(old: Network, new: Network) -> list[Change]:
    """Every camera located in both; raise InputError if there are fewer than three: with two, it is
    undecidable which one moved."""
    names = [name for name in old.located if name in new.located]
    if len(names) < _FEWEST:
        raise InputError(
            f"located in both networks: {len(names)}; at least {_FEWEST} cameras are needed to "
            "say which one moved"
        )
    pairs = [_pair(old.cameras[name], new.cameras[name]) for name in names]
    limit = chi2_limit(_DIMENSIONS, _CHANCE / len(names))
    stayed = _stayed(pairs, limit)
    found = []
    for number, (name, pair) in enumerate(zip(names, pairs, strict=True)):
        others = [pairs[i] for i in stayed if i != number]
        new_from_old, covariance = _laid(others, pairs[stayed[0]])
        left, spread = _left(pair, new_from_old, covariance)
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
    styles = ["red" if one.has_moved else "" for one in found]
    return table(head, rows, left=(0, 5), styles=styles)


def changes_json(found: Sequence[Change]) -> str:
    rows = [
        {
            "camera": one.camera,
            "moved": one.moved_m,
            "turned": one.turned_rad,
            "chi2": one.chi2,
            "probability": one.probability,
            "has_moved": one.has_moved,
        }
        for one in found
    ]
    return json.dumps({"cameras": rows}, indent=1)


def check_file(path: Path) -> Path:
    """The path; raise InputError if it is a table of distances instead of a network."""
    if path.suffix == ".csv":
        raise InputError(f"{path}: a tape measure's distances are given with --measured")
    return path


def _pair(old: CameraRecord, new: CameraRecord) -> _Pair:
    assert old.map_from_camera is not None
    assert new.map_from_camera is not None
    # If both take something as known without error, only rounding remains.
    rounding = 1e-12 * np.eye(_DIMENSIONS)
    return _Pair(
        old.map_from_camera.pose,
        new.map_from_camera.pose,
        old.covariance_matrix + rounding,
        new.covariance_matrix + rounding,
    )


def _stayed(pairs: Sequence[_Pair], limit: float) -> list[int]:
    """Indices of the largest set of cameras that agree with one of them; that one first."""
    best: tuple[int, float, list[int]] = (0, 0.0, [])
    for seed, pair in enumerate(pairs):
        new_from_old, covariance = _laid([], pair)
        distances = {}
        for number, other in enumerate(pairs):
            if number != seed:
                left, spread = _left(other, new_from_old, covariance)
                distances[number] = float(left @ np.linalg.solve(spread, left))
        agreeing = [number for number, value in distances.items() if value < limit]
        score = (len(agreeing), -sum(distances[number] for number in agreeing))
        if score > best[:2] or not best[2]:
            best = (*score, [seed, *agreeing])
    return best[2]


def _laid(pairs: Sequence[_Pair], seed: _Pair) -> tuple[Pose, Array]:
    """new_from_old and its covariance (6, 6) by least squares over the pairs, starting from the
    seed's; by the seed alone if there are none."""
    chosen = list(pairs) or [seed]
    new_from_old = seed.new @ seed.old.inverse()
    information = np.eye(_DIMENSIONS)
    for _ in range(_ROUNDS):
        information = np.zeros((_DIMENSIONS, _DIMENSIONS))
        gradient = np.zeros(_DIMENSIONS)
        for pair in chosen:
            left, spread = _left(pair, new_from_old, np.zeros((_DIMENSIONS, _DIMENSIONS)))
            derivative = _derivative(new_from_old @ pair.old)
            weighted = np.linalg.solve(spread, derivative).T
            information += weighted @ derivative
            gradient += weighted @ left
        step = np.linalg.solve(information, gradient)
        turn = exp(step[3:])
        new_from_old = Pose(turn, step[:3]) @ new_from_old
        if np.abs(step).max() < _SETTLED:
            break
    return new_from_old, np.linalg.inv(information)


def _left(pair: _Pair, new_from_old: Pose, covariance: Array) -> tuple[Array, Array]:
    """A camera's difference in the new map (6,), metres and radians, and its covariance."""
    expected = new_from_old @ pair.old
    turn = log(pair.new.rotation @ expected.rotation.T)
    left = np.concatenate([pair.new.translation - expected.translation, turn])
    turned = np.zeros((_DIMENSIONS, _DIMENSIONS))
    turned[:3, :3] = turned[3:, 3:] = new_from_old.rotation
    derivative = _derivative(expected)
    spread = pair.new_covariance + turned @ pair.old_covariance @ turned.T
    return left, spread + derivative @ covariance @ derivative.T


def _derivative(pose: Pose) -> Array:
    """Of a pose by a twist of the map about its origin: δt + δθ × t, δθ."""
    x, y, z = pose.translation
    derivative = np.eye(_DIMENSIONS)
    derivative[:3, 3:] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return derivative
