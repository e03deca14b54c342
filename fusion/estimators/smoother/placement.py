"""The robot's pose at observations that no solution has included yet: by odometry from where it is
known, corrected wherever a located camera saw it.

The live filter does the same sighting by sighting; here it is done for a whole stretch without the
filter. It gives a batch solution its initial values, and ambiguous views their readings.
"""

from dataclasses import dataclass, replace

import numpy as np

from trigpoint.fusion.initialisation.robots import RobotLocation, RobotUndetermined, locate_robot
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.odometry import composed
from trigpoint.fusion.reading.alignment import PosePrior, align
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

# What a robot's place by odometry is taken to be uncertain by at the least, m² and rad².
_FLOOR_M2 = 0.05**2
_FLOOR_RAD2 = 0.05**2
# An observation whose face is known starts well enough by odometry while that drifted less.
_STEADY_M2 = 0.03**2
_STEADY_RAD2 = 0.02**2


@dataclass(frozen=True, slots=True)
class _Way:
    """A robot's way by odometry alone at moments (n,), and by how much it drifted up to each:
    variances (n,), summed over directions."""

    path: Pose
    drift_m2: Array
    drift_rad2: Array


@dataclass(frozen=True, slots=True)
class _Anchor:
    """A moment at which the robot's pose is known."""

    row: int
    map_from_base: Pose


def place(data: DataSet, known: Filter, robot: str, indices: list[int]) -> RobotUndetermined | None:
    """Put into these entries of the data set, in the order of their times, where the robot stood;
    those of located cameras are read and accepted where they fit.

    What nothing locates in the map yet, the whole way of a robot or a stretch of it between jumps
    and breaks of its odometry, is located by them; where that fails they are left without a place,
    and why is returned.
    """
    track = data.tracks[robot]
    start_ns = known.stamps_ns.get(robot)
    stamps = [data.entries[index].observation.stamp_ns for index in indices]
    starts = [] if start_ns is None else [start_ns]
    pieces = track.pieces(np.array([*stamps, *starts], dtype=np.int64)).tolist()
    result = None
    for piece in dict.fromkeys(pieces[: len(indices)]):
        here = [index for index, other in zip(indices, pieces, strict=False) if other == piece]
        is_known = start_ns is not None and pieces[-1] == piece
        robot_reasons = _place_piece(data, known, robot, here, start_ns if is_known else None)
        result = robot_reasons if robot_reasons is not None else result
    return result


def _place_piece(
    data: DataSet, known: Filter, robot: str, indices: list[int], start_ns: int | None
) -> RobotUndetermined | None:
    """Place entries that odometry leads to from one another, and from where the robot is known to
    be at `start_ns`."""
    track = data.tracks[robot]
    entries = [data.entries[index] for index in indices]
    stamps = np.array([entry.observation.stamp_ns for entry in entries], dtype=np.int64)
    stamps = np.clip(stamps, track.first_ns, track.last_ns)
    moments = np.unique(stamps if start_ns is None else np.append(stamps, start_ns))
    way = _way(data, known, robot, moments)
    rows = np.searchsorted(moments, stamps).tolist()
    there: set[int] = set()
    if start_ns is not None:
        row = int(np.searchsorted(moments, start_ns))
        anchor = _Anchor(row, known.robot(data, robot).map_from_base)
    else:
        located = locate_robot(data, known, robot, indices)
        if isinstance(located, RobotUndetermined):
            return located
        anchor = _take(data, located, dict(zip(indices, rows, strict=True)))
        there = {id(data.entries[index]) for index in located.map_from_base}
    for entry, row in zip(entries, rows, strict=True):
        if id(entry) in there:
            assert entry.map_from_base is not None  # just taken
            anchor = _Anchor(row, entry.map_from_base)
        else:
            anchor = _placed(data, known, way, entry, row, anchor)
    return None


def _take(data: DataSet, located: RobotLocation, rows: dict[int, int]) -> _Anchor:
    """Put the location found into the data set; the first of its poses."""
    for index, map_from_base in located.map_from_base.items():
        entry = data.entries[index]
        entry.observation = entry.observation.read_as(located.readings[index])
        entry.observation = entry.observation.judged(Verdict.ACCEPTED)
        entry.map_from_base = map_from_base
    first = min(located.map_from_base, key=lambda index: rows[index])
    return _Anchor(rows[first], located.map_from_base[first])


