"""From messages to the network and corrections; pure, and the same live and offline.

`push` takes what came in, `advance` says what to send at a time, `finish` ends the session. The
node feeds it from the bus, `calibrate` from a recording.
"""

from collections import Counter
from dataclasses import dataclass, field
from uuid import UUID

from trigpoint import topics
from trigpoint.clock import to_ns
from trigpoint.config import Site
from trigpoint.correction import CorrectionMark, encode_mark
from trigpoint.errors import OperationError
from trigpoint.geometry import CameraModel
from trigpoint.messages import (
    CameraInfo,
    Message,
    Odometry,
    PoseArray,
    PoseEstimate,
    PoseStamped,
    Sightings,
    Transform,
    Transforms,
)
from trigpoint.network import Network
from trigpoint.target import Target
from trigpoint.topics import Topic

from .announcements import CameraAnnouncements, Output
from .estimators.interface import CameraEstimate, Collecting, Estimator, Inspectable, Live, Sampled
from .estimators.registry import make_estimator
from .estimators.residuals import CameraResiduals
from .estimators.results import Results, map_id_of, results_of
from .intake.message_intake import Intake
from .intake.robot_identity import RobotIdentification
from .intake.standstills import Standstills
from .live.follower import Follower
from .live.solver_messages import Solver, Suggested
from .model.dataset import DataSet, Event, KnownCameras
from .model.observations import Observation
from .model.odometry import Added
from .solver.filter import RobotEstimate
from .solver.snapshot import GuidanceWorld

