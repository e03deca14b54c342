"""All input: the robots' odometry and the observations, and the verdicts on them."""

from collections.abc import Container, Iterable

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.base.clock import NANOSECONDS
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise, Site
from trigpoint.site.target import Target

from .jitter import Jitter
from .known_cameras import KnownCameras
from .observations import Observation, Verdict, base_from_faces, moving
from .odometry import SLIP, OdometryTrack
from .past import ODOMETRY_BEFORE_NS, Past, PastCamera
from .problem import CameraState, RobotState, State, true_times_ns

_MOST_TOLD = 64
"""So many told moves of a camera are kept."""


class Entry(Struct):
    """An observation and the robot's estimated pose at it (None: not known).

    `share`: its weight, below 1 where it repeats the errors of others (see `standstill_noise`).
    """

    observation: Observation
    map_from_base: Pose | None = None
    share: float = 1.0


class Move(Struct):
    """The move of a camera. `name`: the name of its earlier pose among the cameras; `since_ns`: the
    first sighting from its new place; `until_ns`: the last one from the old."""

    camera: str
    name: str
    since_ns: int
    until_ns: int
    map_from_camera: Pose | None = None
    covariance: Array | None = None


class Lift(Struct, frozen=True):
    """A robot was put down elsewhere between two moments, which its odometry does not show."""

    robot: str
    after_ns: int
    before_ns: int


class CameraMove(Struct, frozen=True):
    """A camera was moved between its last sighting from the old place and the first from the new
    one."""

    camera: str
    until_ns: int
    since_ns: int


SiteChange = Lift | CameraMove


class Event(Struct, frozen=True):
    """A change of the site, as text; events are counted by `kind`."""

    kind: str
    text: str


class Conclusions(Struct, frozen=True):
    """What was concluded from a session's sightings: the cameras that were moved; by robot, the
    odometry steps in which its track is broken, its noise (stated parts, slip, skid) and its
    jitter; by camera, the factor on the stated sigma of its corners; and the moves that were `told`
    by then."""

    moves: tuple[Move, ...]
    jumps: dict[str, tuple[tuple[int, int], ...]]
    noise: dict[str, tuple[OdometryNoise, float, float]]
    jitter: dict[str, Jitter]
    corner_scale: dict[str, float]
    told: tuple[CameraMove, ...] = ()


