"""A drawn session: who saw what and when, the messages of it, and the truth."""

from collections.abc import Iterator
from operator import itemgetter

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import CameraInfo, Message, Odometry, Sightings
from trigpoint.geometry import Pose
from trigpoint.tools.simulation.session import EPOCH_NS

from .carried import mounted, target_of
from .recipe import Recipe, drawn
from .ride import STEP_S, STEPS_A_MESSAGE, Ride
from .room import Camera, cameras_of
from .route import ride_of
from .views import Carrier, Picture, pictures_of

MOUNT_M, MOUNT_RAD = 0.003, float(np.radians(0.5))
_LATE_S, _TWICE_S = (0.5, 3.0), 0.05
_GAP_S = (0.5, 2.5)


class Composition(Struct, frozen=True, eq=False):
    """A session. `carriers`: the robots; `pictures`: with a sighting, by camera in time order;
    `gaps_s`: of each robot, when its odometry was lost."""

    recipe: Recipe
    cameras: list[Camera]
    carriers: list[Carrier]
    pictures: dict[str, list[Picture]]
    gaps_s: dict[str, list[tuple[float, float]]]

    @property
    def name(self) -> str:
        """Of its folder: kind and seed."""
        return f"{self.recipe.kind}-{self.recipe.seed}"

    @property
    def lasts_s(self) -> float:
        """Its length."""
        return self.carriers[0].ride.end_s

    def last_places(self) -> dict[str, Pose]:
        """map_from_camera where each camera hung when it last had a sighting that is not wrong as
        a whole; a camera that never had one is not there."""
        return {
            camera.name: camera.pose_at(good[-1].t_s)
            for camera in self.cameras
            if (good := self._good(camera))
        }

    def pictures_at_last(self) -> dict[str, int]:
        """How many pictures show each camera's last place by a sighting that is not wrong."""
        counts = {}
        for camera in self.cameras:
            good = self._good(camera)
            since_s = [move.at_s for move in camera.moves if good and move.at_s <= good[-1].t_s]
            counts[camera.name] = sum(p.t_s >= max(since_s, default=0.0) for p in good)
        return counts

    def _good(self, camera: Camera) -> list[Picture]:
        return [picture for picture in self.pictures[camera.name] if picture.is_good]

    def odometry(self, robot: str) -> tuple[np.ndarray, Pose]:
        """Stamps (n,) after the start, nanoseconds, and reported poses of a robot's messages."""
        ride = next(c.ride for c in self.carriers if c.name == robot)
        index = np.arange(0, len(ride.map_from_base), STEPS_A_MESSAGE)
        times_s = index * STEP_S
        lost = np.zeros(len(index), dtype=bool)
        for start_s, end_s in self.gaps_s[robot]:
            lost |= (times_s > start_s) & (times_s < end_s)
        index = index[~lost]
        return index * to_ns(STEP_S), ride.odom_from_base[index]

    def messages(self) -> list[tuple[int, str, Message]]:
        """(when it was received, after the start; camera or robot; message), in that order."""
        return sorted(self._sent(), key=itemgetter(0))

    def _sent(self) -> Iterator[tuple[int, str, Message]]:
        for camera in self.cameras:
            yield 0, camera.name, CameraInfo(EPOCH_NS, f"{camera.name}/optical", camera.told)
        for carrier in self.carriers:
            frames = (f"{carrier.name}/odom", f"{carrier.name}/base")
            stamps_ns, poses = self.odometry(carrier.name)
            for index, stamp_ns in enumerate(stamps_ns.tolist()):
                message = Odometry(EPOCH_NS + stamp_ns, *frames, poses[index])
                yield stamp_ns, carrier.name, message
        for camera in self.cameras:
            for picture in self.pictures[camera.name]:
                yield from self._delivered(camera, picture)

    def _delivered(self, camera: Camera, picture: Picture) -> Iterator[tuple[int, str, Message]]:
        stamp_ns = picture.stamp_ns(camera.time_offset_s)
        size = (camera.model.width, camera.model.height)
        faces = tuple(face.sighting for face in picture.faces)
        message = Sightings(EPOCH_NS + stamp_ns, f"{camera.name}/optical", *size, faces)
        random = self.recipe.random("delivery", camera.name, stamp_ns)
        chances, late_s = random.random(2), random.uniform(*_LATE_S)
        # A picture comes after the odometry that is no younger.
        at_ns = to_ns(picture.t_s) + 1
        if chances[0] < self.recipe.late_share:
            at_ns += to_ns(late_s)
        yield at_ns, camera.name, message
        if chances[1] < self.recipe.twice_share:
            yield at_ns + to_ns(_TWICE_S), camera.name, message


def composed_session(kind: str, seed: int) -> Composition:
    """The session of a kind and a seed, always the same."""
    return session_of(drawn(kind, seed))


