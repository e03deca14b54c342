"""Another chance for observations that were set aside: read again where their robot stood by now.

In goes an entry of the data set with a place of its robot, and what is known; its observation is
accepted where it fits there, of several views those that do. One that does not is not tried again
until camera or robot have moved.
"""

import numpy as np

from trigpoint.fusion.estimators import outlier_rejection
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import is_elsewhere
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.problem import Chain
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.geometry import Pose

from .placement import align_to

_TRIED_SAME = 1e-3


class Readmission:
    """Not thread-safe."""

    def __init__(self, data: DataSet) -> None:
        self._data = data
        # Of entries, with which places of camera and robot they were read in vain.
        self._in_vain: dict[int, tuple[Pose, Pose]] = {}

    def look_again(self, index: int, known: Filter, chain: Chain | None) -> None:
        """Accept an entry's observation where it fits. Its camera must be known, and where the
        robot stood; `chain`: the robot's in the last solution."""
        entry = self._data.entries[index]
        observation, map_from_base = entry.observation, entry.map_from_base
        assert map_from_base is not None
        camera = known.state.cameras[observation.camera].map_from_camera
        if self._is_in_vain(index, camera, map_from_base):
            return
        is_rejected = observation.verdict is Verdict.REJECTED
        part = (
            outlier_rejection.without_far_views(self._data, known.state, index)
            if is_rejected
            else None
        )
        if part is not None:
            entry.observation = part.judged(Verdict.ACCEPTED)
            return
        prior = self._loosely(observation, map_from_base, chain)
        aligned = align_to(self._data, known, observation, prior)
        if aligned is None or (is_rejected and _is_elsewhere(aligned[1], prior)):
            self._in_vain[index] = (camera, map_from_base)
        else:
            entry.observation = aligned[0].judged(Verdict.ACCEPTED)

    def _is_in_vain(self, index: int, camera: Pose, map_from_base: Pose) -> bool:
        """Whether an observation was read in vain with camera and robot where they are now."""
        if index not in self._in_vain:
            return False
        camera_then, base_then = self._in_vain[index]
        moved = camera.difference(camera_then)
        apart = map_from_base.difference(base_then)
        return bool(max(np.abs(moved).max(), np.abs(apart).max()) < _TRIED_SAME)

    def _loosely(
        self, observation: Observation, map_from_base: Pose, chain: Chain | None
    ) -> RobotEstimate:
        """Where the robot stood by the sightings around: within a decimetre and a tenth of a
        radian, and what odometry may have drifted since the nearest one."""
        variance = np.repeat([0.01, 0.01], 3)
        stamp_ns, track = observation.stamp_ns, self._data.tracks[observation.robot]
        if chain is not None and track.covers(stamp_ns):
            nearest = int(chain.stamps_ns[np.argmin(np.abs(chain.stamps_ns - stamp_ns))])
            if nearest != stamp_ns:
                moments = np.array(sorted([nearest, stamp_ns]))
                drift = np.diagonal(track.motion(moments, chain.scales).covariance[0])
                variance = variance + np.repeat([drift[:3].sum(), drift[3:].sum()], 3)
        return RobotEstimate(stamp_ns, map_from_base, np.diag(variance))


def _is_elsewhere(map_from_base: Pose, prior: RobotEstimate) -> bool:
    """Whether a pose is not where the robot stood."""
    apart = map_from_base.difference(prior.map_from_base)
    return is_elsewhere(float(np.sum(apart**2 / np.diagonal(prior.covariance))))