def _way(data: DataSet, known: Filter, robot: str, moments: np.ndarray) -> _Way:
    if len(moments) == 1:
        return _Way(Pose.stack([Pose.identity()]), np.zeros(1), np.zeros(1))
    motion = data.tracks[robot].motion(moments, known.scales(robot))
    variances = np.diagonal(motion.covariance, axis1=1, axis2=2)
    return _Way(
        composed(motion.earlier_from_later),
        np.concatenate([[0.0], np.cumsum(variances[:, :3].sum(axis=1))]),
        np.concatenate([[0.0], np.cumsum(variances[:, 3:].sum(axis=1))]),
    )


def _carried(way: _Way, anchor: _Anchor, row: int) -> Pose:
    return anchor.map_from_base @ (way.path[anchor.row].inverse() @ way.path[row])


def _placed(
    data: DataSet, known: Filter, way: _Way, entry: Entry, row: int, anchor: _Anchor
) -> _Anchor:
    """Place one entry; where the robot is known best then."""
    observation = entry.observation
    entry.map_from_base = _carried(way, anchor, row)
    if not known.has_camera(observation.camera):
        return anchor
    between = way.path.translation[row] - way.path.translation[anchor.row]
    turned = abs(way.drift_rad2[row] - way.drift_rad2[anchor.row])
    moved = abs(way.drift_m2[row] - way.drift_m2[anchor.row]) + between @ between * turned
    if observation.chosen and moved < _STEADY_M2 and turned < _STEADY_RAD2:
        entry.observation = observation.judged(Verdict.ACCEPTED)
        return anchor
    covariance = np.diag(np.repeat([_FLOOR_M2 + moved, _FLOOR_RAD2 + turned], 3))
    prior = RobotEstimate(observation.stamp_ns, entry.map_from_base, covariance)
    aligned = align_to(data, known, observation, prior)
    if aligned is None:
        return anchor
    entry.observation, entry.map_from_base = aligned[0].judged(Verdict.ACCEPTED), aligned[1]
    return _Anchor(row, aligned[1])


def align_to(
    data: DataSet, known: Filter, observation: Observation, predicted: RobotEstimate | None
) -> tuple[Observation, Pose] | None:
    """A located camera's observation in its best reading, and the robot's pose by it; None where
    nothing fits or two readings fit equally well."""
    camera = known.state.cameras[observation.camera]
    prior, distance = None, 3.0
    if predicted is not None:
        prior = _prior(predicted)
        between = predicted.map_from_base.translation - camera.map_from_camera.translation
        distance = float(np.linalg.norm(between))
    return _aligned(
        data, known, observation, prior, known.camera_sigma_px(observation.camera, distance)
    )


def align_before(
    data: DataSet, known: Filter, observation: Observation, predicted: RobotEstimate
) -> tuple[Observation, Pose] | None:
    """The same for what the filter itself predicts of an observation's moment.

    Far from where a wide map began, robot and camera are both uncertain, but together: the prior is
    then where the robot is from the camera, which tells faces that look alike apart.
    """
    tangent = data.tracks[observation.robot].tangent
    if _prior(predicted).is_tight(tangent):
        return align_to(data, known, observation, predicted)
    before = known.before(data, observation.robot, observation.camera, predicted.stamp_ns)
    floor = np.diag(np.repeat([_FLOOR_M2, _FLOOR_RAD2], 3))
    prior = _prior(replace(predicted, covariance=before + floor))
    if not prior.is_tight(tangent):
        return align_to(data, known, observation, predicted)
    # What the robot cannot do, the camera does: it is off by height or tilt.
    variances = np.where(np.isin(np.arange(6), tangent), 0.0, np.diagonal(before))
    camera = known.state.cameras[observation.camera]
    between = predicted.map_from_base.translation - camera.map_from_camera.translation
    turned = variances[3:].max() + variances[:3].max() / max(between @ between, 0.01)
    return _aligned(data, known, observation, prior, float(camera.lens.fx * np.sqrt(turned)))


def _prior(predicted: RobotEstimate) -> PosePrior:
    return PosePrior(predicted.map_from_base, predicted.covariance + 1e-10 * np.eye(6))


def _aligned(
    data: DataSet,
    known: Filter,
    observation: Observation,
    prior: PosePrior | None,
    extra_sigma_px: float,
) -> tuple[Observation, Pose] | None:
    camera, robot = known.state.cameras[observation.camera], observation.robot
    alignment = align(
        observation,
        data.targets[robot],
        camera.lens,
        camera.map_from_camera,
        tangent=data.tracks[robot].tangent,
        prior=prior,
        extra_sigma_px=extra_sigma_px,
    )
    if alignment is None or alignment.margin < DECISIVE:
        return None
    return alignment.read(observation), alignment.map_from_base
