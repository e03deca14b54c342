"""Estimates the noise of an odometry whose scales are unknown from the pictures.

An odometry that is off by some per cent also has other noise than the site file states: turns that
end late, wheels that slip, drifts that go on for seconds (decision 0606). While one camera sees the
robot, its pictures measure its motion far better than its odometry does. Over windows of seconds,
long enough for such drifts to add up, the difference e of both is normal with

    C = S + Σ σₖ² Bₖ

where S is the covariance by the pictures and Bₖ that by a noise σₖ of 1. The σₖ of maximum
likelihood are taken in place of the stated ones where those are rejected at one in a thousand
(variance components: Searle, Casella and McCulloch, «Variance Components», 1992).
"""

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import SLIP, OdometryTrack
from trigpoint.fusion.model.prediction import batch_jacobian, odometry_terms
from trigpoint.fusion.model.problem import Batch, Problem, State
from trigpoint.fusion.solver.quasi_newton import least
from trigpoint.geometry import Pose
from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique
from trigpoint.site.config import OdometryNoise

# Drifts that go on for seconds add up over such a window; of longer ones there would be few.
_WINDOW_NS = to_ns(4.0)
_LONGEST_WINDOW_NS = 2 * _WINDOW_NS
_LEAST_WINDOWS = 20
# Prior sigma of a noise sigma's logarithm: what the pictures do not show stays near the stated.
_PRIOR_LOG_SIGMA = 2.0
_LEAST_SIGMA = 1e-3
_NIL = 1e-9  # of a sigma that is stated as none
_WIDE = 0.03
# The probability that noise which is as the site file states is rejected in a session.
_SIGNIFICANCE = 1e-3
_CHANGED = 0.1
_PARTS = ("distance", "lateral", "heading_drive", "heading_turn")
# A picture leaves some direction open where it knows it by less than this, relative to the best.
_DETERMINED = 1e-6


class _Seen(Struct, frozen=True):
    """Where one camera alone puts the robot: moments (n,), map_from_base (n), covariances
    (n, d, d) of the free disturbances."""

    stamps_ns: np.ndarray
    map_from_base: Pose
    covariance: Array


class Windows(Struct, frozen=True):
    """Differences (n, d) between pictures and odometry, their covariance (n, d, d) by the pictures,
    and that by each part of the noise with a sigma of 1, (6, n, d, d)."""

    difference: Array
    by_pictures: Array
    by_noise: Array

    def misfit(self, log_sigmas: Array) -> tuple[float, Array]:
        """-2 ln L, up to a constant, and its gradient (6,)."""
        parts = np.exp(2 * log_sigmas)[:, None, None, None] * self.by_noise
        inverse = np.linalg.inv(self.by_pictures + parts.sum(axis=0))
        pull = (inverse @ self.difference[..., None])[..., 0]
        value = np.sum(self.difference * pull) - np.sum(np.linalg.slogdet(inverse)[1])
        spread = inverse - pull[:, :, None] * pull[:, None, :]
        return float(value), 2 * np.einsum("nij,knji->k", spread, parts)


def learn(data: DataSet, assembled: Assembled, state: State) -> bool:
    """Estimate the odometry noise of every planar robot whose scales are estimated; whether a sigma
    changed by a tenth."""
    changed = False
    for robot in assembled.problem.priors.scales:
        track = data.tracks[robot]
        if not track.planar:
            continue
        scale, slip = data.odometry_scale.get(robot, (1.0, 1.0))
        stated = scale * _sigmas(data.site.robots[robot].odometry, SLIP * slip / scale, 0.0)
        before = _sigmas(track.noise, track.slip, track.skid)
        windows = windows_of(assembled.problem, state, robot)
        sigmas = stated if windows is None else likeliest(windows, stated)
        *noise, track.slip, track.skid = sigmas.tolist()
        track.noise = msgspec.structs.replace(
            data.site.robots[robot].odometry, **dict(zip(_PARTS, noise, strict=True))
        )
        changed |= bool(np.any(np.abs(np.log(_floored(sigmas) / _floored(before))) > _CHANGED))
    return changed


def likeliest(windows: Windows, stated: Array) -> Array:
    """The sigmas (6,) of the contract's four parts, slip and skid; the stated ones unless others
    are significantly likelier (likelihood ratio: Wilks, 1938)."""
    start = np.log(_floored(stated))

    def cost(logs: Array) -> tuple[float, Array]:
        value, gradient = windows.misfit(logs)
        apart = (logs - start) / _PRIOR_LOG_SIGMA
        return value + float(apart @ apart), gradient + 2 * apart / _PRIOR_LOG_SIGMA

    # From above: the gradient vanishes for a sigma near zero.
    wide = np.maximum(start, np.log(_WIDE))
    found, value = least(cost, wide)
    gain = windows.misfit(np.log(np.maximum(stated, _NIL)))[0] - value
    return np.exp(found) if gain > chi2_limit(len(start), _SIGNIFICANCE) else stated


