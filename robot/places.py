"""Publishes the pose and transforms of a robot that takes no corrections itself."""

from trigpoint.bus.bus import Bus
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import PoseEstimate, Transform, Transforms
from trigpoint.contract.topics import CORRECTED, ROBOT_TF
from trigpoint.node.health import Health

from .bridge import Location


class Places:
    """Publishes for one robot; `health` counts what is sent."""

    def __init__(self, bus: Bus, site: str, robot: str, health: Health) -> None:
        self._health, self._keys = health, (CORRECTED.key(site, robot), ROBOT_TF.key(site, robot))
        self._pose = bus.publisher(CORRECTED, CORRECTED.key(site, robot))
        self._tf = bus.publisher(ROBOT_TF, ROBOT_TF.key(site, robot))
        self._odom, self._base = f"{robot}/odom", f"{robot}/base"

    def publish(self, location: Location, *, own_odom: str = "") -> None:
        """Send both. `own_odom`: the robot's own name for its odometry frame, if the robot itself
        publishes the transform from there to its base. Any thread, one at a time."""
        at, pose = location.at, location.map_from_base
        self._pose.put(encode(PoseEstimate(at.stamp_ns, "map", pose, location.covariance)))
        if own_odom:
            transforms = [Transform(at.stamp_ns, "map", own_odom, location.map_from_counted)]
        else:
            transforms = [
                Transform(at.stamp_ns, "map", self._odom, location.map_from_odom),
                Transform(at.stamp_ns, self._odom, self._base, at.odom_from_base),
            ]
        self._tf.put(encode(Transforms(tuple(transforms))))
        for key in self._keys:
            self._health.count(f"sent {key}")
