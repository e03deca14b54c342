"""Publishes where a robot is that takes no corrections itself: its pose and its transforms."""

from trigpoint.bus import Bus
from trigpoint.cdr import encode
from trigpoint.messages import PoseEstimate, Transform, Transforms
from trigpoint.topics import CORRECTED, ROBOT_TF

from .bridge import Location


class Places:
    """One robot's. `odom_frame`: the name that its odometry frame has; `has_base`: whether the
    transform from there to the base is ours to publish, or the robot's."""

    def __init__(
        self, bus: Bus, site: str, robot: str, *, odom_frame: str = "", has_base: bool = True
    ) -> None:
        self._pose = bus.publisher(CORRECTED, CORRECTED.key(site, robot))
        self._tf = bus.publisher(ROBOT_TF, ROBOT_TF.key(site, robot))
        self._base = f"{robot}/base"
        self.odom_frame, self._has_base = odom_frame or f"{robot}/odom", has_base

    def publish(self, location: Location) -> None:
        """Send both. Any thread, one at a time."""
        at, pose = location.at, location.map_from_base
        estimate = PoseEstimate(at.stamp_ns, "map", pose, location.covariance)
        self._pose.put(encode(estimate))
        frame = self.odom_frame
        map_from_odom = pose @ at.odom_from_base.inverse()
        transforms = [Transform(at.stamp_ns, "map", frame, map_from_odom)]
        if self._has_base:
            transforms.append(Transform(at.stamp_ns, frame, self._base, at.odom_from_base))
        self._tf.put(encode(Transforms(tuple(transforms))))