def windows_of(problem: Problem, state: State, robot: str) -> Windows | None:
    """The windows of a robot's trajectory, one after the other; None where there are too few."""
    chain, scales = problem.chains[robot], state.robots[robot].scales
    spans = _spans([_seen(problem, b, state) for b in problem.batches if b.robot == robot])
    if len(spans) < _LEAST_WINDOWS:
        return None
    moments_ns = unique([seen.stamps_ns[row] for seen, *rows in spans for row in rows])
    first = np.searchsorted(moments_ns, [seen.stamps_ns[start] for seen, start, _ in spans])
    start = _stacked([(seen, row) for seen, row, _ in spans])
    end = _stacked([(seen, row) for seen, _, row in spans])
    motion = chain.track.motion(moments_ns, scales).where(first)
    plain = replace(motion, covariance=np.broadcast_to(np.eye(6), motion.covariance.shape))
    terms = odometry_terms(start[0], end[0], plain, chain.tangent)
    by_pictures = _carried(terms.by_earlier, start[1]) + _carried(terms.by_later, end[1])
    free = np.ix_(range(len(spans)), chain.tangent, chain.tangent)
    by_noise = [
        track.motion(moments_ns, scales).where(first).covariance[free]
        for track in _of_one_part(chain.track)
    ]
    is_known = motion.covariance[free].max(axis=(1, 2)) < 1.0
    return Windows(terms.residual[is_known], by_pictures[is_known], np.array(by_noise)[:, is_known])


def _seen(problem: Problem, batch: Batch, state: State) -> _Seen:
    """A Newton step from the robot's nodes to where a camera's pictures alone put it."""
    chain = problem.chains[batch.robot]
    d = len(chain.tangent)
    jacobian, residual, _ = batch_jacobian(problem, batch, state)
    flat = jacobian[..., :d].reshape(len(batch.nodes), -1, d)
    strength = np.linalg.svd(flat, compute_uv=False)
    kept = strength[:, -1] > _DETERMINED * strength[:, 0]
    flat, nodes = flat[kept], batch.nodes[kept]
    transposed = np.swapaxes(flat, 1, 2)
    covariance = np.linalg.inv(transposed @ flat)
    gradient = transposed @ residual.reshape(len(batch.nodes), -1, 1)[kept]
    step = np.zeros((len(nodes), 6))
    step[:, chain.tangent] = -(covariance @ gradient)[..., 0]
    poses = state.robots[batch.robot].map_from_base[nodes].disturbed(step)
    order = np.argsort(chain.stamps_ns[nodes], kind="stable")
    return _Seen(chain.stamps_ns[nodes][order], poses[order], covariance[order])


def _spans(sights: list[_Seen]) -> list[tuple[_Seen, int, int]]:
    """Pairs of moments at which one camera saw the robot, a window apart, none over another."""
    found: list[tuple[_Seen, int, int]] = []
    for seen in sights:
        ends = np.searchsorted(seen.stamps_ns, seen.stamps_ns + _WINDOW_NS)
        for start, end in enumerate(ends.tolist()):
            is_within = end < len(ends)
            if is_within and seen.stamps_ns[end] - seen.stamps_ns[start] <= _LONGEST_WINDOW_NS:
                found.append((seen, start, end))
    found.sort(key=lambda span: span[0].stamps_ns[span[2]])
    chosen: list[tuple[_Seen, int, int]] = []
    for span in found:
        if not chosen or span[0].stamps_ns[span[1]] >= chosen[-1][0].stamps_ns[chosen[-1][2]]:
            chosen.append(span)
    return chosen


def _stacked(rows: list[tuple[_Seen, int]]) -> tuple[Pose, Array]:
    """Poses (n) and covariances (n, d, d)."""
    poses = Pose.stack([seen.map_from_base[row] for seen, row in rows])
    return poses, np.stack([seen.covariance[row] for seen, row in rows])


def _carried(jacobian: Array, covariance: Array) -> Array:
    return jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)


def _of_one_part(track: OdometryTrack) -> list[OdometryTrack]:
    """Copies of the odometry, each with one part of the noise alone, with a sigma of 1."""
    nothing = dict.fromkeys(_PARTS, 0.0)
    silent = OdometryNoise(**nothing)
    stated = [OdometryNoise(**(nothing | {part: 1.0})) for part in _PARTS]
    return [
        *(track.noisy(noise, slip=0.0, skid=0.0) for noise in stated),
        track.noisy(silent, slip=1.0, skid=0.0),
        track.noisy(silent, slip=0.0, skid=1.0),
    ]


def _sigmas(noise: OdometryNoise, slip: float, skid: float) -> Array:
    return np.array([*(getattr(noise, part) for part in _PARTS), slip, skid])


def _floored(sigmas: Array) -> Array:
    return np.maximum(sigmas, _LEAST_SIGMA)
