"""Poses between those that are known."""

import numpy as np

from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

SECOND = 1_000_000_000


def driven(*, broken: bool) -> OdometryTrack:
    """Ten seconds straight ahead at 0.5 m/s; perhaps lifted between the fourth and the fifth."""
    track = OdometryTrack(OdometryNoise(), planar=True)
    for tenth in range(101):
        track.add(tenth * SECOND // 10, Pose.planar(0.05 * tenth, 0.0, 0.0))
    if broken:
        track.break_between(4 * SECOND, 5 * SECOND)
    return track


def at(track: OdometryTrack, end: Pose, *seconds: int) -> Pose:
    """Where the robot was at these seconds, at the origin at first and at `end` after ten."""
    nodes = Pose.stack([Pose.planar(0.0, 0.0, 0.0), end])
    moments = np.array(seconds) * SECOND
    return interpolated(track, np.zeros(2), np.array([0, 10 * SECOND]), nodes, moments)


def test_what_odometry_lacks_is_shared_out_by_time() -> None:
    poses = at(driven(broken=False), Pose.planar(5.0, 1.0, 0.0), 5)
    np.testing.assert_allclose(poses.translation, [[2.5, 0.5, 0.0]], atol=1e-9)


def test_nothing_is_shared_out_across_a_break() -> None:
    turned = Pose.planar(0.0, 7.0, np.pi / 2)
    poses = at(driven(broken=True), turned, 3, 9)
    np.testing.assert_allclose(poses.translation, [[1.5, 0.0, 0.0], [0.0, 6.5, 0.0]], atol=1e-9)
    np.testing.assert_allclose(poses.heading, [0.0, np.pi / 2], atol=1e-9)