_TF_PERIOD_NS = to_ns(0.1)
_PARTICLES_PERIOD_NS = to_ns(0.5)
_SEQUENCE_MARGIN = 1000
# Where no sighting has come for so long, what came is worked out to its end.
_QUIET_NS = to_ns(2.0)
# So much more than at the last time is much: all of these times together take no longer than three
# of the last one.
_GROWTH = 1.5
_FIRST_COUNT = 20


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a pipeline is made from. `lenses`: those known beforehand; the others are announced."""

    site: Site
    targets: dict[str, Target]
    lenses: dict[str, CameraModel] = field(default_factory=dict)
    known: KnownCameras = field(default_factory=KnownCameras.none)

    def data_set(self) -> DataSet:
        """What is known beforehand, and nothing else yet."""
        return DataSet(self.site, self.targets, dict(self.lenses), self.known)


class Pipeline:
    """One map from its first message to its last. Not thread-safe.

    `is_live`: whether anyone listens to what it says on the way; `solver`: who solves, so that no
    turn takes long; None: whatever the site file names, at its turn.
    """

    def __init__(
        self, inputs: Inputs, *, is_live: bool = True, solver: Solver | None = None
    ) -> None:
        self._is_live = is_live
        self.site, self._inputs = inputs.site, inputs
        data = self._data = inputs.data_set()
        self._follower = Follower(data, solver) if solver is not None else None
        self._estimator: Live = self._follower or make_estimator(data)
        self._intake = Intake(
            inputs.site,
            inputs.targets,
            shared=RobotIdentification(data),
            standstills=Standstills(data.tracks),
        )
        self.counts: Counter[str] = Counter()
        self._outputs: list[Output] = []
        self._sequence: Counter[str] = Counter()
        self._correction_due_ns: dict[str, int] = {}
        self._sent_ns: dict[str, int] = {}
        self._used_ns = 0
        self._came_ns = 0
        self._is_settled = True
        self._settled_count = 0
        self._announcements = CameraAnnouncements(inputs.targets[inputs.site.first_robot])
        self._early: list[tuple[str, Sightings]] = []
        self._problem = ""
        self._problems: dict[str, str] = {}
        self._stale_ns: dict[str, int] = {}
        self._doubted: frozenset[str] = frozenset()

    @property
    def map_id(self) -> UUID | None:
        """The map's identity; None before the first robot's first odometry message."""
        return map_id_of(self._data)

    @property
    def last_problem(self) -> str:
        """The last message that could not be used, as text; "" where there was none."""
        return self._problem or self._intake.last_problem

    @property
    def problems(self) -> dict[str, str]:
        """Reason of `left_out` -> the last such problem, as text, where it is known."""
        return self._intake.problems | self._problems

    @property
    def stale_ns(self) -> dict[str, int]:
        """Robot -> by how much its last odometry message is older than the one before it, for
        those that send old ones now."""
        return dict(self._stale_ns)

    def waits_for(self, robot: str) -> bool:
        """Whether sightings wait for a robot's odometry."""
        return self._intake.waits_for(robot)

    @property
    def is_behind(self) -> bool:
        """Whether more is ready than the last `advance` was allowed to use."""
        tracks = self._data.tracks.items()
        return any(len(track) and self._intake.has_ready(n, track.last_ns) for n, track in tracks)

    def doubt(self, nodes: frozenset[str]) -> None:
        """Make no corrections of these cameras and robots until told otherwise: their clocks were
        set and are not followed yet."""
        self._doubted = nodes

    @property
    def waiting(self) -> int:
        """How many observations wait for odometry."""
        return self._intake.depth

    @property
    def located_count(self) -> int:
        """How many cameras are located."""
        return self._estimator.located_count

    @property
    def left_out(self) -> dict[str, int]:
        """What was not used, or not in full, by reason."""
        early = Counter(without_intrinsics=len(self._early))
        return dict(self._intake.counts + self.counts + early)

    # -- input ------------------------------------------------------------------------------------

    def push(self, node: str, message: Message) -> bool:
        """Take a message of a camera or robot; one that is not in the site file is counted.

        Returns whether the map may know more by it: without the others it is the same.
        """
        if isinstance(message, Odometry) and node in self.site.robots:
            return self._push_odometry(node, message)
        if isinstance(message, Sightings) and node in self.site.cameras:
            return self._push_sightings(node, message)
        if isinstance(message, CameraInfo) and node in self.site.cameras:
            return self._push_camera_info(node, message)
        self.counts["unknown_sender"] += 1
        return False

    def _push_odometry(self, robot: str, message: Odometry) -> bool:
        added = self._estimator.add_odometry(robot, message.stamp_ns, message.pose)
        if added is Added.STALE:
            self.counts["stale_odometry"] += 1
            self._stale_ns[robot] = self._data.tracks[robot].last_ns - message.stamp_ns
            return False
        self._stale_ns.pop(robot, None)
        if added is Added.JUMP:
            self.counts["odometry_jumps"] += 1
        if self._is_live and (estimate := self._estimator.robot(robot)) is not None:
            self._say_where(robot, estimate, message)
        return True

    def _say_where(self, robot: str, estimate: RobotEstimate, message: Odometry) -> None:
        stamp_ns, pose = message.stamp_ns, estimate.map_from_base
        self._send(
            topics.ROBOT_POSE, robot, PoseEstimate(stamp_ns, "map", pose, estimate.covariance)
        )
        self._say_particles(robot, stamp_ns)
        if not self._is_due(f"tf/{robot}", stamp_ns, _TF_PERIOD_NS):
            return
        odom_from_base = self._data.tracks[robot].odom_from_base[-1]
        transforms = (
            Transform(stamp_ns, "map", f"{robot}/odom", pose @ odom_from_base.inverse()),
            Transform(stamp_ns, f"{robot}/odom", f"{robot}/base", odom_from_base),
        )
        self._send(topics.TF, "", Transforms(transforms))

    def _say_particles(self, robot: str, stamp_ns: int) -> None:
        if not isinstance(self._estimator, Sampled):
            return
        if self._is_due(f"particles/{robot}", stamp_ns, _PARTICLES_PERIOD_NS):
            poses = self._estimator.particles(robot)
            if poses is not None:
                self._send(topics.PARTICLES, robot, PoseArray(stamp_ns, "map", poses))

    def _push_camera_info(self, camera: str, message: CameraInfo) -> bool:
        if camera in self._inputs.lenses:
            return False  # a file says what it is
        if camera in self._data.lenses:
            if self._data.lenses[camera] != message.camera:
                self.counts["changed_intrinsics"] += 1
                self._problem = self._problems["changed_intrinsics"] = (
                    f"camera {camera} announces other intrinsics than this map began with, which "
                    "are not taken over; start a new map with fusion/reset"
                )
            return False
        self._data.lenses[camera] = message.camera
        early, self._early = self._early, []
        for node, sightings in early:
            self._push_sightings(node, sightings)
        return True

    def _push_sightings(self, camera: str, message: Sightings) -> bool:
        config = self.site.cameras[camera]
        if camera not in self._data.lenses and config.estimates_intrinsics:
            self._data.lenses[camera] = config.nominal()
        lens = self._data.lenses.get(camera)
        if lens is not None:
            return self._intake.add(camera, message, lens)
        if len(self._early) < 4096:
            self._early.append((camera, message))
            return True
        self.counts["without_intrinsics"] += 1
        return False

    def resumed(self, *, is_new: bool = False) -> None:
        """Say that what was pushed so far came from a checkpoint: it is worked out at once.

        Whoever wrote it may have sent more corrections than it shows, and a robot refuses a
        sequence number that it has seen; so the next ones are well beyond. `is_new`: there was
        nothing in it.
        """
        self._is_live = True
        if is_new:
            return
        if isinstance(self._estimator, Collecting):
            self._estimator.finish()
        for robot in self.site.robots:
            self._sequence[robot] += _SEQUENCE_MARGIN
        self._outputs.clear()

    # -- work -------------------------------------------------------------------------------------

    def advance(self, now_ns: int | None = None, *, most: int | None = None) -> list[Output]:
        """Use what is ready; return what is to be sent.

        `now_ns`: the time, for what is too late to make a correction; None: nothing is (offline).
        `most`: how many observations of a robot are used at most, so that a turn ends soon whatever
        came; `is_behind` says whether more are ready.
        """
        is_quiet = has_nothing_new = True
        for robot, track in self._data.tracks.items():
            if not len(track):
                continue
            for observation in self._intake.ready(robot, track.first_ns, track.last_ns, most):
                self._use(observation, now_ns)
                is_quiet = False
                has_nothing_new &= observation.is_repeat
        if self._is_live and is_quiet:
            self._intake.tell_by_place(self._estimator)
        if self._follower is not None:
            self._attend(self._follower)
            self._settle(self._follower, now_ns, is_quiet=has_nothing_new)
        # Live, cameras are said too while none of them sees a robot: no transform grows old.
        used_ns = 0 if self._is_live else self._used_ns
        stamp_ns = used_ns or self._data.last_ns
        if self._announcements.is_due(stamp_ns, is_quiet=is_quiet):
            self._take_cameras(stamp_ns, is_urgent=False)
        self._outputs += self._announcements.next(is_quiet=is_quiet)
        outputs, self._outputs = self._outputs, []
        return outputs

    def _settle(self, follower: Follower, now_ns: int | None, *, is_quiet: bool) -> None:
        """Have everything solved to the end whenever much has come in since the last time, and once
        nothing new has come in for a while."""
        if now_ns is None:
            return
        if not is_quiet:
            self._came_ns, self._is_settled = now_ns, False
        if self._is_settled or not follower.is_idle:
            return
        is_much = follower.count > _GROWTH * self._settled_count + _FIRST_COUNT
        if is_much or now_ns - self._came_ns > _QUIET_NS:
            self._is_settled, self._settled_count = is_quiet, follower.count
            follower.finish()

    def _attend(self, follower: Follower) -> None:
        for news in follower.attend():
            if isinstance(news, Suggested):
                message = PoseStamped(news.stamp_ns, "map", news.map_from_base)
                self._send(topics.SUGGESTION, news.robot, message)
            else:
                self._note(news.event)
        if follower.has_new_camera:
            follower.has_new_camera = False
            self._take_cameras(self._data.last_ns, is_urgent=True)

    def _use(self, observation: Observation, now_ns: int | None) -> None:
        if self._data.tracks[observation.robot].is_in_gap(observation.stamp_ns):
            self.counts["in_odometry_gap"] += 1
            return
        late_ns = to_ns(self.site.fusion.late)
        is_late = now_ns is not None and now_ns - observation.stamp_ns > late_ns
        if is_late:
            self.counts["late"] += 1
            self._problem = self._problems["late"] = (
                f"sightings of {observation.camera} come over {self.site.fusion.late:g} s late and "
                "make no corrections; synchronise the clocks, or see what is slow"
            )
        # Its camera's time offset is left out; what uses it puts that right.
        observation = self._data.moving(observation, observation.stamp_ns)
        if not self._is_live and isinstance(self._estimator, Collecting):
            if not observation.is_repeat:
                self._estimator.collect(observation)
            return
        self._used_ns = observation.stamp_ns
        update = self._estimator.add_observation(observation)
        if update.problem:
            self.counts["unusable"] += 1
            self._problem = self._problems["unusable"] = update.problem
        self._note_events()
        if update.correction is not None and not is_late:
            if self._doubted & {observation.robot, observation.camera}:
                self.counts["clock_in_doubt"] += 1
            else:
                self._correct(observation.robot, update.correction)
        if update.located:
            self._take_cameras(observation.stamp_ns, is_urgent=True)

    def _note_events(self) -> None:
        """Count and report the changes of the site."""
        events, self._data.events = self._data.events, []
        for event in events:
            self._note(event)

    def _note(self, event: Event) -> None:
        self.counts[event.kind] += 1
        self._problem = event.text

    def _correct(self, robot: str, estimate: RobotEstimate) -> None:
        map_id = self.map_id
        if map_id is None or not self._is_correction_due(robot, estimate.stamp_ns):
            return
        self._sequence[robot] += 1
        self._send(
            topics.CORRECTION,
            robot,
            PoseEstimate(estimate.stamp_ns, "map", estimate.map_from_base, estimate.covariance),
            encode_mark(CorrectionMark(map_id, self._sequence[robot])),
        )

    def _is_correction_due(self, robot: str, stamp_ns: int) -> bool:
        """Whether the rate allows one now; half a period early is forgiven but not forgotten, so
        that pictures at just that rate are not halved by their jitter."""
        period_ns = to_ns(1 / self.site.fusion.correction_rate)
        due_ns = max(self._correction_due_ns.get(robot, stamp_ns), stamp_ns - period_ns // 2)
        if stamp_ns < due_ns - period_ns // 2:
            return False
        self._correction_due_ns[robot] = due_ns + period_ns
        return True

    def _take_cameras(self, stamp_ns: int, *, is_urgent: bool) -> None:
        """Announce the cameras as they are estimated now."""
        cameras = self._estimator.cameras() if self._is_live else {}
        if not cameras:
            return
        for name, camera in cameras.items():
            self._intake.learn(name, camera.time_offset_s, camera.time_offset_sigma_s)
        self._announcements.take(stamp_ns, cameras, is_urgent=is_urgent)

    def _is_due(self, what: str, stamp_ns: int, period_ns: int) -> bool:
        last_ns = self._sent_ns.get(what)
        if last_ns is not None and 0 <= stamp_ns - last_ns < period_ns:
            return False
        self._sent_ns[what] = stamp_ns
        return True

    def _send(self, topic: Topic, node: str, message: Message, attachment: bytes = b"") -> None:
        self._outputs.append(Output(topic, node, message, attachment))

    # -- results ----------------------------------------------------------------------------------

    def finish(self) -> list[Output]:
        """Solve everything to the end from all that came in; the last messages to send.

        Where a solver does that, `is_answered` says when it has.
        """
        self.advance()
        self._use_rest()
        self._estimator.finish()
        while self._intake.tell_by_place(self._estimator, is_end=True):
            self._use_rest()
            self._estimator.finish()
        self._note_events()
        last_ns = max((t.last_ns for t in self._data.tracks.values() if len(t)), default=0)
        self._take_cameras(last_ns, is_urgent=True)
        self._outputs += self._announcements.rest()
        return self.advance()

    def _use_rest(self) -> None:
        for robot, track in self._data.tracks.items():
            if len(track):
                for observation in self._intake.rest(robot, track.last_ns):
                    self._use(observation, None)

    def ask(self) -> None:
        """Have a solver report what is known now; `is_answered` says when it has."""
        if self._follower is not None:
            self._follower.ask()

    @property
    def is_answered(self) -> bool:
        """Whether a solver has reported on everything that it was asked for."""
        return self._follower is None or self._follower.is_answered

    @property
    def is_final(self) -> bool:
        """Whether the results are those of everything, solved to the end."""
        follower = self._follower
        return follower is None or (follower.reported is not None and follower.reported.is_final)

    def results(self) -> Results:
        """The network with covariance and trajectories as it is known now, or to a solver when it
        last reported; raise OperationError where it has not yet."""
        if self._follower is None:
            assert isinstance(self._estimator, Estimator)
            return results_of(self._data, self._estimator, self.map_id)
        if self._follower.reported is None:
            raise OperationError("nothing is worked out yet; ask again in a moment")
        return self._follower.reported.results

    @property
    def has_results(self) -> bool:
        """Whether there are any."""
        return self._follower is None or self._follower.reported is not None

    def network(self) -> Network:
        """The network as it is known now."""
        return self.results().network

    def cameras(self) -> dict[str, CameraEstimate]:
        """The located cameras as they are known now."""
        return self._estimator.cameras()

    def robot(self, robot: str) -> RobotEstimate | None:
        """The robot at its last odometry message."""
        return self._estimator.robot(robot)

    def guidance_world(self) -> GuidanceWorld | None:
        """A copy of what is known for guidance to work on; None where there is too little yet, or
        where the estimator has none."""
        estimator = self._estimator
        return estimator.guidance_world() if isinstance(estimator, Inspectable) else None

    def residuals(self) -> dict[str, CameraResiduals]:
        """What is left over of each camera's corners; empty where the estimator does not say."""
        estimator = self._estimator
        if not isinstance(estimator, Inspectable):
            return {}
        return {name: estimator.residuals(name) for name in self.site.cameras}