def session_of(recipe: Recipe) -> Composition:
    """The session of a recipe; without a lift that nobody could know of."""
    cameras = cameras_of(recipe)
    carriers = _carriers(recipe, cameras)
    rides = [carrier.ride for carrier in carriers]
    times_s = {camera.name: _picture_times(recipe, camera, rides) for camera in cameras}

    def pictures(camera: Camera) -> list[Picture]:
        return pictures_of(recipe, camera, carriers, times_s[camera.name])

    seen = {camera.name: pictures(camera) for camera in cameras}
    for camera in _to_be_knocked(recipe, cameras, seen):
        seen[camera.name] = pictures(camera)
        cameras = [camera if other.name == camera.name else other for other in cameras]
    if not all(
        _is_told(carrier, lift_s, cameras, seen)
        for carrier in carriers
        for lift_s in carrier.ride.lifts_s
    ):
        return session_of(replace(recipe, lifts=0))
    gaps_s = {carrier.name: _gaps(recipe, carrier) for carrier in carriers}
    return Composition(recipe, cameras, carriers, seen, gaps_s)


def _carriers(recipe: Recipe, cameras: list[Camera]) -> list[Carrier]:
    carriers = []
    for number in range(recipe.robots):
        name = f"r{number + 1}"
        is_own = recipe.robots > 1 and not recipe.is_one_target
        called = f"target-{name}" if is_own else "three-plane"
        variant = number if is_own else 0
        told = target_of(recipe.pattern, recipe.shape, variant=variant, name=called)
        carried = told
        if recipe.mount:
            carried = mounted(told, MOUNT_M, MOUNT_RAD, recipe.random("mount", name))
        # Whoever lifts robots lifts one of them.
        lifts = recipe.lifts if number == recipe.seed % recipe.robots else 0
        ride = ride_of(recipe, cameras, told, number, lifts=lifts)
        carriers.append(Carrier(name, told, carried, ride))
    end_s = max(carrier.ride.end_s for carrier in carriers)
    return [replace(carrier, ride=carrier.ride.lasting(end_s)) for carrier in carriers]


def _picture_times(recipe: Recipe, camera: Camera, rides: list[Ride]) -> np.ndarray:
    """True times (n,) on the steps: at a rate, or in the middle of each stand of any robot."""
    end_s = rides[0].end_s
    if recipe.rate_hz is None:
        moments = np.array([stop_s for ride in rides for stop_s in ride.stops_s])
        return np.unique(np.round(moments / STEP_S)) * STEP_S
    between = round(1 / recipe.rate_hz / STEP_S)
    phase = int(recipe.random("phase", camera.name).integers(between))
    # The clock's offset must not bring a stamp before the odometry's first or after its last.
    index = np.arange(round(0.3 / STEP_S) + phase, round((end_s - 0.3) / STEP_S), between)
    return index * STEP_S


def _is_told(
    carrier: Carrier, lift_s: float, cameras: list[Camera], seen: dict[str, list[Picture]]
) -> bool:
    """Whether a camera met the robot rightly before and after a lift, hanging where it hung. One
    after which it meets only new cameras, or such as were moved meanwhile, is told by no picture:
    these then hang elsewhere, and all fits as well. Nor is one in space that one picture before or
    after it shows: the robot may have been put down anyhow."""
    enough = 2 if carrier.ride.is_in_space else 1
    for camera in cameras:
        met_s = [
            picture.t_s
            for picture in seen[camera.name]
            if any(face.robot == carrier.name and face.is_good.any() for face in picture.faces)
        ]
        moved_s = [move.at_s for move in camera.moves]
        since_s = max((at_s for at_s in moved_s if at_s < lift_s), default=-np.inf)
        until_s = min((at_s for at_s in moved_s if at_s >= lift_s), default=np.inf)
        met_s = [at_s for at_s in met_s if since_s < at_s < until_s]
        before = sum(at_s < lift_s for at_s in met_s)
        if min(before, len(met_s) - before) >= enough:
            return True
    return False


def _to_be_knocked(
    recipe: Recipe, cameras: list[Camera], seen: dict[str, list[Picture]]
) -> list[Camera]:
    """Cameras that are moved between two of their pictures, as they then hang."""
    random = recipe.random("knocks")
    often = [camera for camera in cameras if len(seen[camera.name]) >= 2]
    count = min(recipe.moves, len(often))
    chosen = random.choice(len(often), size=count, replace=False) if count else []
    knocked = []
    for index in chosen:
        camera = often[index]
        times_s = np.array([picture.t_s for picture in seen[camera.name]])
        # In one of the longer pauses, when nobody looks.
        pauses = np.diff(times_s)
        longest = np.flatnonzero(pauses >= 0.5 * pauses.max())
        pause = int(random.choice(longest))
        at_s = times_s[pause] + 0.5 * pauses[pause]
        knocked.append(camera.knocked(float(at_s), random))
    return knocked


def _gaps(recipe: Recipe, carrier: Carrier) -> list[tuple[float, float]]:
    """When odometry is lost: while the robot drives straight, so that what is reported over the gap
    is as long as the way."""
    random = recipe.random("gaps", carrier.name)
    long = [leg for leg in carrier.ride.straight_s if leg[1] - leg[0] > _GAP_S[0] + 0.2]
    count = min(recipe.gaps, len(long))
    chosen = random.choice(len(long), size=count, replace=False) if count else []
    gaps = []
    for index in chosen:
        start_s, end_s = long[index]
        lasts = random.uniform(_GAP_S[0], min(_GAP_S[1], end_s - start_s - 0.1))
        begin = random.uniform(start_s + 0.05, end_s - 0.05 - lasts)
        gaps.append((float(begin), float(begin + lasts)))
    return gaps
