"""From messages to the network and corrections; pure, and the same live and offline.

`push` takes what came in, `advance` says what to send at a time, `finish` ends the session. The
node feeds it from the bus, `calibrate` from a recording.
"""

from collections import Counter
from uuid import UUID

from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import CameraInfo, Diagnostics, Message, Odometry, Sightings
from trigpoint.contract.nudge import nudges_in

from .association.other_lenses import other_lenses
from .association.other_odometry import otherwise
from .camera_announcements import CameraAnnouncements
from .estimating import estimating
from .estimators.change_reports import CHANGES
from .estimators.residuals import CameraResiduals
from .estimators.results import Results, map_id_of
from .fixed.network import FixedNetwork
from .intake.arrivals import Arrivals
from .intake.clock_doubts import ClockDoubts
from .intake.left_out import Problem
from .intake.lenses import Lenses
from .intake.message_intake import Intake
from .intake.nudges import Nudges
from .live.follower import Follower
from .live.solver_messages import Solved, Solver
from .model.dataset import Conclusions, Event
from .model.inputs import Inputs
from .model.observations import Observation
from .model.odometry import Added
from .model.past import Past
from .model.readings import Readings
from .output import Output
from .robot_announcements import RobotAnnouncements
from .solver.filter import RobotEstimate
from .solver.snapshot import GuidanceWorld