class DataSet(Struct):
    """The estimator's inputs so far. Not thread-safe.

    `lenses`: each camera's lens, known or the initial value of its estimation; `moves`: in order of
    time; `events`: not reported yet; `changes`: the lifts and moves that sightings show, each as
    the alternatives that explain them equally well; `jitter`: of robots whose pose in a picture
    deviates from their odometry's plane; `odometry_scale`: by robot the factors on the stated
    sigmas of its odometry and on its slip; `told`: moves that cameras noticed themselves, which
    sightings need not show; `corner_scale`: by camera the factor on the stated sigma
    of its corners; `past`: what came before all that is here, None where that is everything.
    """

    site: Site
    targets: dict[str, Target]
    lenses: dict[str, CameraModel]
    known: KnownCameras
    tracks: dict[str, OdometryTrack] = field(default_factory=dict)
    entries: list[Entry] = field(default_factory=list)
    moves: list[Move] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    changes: list[tuple[SiteChange, ...]] = field(default_factory=list)
    jitter: dict[str, Jitter] = field(default_factory=dict)
    odometry_scale: dict[str, tuple[float, float]] = field(default_factory=dict)
    corner_scale: dict[str, float] = field(default_factory=dict)
    told: list[CameraMove] = field(default_factory=list)
    past: Past | None = None
    _by_camera: dict[str, list[Entry]] = field(default_factory=dict)
    _sorted: int = 0

    def __post_init__(self) -> None:
        self._by_camera, self._sorted = {}, 0  # of these entries, also in a copy with others
        for name, robot in self.site.robots.items():
            if name not in self.tracks:
                fastest, planar = (robot.max_speed, robot.max_turn), robot.planar
                self.tracks[name] = OdometryTrack(robot.odometry, planar=planar, fastest=fastest)

    @property
    def has_alike_robots(self) -> bool:
        """Whether several robots carry one target."""
        targets = list(self.targets.values())
        return any(target in targets[:order] for order, target in enumerate(targets))

    @property
    def anchored_robot(self) -> str | None:
        """The robot whose first odometry pose fixes the map; None where known cameras do."""
        return None if self.known.poses else self.site.first_robot

    @property
    def known_at_start(self) -> KnownCameras:
        """The known cameras as uncertain as they are when the odometry begins."""
        return self.known.at(self.begin_ns)

    @property
    def has_odometry(self) -> bool:
        return any(len(track) for track in self.tracks.values())

    @property
    def last_ns(self) -> int:
        """The stamp of the newest odometry message of any robot; 0 before the first."""
        return max((track.last_ns for track in self.tracks.values() if len(track)), default=0)

    @property
    def epoch_ns(self) -> int:
        """The reference time of the clocks' drift: where the map's odometry began."""
        return self.begin_ns if self.past is None else self.past.epoch_ns

    @property
    def begin_ns(self) -> int:
        """The stamp of the first robot's first odometry message here; 0 before any."""
        tracks = [self.tracks[self.site.first_robot], *self.tracks.values()]
        return next((track.first_ns for track in tracks if len(track)), 0)

    @property
    def settled_ns(self) -> int:
        """What happened to cameras before then is settled."""
        return self.begin_ns if self.past is None else self.past.end_ns

    @property
    def map_since_ns(self) -> int | None:
        """The stamp of the map's first odometry message of the first robot; None before it."""
        if self.past is not None and self.past.map_since_ns is not None:
            return self.past.map_since_ns
        track = self.tracks[self.site.first_robot]
        return track.first_ns if len(track) else None

    def since_epoch_s(self, stamps_ns: np.ndarray | int) -> Array:
        """Stamps in seconds since the epoch, of the same shape."""
        return np.asarray(stamps_ns - self.epoch_ns) / NANOSECONDS

    def true_times_ns(self, camera: CameraState, stamps_ns: np.ndarray | int) -> np.ndarray:
        """When pictures with these stamps (…) of a camera were taken, by its clock."""
        return true_times_ns(stamps_ns, camera.offset_s(self.since_epoch_s(stamps_ns)))

    @property
    def camera_names(self) -> list[str]:
        """Every camera and every earlier place of one."""
        return [*(move.name for move in self.moves), *self.site.cameras]

    def site_camera(self, name: str) -> str:
        """The site's camera to which the name of a place belongs."""
        return next((move.camera for move in self.moves if move.name == name), name)

    def concluded(self, observation: Observation) -> Observation:
        """A raw observation under the conclusions so far: assigned to the place where its camera
        was then, with the sigma of that camera's corners scaled."""
        observation = observation.scattering(self.corner_scale.get(observation.camera, 1.0))
        for move in self.moves:
            if move.camera == observation.camera and observation.stamp_ns < move.since_ns:
                return replace(observation, camera=move.name)
        return observation

    def tell(self, move: CameraMove) -> bool:
        """Note that a camera was moved, as it noticed itself; whether that is new. One that begins
        as another began replaces it: the camera was still being moved."""
        if move in self.told:
            return False
        self.told = [
            told
            for told in self.told
            if (told.camera, told.until_ns) != (move.camera, move.until_ns)
        ]
        mine = [told for told in self.told if told.camera == move.camera]
        if len(mine) >= _MOST_TOLD:
            self.told.remove(mine[0])
        self.told.append(move)
        self.told.sort(key=lambda told: told.until_ns)
        return True

    def is_outdated(self, observation: Observation, known: Container[CameraMove]) -> bool:
        """Whether an observation may be from another place of its camera than the one that is
        known: after a move that was told, or while the camera was moved. `known`: the moves told
        before its place was found."""
        stamp_ns = observation.stamp_ns
        return any(
            told.until_ns < stamp_ns and (told not in known or stamp_ns < told.since_ns)
            for told in self.told
            if told.camera == self.site_camera(observation.camera)
        )

    def places_of(self, camera: str) -> list[str]:
        """The names of a camera's places in order of time, its own name last."""
        return [*(move.name for move in self.moves if move.camera == camera), camera]

    def note(self, kind: str, text: str) -> None:
        """Add an event to report."""
        self.events.append(Event(kind, text))

    def of_camera(self, camera: str) -> list[Entry]:
        """A camera's entries, in the order in which they came."""
        for entry in self.entries[self._sorted :]:
            self._by_camera.setdefault(entry.observation.camera, []).append(entry)
        self._sorted = len(self.entries)
        return self._by_camera.get(camera, [])

    def past_of(self, camera: str) -> PastCamera:
        """What is kept of a camera's past."""
        return PastCamera() if self.past is None else self.past.cameras.get(camera, PastCamera())

    def is_past(self, observation: Observation) -> bool:
        """Whether a sighting is part of the past, which says what it told."""
        past = self.past
        return past is not None and past.is_over(observation.robot, observation.stamp_ns)

    def forget(self, past: Past) -> None:
        """Go on from a past: drop what is part of it, and what was concluded from that."""
        self.past, self.known = past, past.known
        self._take_entries([each for each in self.entries if not self.is_past(each.observation)])
        for robot, since_ns in past.since_ns.items():
            self.tracks[robot].forget_before(since_ns - ODOMETRY_BEFORE_NS)
        self.moves.clear()
        self.changes.clear()
        self.told = [told for told in self.told if told.since_ns >= past.end_ns]

    def forget_from(self, index: int) -> None:
        """Drop the entries from this one on."""
        self._take_entries(self.entries[:index])

    def draft(self) -> "DataSet":
        """A working copy of the input without entries and conclusions; nothing here changes until
        it is taken over."""
        poses = {self.site_camera(name): pose for name, pose in self.known.poses.items()}
        tracks = {
            name: self.tracks[name].mended().noisy(robot.odometry, slip=SLIP, skid=0.0)
            for name, robot in self.site.robots.items()
        }
        known, lenses = replace(self.known_at_start, poses=poses), dict(self.lenses)
        return DataSet(
            self.site, self.targets, lenses, known, tracks, told=list(self.told), past=self.past
        )

    def take_over(self, draft: "DataSet") -> None:
        """Replace the entries and the conclusions by a draft's."""
        self.lenses.update(draft.lenses)
        self.known, self.changes = draft.known, draft.changes
        self.odometry_scale = draft.odometry_scale
        self.conclude(draft.conclusions())
        self._take_entries(draft.entries)

    def conclusions(self) -> "Conclusions":
        """All that was concluded so far."""
        return Conclusions(
            tuple(self.moves),
            {name: track.jump_steps for name, track in self.tracks.items()},
            {name: (track.noise, track.slip, track.skid) for name, track in self.tracks.items()},
            dict(self.jitter),
            dict(self.corner_scale),
            tuple(self.told),
        )

    def conclude(self, known: "Conclusions") -> None:
        """Adopt what was concluded from the same messages."""
        self.moves, self.jitter = list(known.moves), dict(known.jitter)
        self.corner_scale = dict(known.corner_scale)
        for name, steps in known.jumps.items():
            track = self.tracks[name]
            track.jump_in(steps)
            track.noise, track.slip, track.skid = known.noise[name]

    def _take_entries(self, entries: list[Entry]) -> None:
        self.entries = entries
        self._by_camera.clear()
        self._sorted = 0

    def moving(
        self, observation: Observation, time_ns: int, scales: Array | None = None
    ) -> Observation:
        """An observation with its robot's twist at the true time at which it was seen."""
        if not observation.is_swept:
            return observation
        track = self.tracks[observation.robot]
        scales = np.zeros(2) if scales is None else scales
        return moving([observation], track, np.array([time_ns]), scales)[0]

    def usable(self, cameras: Iterable[str]) -> list[int]:
        """Indices of the accepted observations of these cameras whose robot's pose is known."""
        wanted = set(cameras)
        return [
            index
            for index, entry in enumerate(self.entries)
            if entry.observation.camera in wanted
            and entry.observation.verdict is Verdict.ACCEPTED
            and entry.map_from_base is not None
        ]

    def first_state(self) -> State:
        """The state before any sighting: what is known beforehand, and every robot without
        nodes."""
        known = self.known
        cameras = {name: self._known_camera(name, pose) for name, pose in known.poses.items()}
        robots = {
            name: RobotState(
                Pose.stack([]),
                known.values.get(("scales", name), np.zeros(2)),
                known.faces.get(name, base_from_faces(self.targets[name])),
            )
            for name in self.site.robots
        }
        return State(cameras, robots)

    def _known_camera(self, name: str, pose: Pose) -> CameraState:
        camera, values = self.site_camera(name), self.known.values
        lens = self.lenses[name]
        if ("lens", camera) in values:
            lens = lens.with_parameters(values["lens", camera])
        return CameraState(pose, lens, *values.get(("clock", camera), np.zeros(2)).tolist())
