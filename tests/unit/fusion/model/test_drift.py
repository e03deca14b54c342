"""How far odometry's noise carries a robot off: step by step, and whichever way it drives."""

import numpy as np
import pytest

from trigpoint.fusion.model.drift import Drift
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes
from trigpoint.site.config import OdometryNoise

NOISE = OdometryNoise(distance=0.03, lateral=0.0005, heading_drive=0.01, heading_turn=0.006)
STAMPS_NS = np.arange(8) * 250_000_000


def way(heading_rad: float) -> Pose:
    """A metre and a half along a bend, all of it turned."""
    along = np.linspace(0.0, 1.5, len(STAMPS_NS))
    bend = Pose.planar(along, 0.2 * along**2, 0.4 * along)
    return Pose.planar(2.0, 1.0, heading_rad) @ bend


def track_of(poses: Pose) -> OdometryTrack:
    track = OdometryTrack(NOISE, planar=True)
    for row, stamp_ns in enumerate(STAMPS_NS.tolist()):
        track.add(stamp_ns, poses[row])
    return track


def between(poses: Pose, first: int, second: int) -> Array:
    drift = Drift.of(track_of(poses), STAMPS_NS, np.zeros(2), poses)
    noise, _ = drift.between(np.array([first]), np.array([second]))
    return noise[0]


@pytest.mark.parametrize(("first", "second"), [(0, 7), (2, 5), (6, 1), (3, 3)])
def test_each_step_turns_what_comes_after_it(first: int, second: int) -> None:
    poses = way(0.3)
    steps = track_of(poses).motion(STAMPS_NS, np.zeros(2)).covariance
    expected = np.zeros((6, 6))
    for step in range(min(first, second), max(first, second)):
        arm = poses.translation[second] - poses.translation[step + 1]
        turn = lever(arm) @ turned_axes(poses.rotation[step])
        expected += turn @ steps[step] @ turn.T
    np.testing.assert_allclose(between(poses, first, second), expected, atol=1e-12)


def test_drive_that_is_turned_drifts_along_its_own_way() -> None:
    straight, north = between(way(0.0), 0, 7), between(way(np.pi / 2), 0, 7)
    turn = turned_axes(Pose.planar(0.0, 0.0, np.pi / 2).rotation)
    np.testing.assert_allclose(north, turn @ straight @ turn.T, atol=1e-12)
    assert straight[0, 0] > straight[1, 1]
    assert north[1, 1] > north[0, 0]
