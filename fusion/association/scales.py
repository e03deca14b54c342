"""Roughly estimates odometry scales of which the site file knows little, before all else.

Visits, their modes and the graph are linear in the scales. An error of a fifth bends a turn far
beyond the linear range, so the scales are first estimated from single visits, and the odometry is
corrected by them. No association is decided here, and the estimates assume twice the stated noise;
where no visit tells the scales, the prior stays.
"""

import msgspec
import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.odometry import PARTS, OdometryTrack
from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise

from .events import EVIDENCE, Events
from .memory import Memory
from .mode import VisitModes
from .modes import ModeFinder
from .noise import PESSIMISTIC, with_noise
from .visits import telling, visits_of

_ROUGH = 0.05
"""Prior sigma of a scale from which on a turn's error of second order exceeds what a visit's poses
are known by."""
# Estimates are rounded to such steps, so that results which depend on them can be kept when more
# pictures come in.
_STEP = 0.01
# The less is known of the scales at first, the shorter the visits are and the less each tells.
_MOST_PASSES = 3


def with_learnt_scales(
    data: DataSet, observations: list[Observation], events: Events, memory: Memory
) -> DataSet:
    """The data set with the odometry corrected by the scales that visits tell, and with what these
    leave uncertain as the new prior; robots whose scales are known well stay as they are."""
    for _ in range(_MOST_PASSES):
        rough = rough_robots(data)
        if not rough:
            break
        wide = with_noise(data, dict.fromkeys(rough, PESSIMISTIC))
        finder = ModeFinder(wide, observations, events, memory)
        visits = telling([v for v in visits_of(data, observations) if v.robot in rough])
        found = [finder.modes_of(visit) for visit in visits]
        before = data
        for robot in rough:
            data = _told(data, robot, [one for one in found if one.visit.robot == robot])
        if all(np.array_equal(_sigmas(before, r), _sigmas(data, r)) for r in rough):
            break
    return data


def rough_robots(data: DataSet) -> list[str]:
    """The robots whose odometry scales have a wide prior."""
    return [robot for robot in data.tracks if _sigmas(data, robot).max() > _ROUGH]


def with_solved_scales(
    draft: DataSet, solved: DataSet, scales: dict[str, tuple[Array, Array]]
) -> DataSet:
    """A draft with the odometry of such robots corrected by a solution, and as noisy as the
    solution's tracks. `scales`: by robot, the scales (2,) and their sigmas (2,)."""
    for robot in rough_robots(draft):
        if robot not in scales:
            continue
        mean, sigma = scales[robot]
        draft = with_scales(draft, robot, mean, np.maximum(sigma, _STEP))
        track = solved.tracks[robot]
        parts = {part: getattr(track.noise, part) for part in PARTS}
        noise = msgspec.structs.replace(draft.site.robots[robot].odometry, **parts)
        noisy = draft.tracks[robot].noisy(noise, slip=track.slip, skid=track.skid)
        draft = _with_odometry(draft, robot, noise, noisy)
    return draft


def _sigmas(data: DataSet, robot: str) -> Array:
    """Prior sigmas (2,) of distance and heading scale."""
    noise = data.site.robots[robot].odometry
    return np.array([noise.distance_scale, noise.heading_scale])


def _told(data: DataSet, robot: str, found: list[VisitModes]) -> DataSet:
    """The data set with a robot's scales by these visits; unchanged where none tells them."""
    sigmas = _sigmas(data, robot)
    prior = np.diag(np.maximum(sigmas, 1e-6) ** -2.0)
    clear = [scales for one in found if (scales := _clear(one)) is not None]
    if not clear:
        return data
    means = np.array([one[0] for one in clear])
    each = np.linalg.inv(np.array([one[1] for one in clear]))
    information = prior + (each - prior).sum(axis=0)
    mean = np.linalg.solve(information, (each @ means[..., None]).sum(axis=0)[:, 0])
    apart = means - mean
    scatter = float(np.einsum("ni,nij,nj->", apart, each, apart)) / max(1, apart.size - 2)
    # Real odometry has no constant scale, and its visits scatter by more than chance.
    left = np.sqrt(max(1.0, scatter) * np.diagonal(np.linalg.inv(information)))
    sigma = np.minimum(left, sigmas)
    return with_scales(data, robot, np.round(mean / _STEP) * _STEP, sigma)


def _clear(found: VisitModes) -> tuple[Array, Array] | None:
    """A visit's estimate of the scales and its covariance; None where its modes disagree."""
    told = [mode.scales for mode in found.modes if mode.scales is not None]
    if not told:
        return None
    mean, covariance = told[0]
    apart = np.array([other for other, _ in told]) - mean
    distances = np.einsum("ni,ij,nj->n", apart, np.linalg.inv(covariance), apart)
    return (mean, covariance) if np.all(distances < chi2_limit(2, EVIDENCE)) else None


def with_scales(data: DataSet, robot: str, scales: Array, sigmas: Array) -> DataSet:
    """The data set with a robot's odometry scaled, and sigmas (2,) of the remaining errors."""
    distance, heading = sigmas.tolist()
    noise = msgspec.structs.replace(
        data.site.robots[robot].odometry, distance_scale=distance, heading_scale=heading
    )
    return _with_odometry(data, robot, noise, data.tracks[robot].scaled(scales))


def _with_odometry(
    data: DataSet, robot: str, noise: OdometryNoise, track: OdometryTrack
) -> DataSet:
    """The data set with a robot's odometry, and its noise in the site file, replaced."""
    config = msgspec.structs.replace(data.site.robots[robot], odometry=noise)
    site = msgspec.structs.replace(data.site, robots={**data.site.robots, robot: config})
    return replace(data, site=site, tracks={**data.tracks, robot: track})
