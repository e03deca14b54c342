"""The current filter and its last steps.

A late sighting is inserted at its place in time, and the later ones are applied again. Filters are
immutable and share what a step does not change, so that going back costs nothing.
"""

from collections.abc import Iterable, Sequence

from msgspec import Struct

from trigpoint.fusion.estimators.interface import CameraEstimate
from trigpoint.fusion.estimators.marginals import camera_estimates
from trigpoint.fusion.estimators.robot_alignment import align_before
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Entry
from trigpoint.fusion.model.gates import is_noise
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.solver.filter import Filter, RobotEstimate, carried_on, is_placed
from trigpoint.geometry.rotation import Array

# Corner errors are correlated where the lens is known less well than stated: by this factor their
# variance may be larger in one place of the picture than in all of it. Beyond that the sighting,
# the robot or the camera contradicts the rest.
EXCESS = 3.0
_MOST_STEPS = 64


class _Step(Struct, frozen=True):
    """A used entry, and the filter before it."""

    time_ns: int
    before: Filter
    entry: Entry


class CurrentFilter:
    """The filter at the current moment, with its history. Not thread-safe.

    `known`: None before the first odometry message; `shares`: (camera, robot) -> stamp and share of
    the last observation.
    """

    def __init__(self, data: DataSet) -> None:
        self.data = data
        self.known: Filter | None = None
        self._steps: list[_Step] = []
        self._told: frozenset[CameraMove] = frozenset()
        self.shares: dict[tuple[str, str], tuple[int, float]] = {}
        # By robot: the filter, the robot's estimate carried on from it by odometry, and, where
        # scales are estimated, the filter carried on as far.
        self._carried: dict[str, tuple[Filter, RobotEstimate, Filter]] = {}

    def begin(self, robot: str) -> None:
        """Note a robot's odometry: the first robot's first message is the map's origin."""
        if self.known is None and (robot == self.data.anchored_robot or self.data.known.poses):
            self.known = Filter.at_origin(self.data)

    def settle(self) -> None:
        """Do ahead of time, while no robot waits, the work that one of the next sightings would
        have to wait for."""
        known = self.known
        if known is not None and known.is_worth_settling:
            self.known = known.settled()

    def go_on_from(
        self,
        known: Filter | None,
        entries: Iterable[Entry] = (),
        *,
        told: Sequence[CameraMove] = (),
    ) -> None:
        """Replace the filter; `entries`: those whose shares are continued, in order; `told`: the
        moves of cameras that it was told of."""
        self.known, self._told = known, frozenset(told)
        self._steps.clear()
        for entry in entries:
            self._note_share(entry)

    def forget_before(self, robot: str, stamp_ns: int) -> None:
        """Carry a robot on to a moment by its odometry, which is not needed before it any more; a
        sighting that comes late finds no step before the moment."""
        if self.known is None or not self.known.has_robot(robot):
            return
        self._steps = [s for s in self._steps if s.before.stamps_ns[robot] >= stamp_ns]
        if self.known.stamps_ns[robot] < stamp_ns:
            self.known = self.known.carried(self.data, robot, stamp_ns)

    def spread(self, covariances: dict[str, Array]) -> None:
        """Add covariances (6, 6) to those of cameras' poses; a sighting that comes late finds no
        step before that."""
        if self.known is not None:
            self.known = self.known.spread(covariances)
            self._steps.clear()

    # -- one observation --------------------------------------------------------------------------

    def use(self, entry: Entry) -> RobotEstimate | None:
        """Update by an observation; None where it was rejected or came too late, or its camera or
        robot is not located. Where it fails, everything is as before."""
        if not self._is_located(entry.observation):
            return None
        before = self.known, list(self._steps), dict(self.shares)
        try:
            time_ns = self._moment_of(entry)
            later = self._rewind(entry.observation.robot, time_ns)
            correction = self._apply(entry, time_ns)
            for step in later:
                self._apply(step.entry, step.time_ns)
        except BaseException:
            self.known, self._steps, self.shares = before
            raise
        return correction

    def tried(self, entry: Entry) -> RobotEstimate | None:
        """The correction that an observation makes; nothing is learnt from it. None where it
        contradicts what is known, or came too late."""
        if not self._is_located(entry.observation):
            return None
        known, steps, shares = self.known, list(self._steps), dict(self.shares)
        try:
            return self._apply(entry, self._moment_of(entry))
        finally:
            self.known, self._steps, self.shares = known, steps, shares

    def _is_located(self, observation: Observation) -> bool:
        known = self.known
        if known is None or not known.has_robot(observation.robot):
            return False
        if self.data.is_outdated(observation, self._told):
            return False
        return known.has_camera(observation.camera)

    def _moment_of(self, entry: Entry) -> int:
        """The true time of an entry; sets its observation's twist to the robot's at that time."""
        assert self.known is not None
        camera = self.known.state.cameras[entry.observation.camera]
        time_ns = int(self.data.true_times_ns(camera, entry.observation.stamp_ns))
        scales = self.known.scales(entry.observation.robot)
        entry.observation = self.data.moving(entry.observation, time_ns, scales)
        return time_ns

    def _rewind(self, robot: str, time_ns: int) -> list[_Step]:
        """Go back to before all later steps of this robot; return the steps to apply again."""
        assert self.known is not None
        if self.known.stamps_ns[robot] <= time_ns:
            return []
        for row in range(len(self._steps) - 1, -1, -1):
            before = self._steps[row].before
            if before.stamps_ns[robot] <= time_ns:
                self.known = before
                later = self._steps[row:]
                del self._steps[row:]
                return later
        return []  # older than all steps; the next solution uses it

    def _apply(self, entry: Entry, time_ns: int) -> RobotEstimate | None:
        """Update the filter by an observation; None where it was rejected or came too late."""
        current = self.known
        assert current is not None
        robot = entry.observation.robot
        if time_ns < current.stamps_ns[robot]:
            return None  # older than the steps: the next solution uses it
        predicted = current.robot(self.data, robot, time_ns)
        aligned = align_before(self.data, current, entry.observation, predicted)
        if aligned is None:
            entry.observation = entry.observation.judged(Verdict.REJECTED)
            entry.map_from_base = predicted.map_from_base
            return None
        observation, pose = aligned.read(entry.observation), aligned.map_from_base
        moved = current.advanced(self.data, robot, time_ns, pose)
        entry.share = self._share_before(observation)
        after, surprise = moved.updated(self.data, observation, share=entry.share)
        entry.map_from_base = pose
        if not is_noise(surprise, 2 * observation.corner_count, excess=EXCESS):
            entry.observation = observation.judged(Verdict.REJECTED)
            return None
        entry.observation = observation.judged(Verdict.ACCEPTED)
        self._steps.append(_Step(time_ns, current, entry))
        del self._steps[:-_MOST_STEPS]
        self._note_share(entry)
        self.known = after
        estimate = after.robot(self.data, robot)
        return estimate if is_placed(estimate.covariance) else None

    def _share_before(self, observation: Observation) -> float:
        """The share of the same camera's last observation, while the robot stands as it did."""
        pair = observation.camera, observation.robot
        if pair not in self.shares:
            return 1.0
        stamp_ns, share = self.shares[pair]
        track = self.data.tracks[observation.robot]
        is_still = track.is_still(*sorted([stamp_ns, observation.stamp_ns]))
        return share if is_still else 1.0

    def _note_share(self, entry: Entry) -> None:
        observation = entry.observation
        self.shares[observation.camera, observation.robot] = (observation.stamp_ns, entry.share)

    # -- where a robot is -------------------------------------------------------------------------

    def robot(self, robot: str) -> RobotEstimate | None:
        """The robot at its last odometry message; None while it is not located in the map."""
        if self.known is None or not self.known.has_robot(robot):
            return None
        carried = self._carried.get(robot)
        if carried is not None and carried[0] is self.known:
            _, estimate, ahead = carried
        else:
            estimate, ahead = self.known.robot(self.data, robot), self.known
        last_ns = self.data.tracks[robot].last_ns
        if robot in self.known.layout.scales:
            ahead = ahead.carried(self.data, robot, last_ns)
            estimate = ahead.robot(self.data, robot)
        else:
            estimate = carried_on(self.data, robot, estimate, last_ns, ahead.scales(robot))
        self._carried[robot] = (self.known, estimate, ahead)
        return estimate

    def cameras(self) -> dict[str, CameraEstimate]:
        """The located cameras."""
        if self.known is None:
            return {}
        last_ns = max(self.known.stamps_ns.values(), default=self.data.epoch_ns)
        since_epoch_s = float(self.data.since_epoch_s(last_ns))
        gone = {told.camera for told in self.data.told if told not in self._told}
        names = [name for name in self.data.site.cameras if name not in gone]
        return camera_estimates(self.known, names, since_epoch_s=since_epoch_s)
