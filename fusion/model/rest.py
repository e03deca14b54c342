"""A robot's odometry without the noise that it shows while the robot stands (`rest.cpp`).

At rest encoders repeat one reading, but a gyroscope's heading wanders and creeps by its bias, and a
fused pose trembles. All of that leads nowhere: n steps of noise end about √n steps from where they
began, those of a drive n steps. So a robot stands while its last readings lie no further apart than
noise of the steps' size can take them; then its pose is the one that it came to rest with. Where
readings repeat exactly nothing is noise, and every step is motion.
"""

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import Handle, In, Kernel, Out

RECENT_S = 2.0
"""Over so long a robot must have stood until what its readings show counts as noise."""


class Rest(Handle):
    """One robot's reported poses, in order. `trembles`: whether it stands, and its readings show
    noise, as far as `add` was told. It can be copied, and sent to another process."""

    name = "tp_rest"

    def __init__(self, *, planar: bool = False) -> None:
        """`planar`: whether poses are projected into the plane: position and heading."""
        super().__init__()
        self.planar, self.trembles = planar, False

    def __reduce__(self) -> tuple[object, ...]:
        cells = np.zeros(_SAVED(self, np.zeros(0, _WHOLE)), _WHOLE)
        _SAVED(self, cells)
        return _restored, (self.planar, self.trembles, cells)

    def add(self, stamp_ns: int, pose: Pose) -> Pose:
        """The pose of a reading, in a frame in which noise at rest has not moved the robot; stamps
        rise."""
        found = Pose(np.empty((3, 3)), np.empty(3))
        self.trembles = bool(_ADDED(self, self.planar, stamp_ns, *_parts(pose), *_parts(found)))
        return found

    def add_to_track(
        self, stamps_ns: np.ndarray, poses: Pose, last: Pose, track: tuple[np.ndarray | int, ...]
    ) -> np.ndarray:
        """Append messages (m) to a `track`, as `OdometryTrack.add` gives it; what became of each
        (m,). `last`: is set to the last pose that is taken, as it was reported."""
        outcomes = np.empty(len(stamps_ns), _WHOLE)
        given = self, self.planar, np.ascontiguousarray(stamps_ns), *_parts(poses), *_parts(last)
        _ADDED_TO_TRACK(*given, *track[:3], outcomes, *track[3:])
        return outcomes


_REAL, _WHOLE = np.float64, np.int64
_POSE = In(_REAL, (3, 3)), In(_REAL, (3,))
_FOUND = Out(_REAL, (3, 3)), Out(_REAL, (3,))
_ADDED = Kernel("tp_rest_added", Rest, int, int, *_POSE, *_FOUND)
_ADDED_TO_TRACK = Kernel(
    *("tp_odometry_added", Rest, int, In(_WHOLE, ("m",))),
    *(In(_REAL, ("m", 3, 3)), In(_REAL, ("m", 3)), *_FOUND),
    *(Out(_WHOLE, (3,)), int, In(_REAL, (6,)), Out(_WHOLE, ("m",))),
    *(Out(_WHOLE, ("n",)), Out(_REAL, ("n", 3, 3)), Out(_REAL, ("n", 3))),
    *(Out(_REAL, ("n", 6)), Out(np.bool_, ("n",)), Out(_REAL, ("n",))),
)
_SAVED = Kernel("tp_rest_saved", Rest, Out(_WHOLE, ("n",)))
_RESTORED = Kernel("tp_rest_restored", Rest, In(_WHOLE, ("n",)))


def _restored(planar: bool, trembles: bool, cells: np.ndarray) -> Rest:
    rest = Rest(planar=planar)
    rest.trembles = trembles
    _RESTORED(rest, np.ascontiguousarray(cells))
    return rest


def _parts(pose: Pose) -> tuple[Array, Array]:
    return np.ascontiguousarray(pose.rotation), np.ascontiguousarray(pose.translation)
