"""The estimator of a fixed map: it makes corrections, and keeps nothing of the past.

Cameras stay as the network has them. What a robot's place is known by is carried on sighting by
sighting, with the cameras' uncertainty as one that no sighting reduces. Memory and time for a
sighting do not depend on how long that goes on.
"""

from collections import Counter
from collections.abc import Callable

from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.base.words import counted
from trigpoint.fusion.estimators.interface import CameraEstimate, Live, Update
from trigpoint.fusion.model.dataset import CameraMove, Conclusions, DataSet
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.solver.filter import RobotEstimate

from .network import FixedNetwork
from .placing import Placing

# So many odometry messages of a robot are kept at most, and half of them at least.
MOST_ODOMETRY = 4096
# In an hour cameras creep by less than any sigma.
_WIDENED_EVERY_NS = to_ns(3600.0)


class FixedMap(Live):
    """See `Live`. Not thread-safe. `forget`: called where the odometry's past was
    dropped, for others to drop what refers to it."""

    def __init__(self, data: DataSet, fixed: FixedNetwork, forget: Callable[[], None]) -> None:
        self.data, self.fixed, self._forget = data, fixed, forget
        if fixed.learnt is not None:
            whole, learnt = dict.fromkeys(data.tracks, ()), fixed.learnt
            data.conclude(Conclusions((), whole, learnt.noise, learnt.jitter, {}))
        self._placings = {robot: Placing(data, fixed, robot) for robot in data.site.robots}
        self._cameras = fixed.known
        self._estimates: dict[str, CameraEstimate] = {}
        self._contradictions: Counter[str] = Counter()

    # -- input ------------------------------------------------------------------------------------

    def add_odometry(self, robot: str, readings: Readings) -> list[int]:
        track = self.data.tracks[robot]
        added = track.add_run(readings)
        self._widen(track.last_ns)
        if len(track) > MOST_ODOMETRY:
            self._forget_odometry(robot)
        return added

    def _forget_odometry(self, robot: str) -> None:
        track = self.data.tracks[robot]
        since_ns = int(track.stamps_ns[-MOST_ODOMETRY // 2])
        self._placings[robot].forget_before(since_ns)
        track.forget_before(since_ns)
        self._forget()

    def _widen(self, stamp_ns: int) -> None:
        """Let the cameras creep on up to a time, where that has become something."""
        before = self._cameras
        if before.until_ns is None:
            return
        elapsed_ns = stamp_ns - before.until_ns
        if elapsed_ns < _WIDENED_EVERY_NS:
            return
        crept = {name: creep.covariance(elapsed_ns) for name, creep in before.creep.items()}
        crept = {name: crept[name] for name in before.poses if name in crept}
        self._cameras, self._estimates = before.at(stamp_ns), {}
        for placing in self._placings.values():
            placing.widen(crept)

    def add_observation(self, observation: Observation) -> Update:
        if self.data.is_outdated(observation, ()):
            return Update(
                contradiction=f"camera {observation.camera} noticed that it was moved, and the "
                "fixed map does not say where to: no corrections come of it until the map is "
                "learnt anew"
            )
        seen = observation.scattering(self._scatter(observation))
        update = self._placings[seen.robot].take(seen, self._cameras)
        if update.contradiction is None:
            return update
        return replace(update, contradiction=self._contradiction(seen))

    def camera_moved(self, move: CameraMove) -> None:
        self.data.tell(move)

    def _scatter(self, observation: Observation) -> float:
        """By how much the camera's corners scatter more than stated: as was learnt, or as the
        network's residuals say."""
        camera = observation.camera
        if self.fixed.learnt is not None:
            return self.fixed.learnt.corner_scale.get(camera, 1.0)
        rms_px, stated = self.fixed.records[camera].reprojection_rms, observation.sigmas.mean()
        return 1.0 if rms_px is None else max(1.0, rms_px / float(stated))

    def _contradiction(self, observation: Observation) -> str:
        """What is to be said of a sighting that contradicts the map; "": it may just be wrong."""
        camera, robot = observation.camera, observation.robot
        if camera not in self._placings[robot].contradicted_by:
            return ""
        self._contradictions[camera] += 1
        return (
            f"camera {camera} sees {robot} elsewhere than the fixed map has it "
            f"({counted(self._contradictions[camera], 'sighting')}): one of the two was moved; no "
            "corrections come of it; if that stays, learn the map anew"
        )

    def collect(self, observation: Observation) -> None:
        """Nothing is learnt."""

    def leave_open(self, cameras: frozenset[str]) -> None:
        """Nothing is located anew."""

    def finish(self) -> None:
        """There is nothing to solve."""

    # -- output -----------------------------------------------------------------------------------

    def robot(self, robot: str) -> RobotEstimate | None:
        return self._placings[robot].estimate()

    def cameras(self) -> dict[str, CameraEstimate]:
        if not self._estimates:
            self._estimates = self.fixed.estimates(self._cameras)
        gone = {move.camera for move in self.data.told}
        return {name: each for name, each in self._estimates.items() if name not in gone}

    @property
    def located_count(self) -> int:
        return len(self.fixed.known.poses)