class Pipeline:
    """One map from its first message to its last. Not thread-safe.

    `is_live`: whether anyone listens to its outputs on the way; `solver`: solves, so that no turn
    takes long; None: the estimator that the site file names does, within its turn. `fixed`: the
    network that is held, so that nothing is solved at all. `reports`: the results.
    """

    def __init__(
        self,
        inputs: Inputs,
        *,
        is_live: bool = True,
        solver: Solver | None = None,
        fixed: FixedNetwork | None = None,
    ) -> None:
        self._is_live, self._fixed = is_live, fixed
        inputs = inputs if fixed is None else fixed.inputs(inputs)
        self.site, self.inputs = inputs.site, inputs
        data = self._data = inputs.data_set()
        self._intake = Intake(data)
        self._left_out = self._intake.left_out
        self._estimator, self.reports = estimating(data, solver, fixed, self._intake.forget)
        self._follower = self.reports if isinstance(self.reports, Follower) else None
        self.arrivals = Arrivals(inputs.site, data.tracks)
        self._outputs: list[Output] = []
        self._cameras = CameraAnnouncements(inputs.targets[inputs.site.first_robot])
        self._robots = RobotAnnouncements(inputs.site.fusion.correction_rate)
        self._lenses = Lenses(data, self._intake, inputs.lenses)
        self._stale_ns: dict[str, int] = {}
        self.nudges = Nudges(data, is_fixed=fixed is not None)
        self.clocks = ClockDoubts(inputs.site)
        self.is_clock_set = False  # this machine's, and not followed yet: no corrections meanwhile

    @property
    def map_id(self) -> UUID | None:
        """The map's identity; None before the first robot's first odometry message."""
        held = self._fixed.map_id if self._fixed is not None else None
        return held or map_id_of(self._data)

    @property
    def conclusions(self) -> Conclusions:
        """What was concluded so far."""
        return self._data.conclusions()

    @property
    def past(self) -> Past | None:
        """What this map keeps of a past whose messages it needs no more; None: all are needed."""
        return self._data.past

    @property
    def last_problem(self) -> str:
        """The last message that could not be used; "" where there was none."""
        return self._left_out.last_problem

    @property
    def problems(self) -> dict[str, Problem]:
        """Reason of `left_out`, and of whom -> the last such problem, where it is known."""
        return self._left_out.problems

    @property
    def notes(self) -> list[str]:
        """What a user should know of the session: each event (at most the last hundred), the last
        problem for each reason and sender, what messages lacked, and what is in doubt."""
        is_explained = self.arrivals.odometry.explain_changes
        events = [
            event.text
            for event in self._left_out.events
            if not (is_explained and event.kind in CHANGES)
        ]
        problems = [problem.text for problem in self.problems.values()]
        return [*events, *problems, *self.arrivals.notes]

    @property
    def stale_ns(self) -> dict[str, int]:
        """Robot that sends old odometry now -> by how much that is older than what came before."""
        return dict(self._stale_ns)

    def waits_for(self, robot: str) -> bool:
        """Whether sightings wait for a robot's odometry."""
        return self._intake.waits_for(robot)

    @property
    def is_behind(self) -> bool:
        """Whether more is ready than the last `advance` was allowed to use."""
        tracks = self._data.tracks.items()
        return any(len(track) and self._intake.has_ready(n, track.last_ns) for n, track in tracks)

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
        """What was not used, or not in full, by reason; events too, each by its kind."""
        early = Counter(without_intrinsics=self._lenses.waiting)
        return dict(self._left_out.counts + early)

    @property
    def messages_left_out(self) -> dict[str, int]:
        """What of `left_out` are messages: all but the events."""
        kinds = {event.kind for event in self._left_out.events}
        return {reason: count for reason, count in self.left_out.items() if reason not in kinds}

    # -- input ------------------------------------------------------------------------------------

    def push(self, node: str, message: Message) -> bool:
        """Take a message of a camera or robot; one that is not in the site file is counted.

        Returns whether it may add to the map, which is the same without the messages that do not.
        """
        self.arrivals.add(node, message)
        if isinstance(message, Odometry):
            return self.push_readings(node, Readings.of([message]))
        if isinstance(message, Sightings) and node in self.site.cameras:
            return self._push_sightings(node, message)
        if isinstance(message, CameraInfo) and node in self.site.cameras:
            return self._lenses.announce(node, message)
        if isinstance(message, Diagnostics):
            return self._push_diagnostics(message)
        return self._unknown(node)

    def _unknown(self, node: str, count: int = 1) -> bool:
        text = f"«{node}» is not in the site file; add it there or correct its name"
        self._left_out.add("unknown_sender", text, count=count)
        return False

    def push_readings(self, robot: str, readings: Readings) -> bool:
        """Take odometry of a robot, as `push` does; whether its last may add to the map."""
        if robot not in self.site.robots:
            return self._unknown(robot, len(readings))
        added = self._estimator.add_odometry(robot, readings)
        stale = added.count(Added.STALE)
        self.arrivals.add_odometry(robot, readings, stale=stale)
        self._left_out.add("stale_odometry", count=stale)
        self._left_out.add("odometry_jumps", count=added.count(Added.JUMP))
        if added[-1] == Added.STALE:
            self._stale_ns[robot] = self._data.tracks[robot].last_ns - readings.last_ns
            return False
        self._stale_ns.pop(robot, None)
        if self._is_live and (estimate := self._estimator.robot(robot)) is not None:
            odom_from_base = self._data.tracks[robot].reported
            self._outputs += self._robots.place(
                robot, estimate, odom_from_base, self._estimator.particles
            )
        return True

    def _push_diagnostics(self, message: Diagnostics) -> bool:
        """Take that cameras were moved and clocks are off; whether it may add to the map (what is
        left out for a clock is not stored)."""
        for words in self.clocks.hear(message):
            self._left_out.happened(Event("clock_doubted", words))
        return self.push_moves(message)

    def push_moves(self, message: Diagnostics) -> bool:
        """Take that cameras were moved, and no more; whether it may add to the map."""
        moves = self.nudges.new_in(message)
        for move in moves:
            self._estimator.camera_moved(move)
            self._left_out.happened(Event("camera_nudged", self.nudges.words(move.camera)))
        return bool(moves)

    def _push_sightings(self, camera: str, message: Sightings) -> bool:
        if self._fixed is not None and camera not in self._fixed.states:
            self._left_out.add("not_in_the_map")
            return False
        if why := self._doubt(camera, message):
            self.arrivals.unused[camera] = why
            self._left_out.add("clock_in_doubt")
            return False
        if message.faces:
            self.arrivals.unused.pop(camera, None)
        return self._lenses.hand_on(camera, message)

    def _doubt(self, camera: str, message: Sightings) -> str:
        return self.clocks.why(camera, self._intake.robots_in(message))

    def is_to_be_stored(self, node: str, message: Message) -> bool:
        """Whether a message that comes before the map is whole is to be stored, to be pushed
        later: not what a clock is in doubt for, since nobody will know of that then."""
        if isinstance(message, Diagnostics):
            self.clocks.hear(message)
            return any(nudges_in(message))
        return not (isinstance(message, Sightings) and self._doubt(node, message))

    def resumed(self, *, is_new: bool = False, solution: Solved | None = None) -> bool:
        """Say that what was pushed so far came from a checkpoint: it is all used at once.

        Whoever wrote it may have sent more corrections than it shows. `is_new`: nothing was in it.
        Returns whether corrections go on from its last `solution` until the solver is done.
        """
        goes_on = False
        if not is_new:
            self._use_rest()
            if self._follower is not None and solution is not None:
                goes_on = self._follower.go_on_from(solution)
            self._explain_all()
            self._robots.skip_corrections(self.site.robots)
        self._is_live = True
        self._outputs.clear()
        return goes_on

    # -- work -------------------------------------------------------------------------------------

    def advance(self, now_ns: int | None = None, *, most: int | None = None) -> list[Output]:
        """Use what is ready; return what is to be sent.

        `now_ns`: the time, by which a sighting may be too late for a correction; None: none is
        (offline). `most`: how many observations of a robot are used at most, so that a turn ends
        soon whatever came; `is_behind` says whether more are ready.
        """
        if self._is_live:  # otherwise at the end, when most is known
            self._intake.tell_apart()
        used = self._use_ready(now_ns, most)
        is_quiet = not used
        if self._is_live and is_quiet:
            self._intake.tell_by_place(self._estimator)
        if self._follower is not None:
            self._attend(self._follower)
            is_new = not all(observation.is_repeat for observation in used)
            if now_ns is not None and self._follower.is_to_settle(now_ns, is_new=is_new):
                self._explain_all()
        # Cameras are announced also while none of them sees a robot: no transform grows old.
        stamp_ns = self._data.last_ns
        if self._cameras.is_due(stamp_ns, is_quiet=is_quiet):
            self._take_cameras(stamp_ns, is_urgent=False)
        self._outputs += self._cameras.next(is_quiet=is_quiet)
        outputs, self._outputs = self._outputs, []
        return outputs

    def _use_ready(self, now_ns: int | None, most: int | None) -> list[Observation]:
        used = []
        for robot, track in self._data.tracks.items():
            if len(track):
                for observation in self._intake.ready(robot, track.first_ns, track.last_ns, most):
                    self._use(observation, now_ns)
                    used.append(observation)
        return used

    def _attend(self, follower: Follower) -> None:
        for news in follower.attend():
            if isinstance(news, Event):
                self._left_out.happened(news)
            else:
                self._outputs.append(news)
        if follower.take_new_camera():
            self._take_cameras(self._data.last_ns, is_urgent=True)

    def _use(self, observation: Observation, now_ns: int | None) -> None:
        if self._data.is_past(observation):
            return  # its part in the map is known
        if self._data.tracks[observation.robot].is_in_gap(observation.stamp_ns):
            self._left_out.add("in_odometry_gap")
            return
        late_ns = to_ns(self.site.fusion.late)
        is_late = now_ns is not None and now_ns - observation.stamp_ns > late_ns
        if is_late:
            self._left_out.add(
                "late",
                f"sightings of {observation.camera} come over {self.site.fusion.late:g} s late and "
                "make no corrections; synchronise the clocks, or see what is slow",
                of=observation.camera,
            )
        # Its camera's time offset is left out here; whatever uses the observation accounts for it.
        observation = self._data.moving(observation, observation.stamp_ns)
        if not self._is_live:
            if not observation.is_repeat:
                self._estimator.collect(observation)
            return
        update = self._estimator.add_observation(observation)
        if update.problem:
            self._left_out.add("unusable", update.problem, of=observation.camera)
        if update.contradiction is not None:
            text, camera = update.contradiction, observation.camera
            self._left_out.add("against_the_map", text, of=camera)
        self._left_out.take_from(self._data)
        if update.correction is not None and not is_late:
            self._correct(observation, update.correction)
        if update.located:
            self._take_cameras(observation.stamp_ns, is_urgent=True)

    def _correct(self, observation: Observation, estimate: RobotEstimate) -> None:
        doubt = self.clocks.why(observation.camera, [observation.robot])
        if self.is_clock_set or doubt:
            self._left_out.add("clock_in_doubt")
        elif (map_id := self.map_id) is not None:
            self._outputs += self._robots.correction(map_id, observation, estimate)

    def _take_cameras(self, stamp_ns: int, *, is_urgent: bool) -> None:
        """Announce the cameras as they are estimated now."""
        cameras = self._estimator.cameras() if self._is_live else {}
        self.nudges.locate(cameras)
        if not cameras:
            return
        for name, camera in cameras.items():
            self._intake.learn(name, camera.time_offset_s, camera.time_offset_sigma_s)
        self._cameras.take(stamp_ns, cameras, is_urgent=is_urgent)

    # -- results ----------------------------------------------------------------------------------

    def finish(self) -> list[Output]:
        """Solve everything to the end; the last messages to send.

        Where a solver does that, `reports` say when it has.
        """
        self.advance()
        self._use_rest()
        self._explain_all()
        while self._intake.tell_by_place(self._estimator, is_end=True):
            self._use_rest()
            self._explain_all()
        if not self._is_live:
            unfit = self.arrivals.unfit = self._estimator.unfit_inputs()
            if not self.arrivals.clocks:
                self.arrivals.odometry.otherwise = otherwise(self._data)
            if not (self.arrivals.clocks or self.arrivals.odometry.otherwise or unfit.scales):
                self.arrivals.unfit = unfit.with_lenses(self._data, other_lenses(self._data))
        self._left_out.take_from(self._data)
        self._take_cameras(self._data.last_ns, is_urgent=True)
        self._outputs += self._cameras.rest()
        return self.advance()

    def _explain_all(self) -> None:
        self._estimator.leave_open(self._intake.undecided)
        self._estimator.finish()

    def _use_rest(self) -> None:
        self._intake.tell_apart(is_end=True)
        for robot, track in self._data.tracks.items():
            if len(track):
                for observation in self._intake.rest(robot, track.last_ns):
                    self._use(observation, None)

    def results(self) -> Results:
        """The results as they are known now; see `reports`."""
        results = self.reports.results()
        if self._fixed is None:
            results = replace(results, network=self.arrivals.explained(results.network))
        if self.arrivals.are_elsewhere:
            return results.unlocated(f"position and orientation: {self.arrivals.contradicted}")
        return results

    def guidance_world(self) -> GuidanceWorld | None:
        """A copy of what is known, for guidance; None where that is too little, or not told."""
        return self._estimator.guidance_world()

    def residuals(self) -> dict[str, CameraResiduals]:
        """The residuals of each camera's corners; empty where the estimator does not say."""
        found = {name: self._estimator.residuals(name) for name in self.site.cameras}
        return {name: each for name, each in found.items() if each is not None}
