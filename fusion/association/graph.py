"""The small pose graph over the modes of all visits on which an explanation is scored.

The unknowns are the robots' poses at the beginnings of visits, the places of the cameras, and
lenses, clocks and odometry scales where they are estimated. A visit's mode ties one robot pose to
one place (`local`); odometry ties the robot poses to each other, except where a lift breaks it. The
score is -2 ln of the posterior with all of these integrated out (Laplace's approximation at the
minimum, `minimum`), so that explanations of different dimension are comparable.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.geometry import Pose
from trigpoint.geometry.pose import rows_of
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import turned_axes
from trigpoint.native.library import Handle, In, Kernel, Out

from .events import Events
from .mode import Mode, VisitModes
from .own_unknowns import own_prior, own_values
from .path import Picture, RobotPath, VisualStep, visual_step, watched_step

_CLOCK_SIGMAS = 5.0
Place = tuple[str, int]
"""A camera and the number of one of its places, counted from 0 in order of time."""
Break = tuple[str, int]
"""A robot and the node after which it was lifted."""


class Factor(Handle):
    """The factorised information matrix of a graph at its minimum."""

    name = "tp_factor"

    def covariance(self, rows: np.ndarray) -> Array:
        """Return the marginal covariance (k, k) of the unknowns in these rows. Raises RuntimeError
        where nothing is factorised, or a row is none of its unknowns."""
        found = np.empty((len(rows), len(rows)))
        _COVARIANCE(self, np.ascontiguousarray(rows, dtype=np.int64), found)
        return found


_COVARIANCE = Kernel(
    "tp_factor_covariance", Factor, In(np.int64, ("k",)), Out(np.float64, ("k", "k"))
)


class Tie(Struct, frozen=True):
    """The hypothesis for a visit that is used: one of its modes, at one place of its camera."""

    mode: int
    place: int


class Layout(Struct, frozen=True):
    """The rows of a graph's `size` unknowns: by robot of its `nodes` (n, d) and odometry `scales`
    (2,), of each place (6,), and by camera of its `own` unknowns (lens, clock). Of its poses, all
    robots' nodes and then the places: each robot's `first`, and where each place is (`at`)."""

    size: int
    nodes: dict[str, np.ndarray]
    scales: dict[str, np.ndarray]
    places: dict[Place, np.ndarray]
    own: dict[str, np.ndarray]
    first: dict[str, int]
    at: dict[Place, int]


class Placed(Struct, frozen=True):
    """A graph at its minimum, with its `score`. `poses` (n, 12): rows of the robots at the
    beginnings of their visits and of the cameras, as in `layout`; `values` (v,): the scale errors
    of the robots of `layout.scales`, then the own unknowns of the cameras of `layout.own`; none
    where they are not known; `ties`, `breaks`: of its variant; `factor`: of the information
    matrix, whose rows are those of `layout`."""

    score: float
    poses: Array
    values: Array
    ties: Mapping[int, Tie]
    breaks: frozenset[Break]
    layout: Layout
    factor: Factor

    def node(self, robot: str, node: int) -> Pose:
        """Return a robot's pose at the beginning of a visit."""
        return Pose.from_rows(self.poses[self.layout.first[robot] + node])

    def place(self, place: Place) -> Pose:
        """Return a camera's pose."""
        return Pose.from_rows(self.poses[self.layout.at[place]])

    def own(self, camera: str) -> Array:
        """Return the values (o,) of a camera's own unknowns at the minimum; none if known."""
        # They are the last of both.
        rows = self.layout.own.get(camera, np.arange(0))
        return self.values[rows - self.layout.size + len(self.values)]

    def covariance(self, rows: np.ndarray) -> Array:
        """Return the marginal covariance (k, k) of the unknowns in these rows."""
        return self.factor.covariance(rows)


class Variant(Struct, frozen=True):
    """A hypothesis whose graph is to be solved. `ties`: by number, the visits that are used;
    `nothing`: those all of whose sightings are wrong; `breaks`: the lifts; `near`: a similar graph
    at its minimum, to start from."""

    ties: Mapping[int, Tie]
    nothing: frozenset[int]
    breaks: frozenset[Break]
    near: Placed | None = None


class Modes(Struct, frozen=True):
    """What the modes (k) of a visit say, in the axes of the robot at its beginning:
    `base_from_camera` (k), with the `information` (k, q, q) of the pose and of the camera's own
    unknowns, the `covariance` (k, 6, 6) of the pose, the values of the others, `own` (k, o), and
    the `evidence` (k,) of each (`Mode.evidence`)."""

    base_from_camera: Pose
    information: Array
    covariance: Array
    own: Array
    evidence: Array


Shown = dict[tuple[object, ...], VisualStep | None]
"""Steps as visits show them, by what that depends on."""


class Graph:
    """What the pose graphs of all explanations of one session's visits are made of; `minimum`
    solves them. `modes`: of each visit; `odometry` (n, 12): all robots' nodes by odometry alone;
    `known_rows` (n, 12), `known_information` (n, 6, 6): of each camera that is known from before,
    by itself; `shown`: steps as visits show them, by `keys` of what their modes depend on; those
    known before are not worked out again."""

    def __init__(
        self,
        data: DataSet,
        visits: list[VisitModes],
        events: Events,
        keys: Sequence[object] = (),
        shown: Shown | None = None,
    ) -> None:
        self.data, self.visits, self.events = data, visits, events
        self.paths = {
            robot: RobotPath(
                data, robot, [_moment(data, v) for v in visits if v.visit.robot == robot]
            )
            for robot in data.site.robots
            if any(v.visit.robot == robot for v in visits)
        }
        self.node_of = [
            int(np.searchsorted(self.paths[v.visit.robot].stamps_ns, _moment(data, v)))
            for v in visits
        ]
        self._begin_at: dict[tuple[str, int], list[int]] = {}
        for number, (found, node) in enumerate(zip(visits, self.node_of, strict=True)):
            self._begin_at.setdefault((found.visit.robot, node), []).append(number)
        known = data.known_at_start
        self.known_rows = rows_of(known.poses.values())
        own = [slice(6 * n, 6 * n + 6) for n in range(len(known.poses))]
        marginals = np.array([known.covariance[part, part] for part in own]).reshape(-1, 6, 6)
        self.known_information = np.linalg.inv(marginals)
        self._across: dict[Break, list[VisualStep]] = {}
        self._clocks = [_clock(data, v) for v in visits]
        self.shown: Shown = {}
        self._visual = self._visual_steps(keys or range(len(visits)), shown or {})
        self._showing = {
            each.number
            for steps in self._visual.values()
            for seen in steps.values()
            for each in seen
        }
        self.modes = [self._modes_of(number) for number in range(len(visits))]
        self.odometry = rows_of(path.odometry for path in self.paths.values())
        self.own_prior = {
            camera: prior
            for camera in dict.fromkeys(v.visit.camera for v in visits)
            if len((prior := own_prior(data, camera))[0])
        }

    def _visual_steps(
        self, keys: Sequence[object], before: Shown
    ) -> dict[str, dict[int, list[VisualStep]]]:
        """Return, by robot and step, its motion as visits show it, the most precise first."""
        found: dict[str, dict[int, list[VisualStep]]] = {robot: {} for robot in self.paths}
        for number, visit in enumerate(self.visits):
            if not visit.modes:
                continue
            robot, stamps = visit.visit.robot, [stamp_ns for stamp_ns, _ in visit.right]
            path = self.paths[robot]
            last = int(np.searchsorted(path.stamps_ns, max(stamps, default=0)))
            for step in range(self.node_of[number], min(last, len(path.stamps_ns) - 1)):
                pictures = self._on_the_way(step, number)
                ends = *path.stamps_ns[step : step + 2].tolist(), float(path.log_covariance[step])
                key = number, keys[number], *ends, *pictures
                if key in before:
                    one = before[key]
                else:
                    one = visual_step(path, step, number, visit, pictures)
                self.shown[key] = one
                if one is not None:
                    found[robot].setdefault(step, []).append(one)
        for steps in found.values():
            for seen in steps.values():
                seen.sort(key=lambda each: each.log_covariance)
        return found

    def _on_the_way(self, step: int, number: int) -> list[Picture]:
        """Return a visit's pictures that were surely taken between node `step` of its robot and the
        next."""
        found = self.visits[number]
        robot = found.visit.robot
        begin, end = self.paths[robot].stamps_ns[step : step + 2].tolist()
        first, last = (self._begin_at.get((robot, node), []) for node in (step, step + 1))
        return [
            self._taken(number, one)
            for one in found.right
            if begin <= one[0] <= end
            and all(self._precedes(n, begin, number, one[0]) for n in first)
            and all(self._precedes(number, one[0], n, end) for n in last)
        ]

    def _taken(self, number: int, picture: Picture) -> Picture:
        """Return a picture of a visit with the time at which it was taken in place of its stamp."""
        stamp_ns, index = picture
        return stamp_ns - to_ns(self.visits[number].modes[0].early_s), index

    def silent(self, nothing: frozenset[int]) -> frozenset[int]:
        """Return those of these visits that would show a step, were they not wrong."""
        return nothing & self._showing

    def seen(self, robot: str, nothing: frozenset[int]) -> dict[int, VisualStep]:
        """Return, by step of a robot, the most precise motion that a visit other than `nothing`
        shows."""
        found = {}
        for step, seen in self._visual[robot].items():
            best = next((each for each in seen if each.number not in nothing), None)
            if best is not None:
                found[step] = best
        return found

    def shows_steps(self, number: int) -> bool:
        """Whether a visit shows a step of its robot more precisely than odometry does."""
        return number in self._showing

    def _modes_of(self, number: int) -> Modes:
        """Return what a visit's modes say. A mode holds the camera's pose relative to where the
        robot was when the first picture was taken, by the time offset at which its estimation
        started."""
        visit, modes = self.visits[number].visit, self.visits[number].modes
        own = np.array([own_values(self.data, visit.camera, mode.camera) for mode in modes])
        evidence = np.array([mode.evidence for mode in modes])
        if not modes:
            nothing = np.zeros((0, 6, 6))
            return Modes(Pose.stack([]), nothing, nothing, own, evidence)
        start = self.paths[visit.robot].odometry[self.node_of[number]]
        back = self.seen_since(number, modes)
        turn = np.tile(np.eye(modes[0].information.shape[-1]), (len(modes), 1, 1))
        turn[:, :6, :6] = turned_axes(back.rotation @ start.rotation.T)
        information = np.array([mode.information for mode in modes])
        seen = back @ start.inverse() @ Pose.stack([mode.map_from_camera for mode in modes])
        information = turn @ information @ np.swapaxes(turn, 1, 2)
        covariance = np.ascontiguousarray(np.linalg.inv(information)[:, :6, :6])
        return Modes(seen, information, covariance, own, evidence)

    def seen_since(self, number: int, modes: Sequence[Mode]) -> Pose:
        """Return the robot's motion (k) from the stamp of a visit's first picture to the moment at
        which it was taken, according to each of the modes (k)."""
        path = self.paths[self.visits[number].visit.robot]
        moments = np.full(len(modes), path.stamps_ns[self.node_of[number]])
        early_s = np.array([mode.early_s for mode in modes])
        return path.track.carried(moments, -early_s, np.zeros(2))[0]

    def room(self, path: RobotPath) -> Array:
        """Return the prior variances (d,) of where a robot may be put down in the room."""
        return self.events.room_variances[path.tangent]

    def across(self, gap: Break, nothing: frozenset[int] = frozenset()) -> VisualStep | None:
        """Return the motion across a gap in which odometry broke, from the visit that shows it most
        precisely; None if no visit goes on from before the gap to after it. `nothing`: the visits
        that do not count."""
        if gap not in self._across:
            numbers = range(len(self.visits))
            each = [one for n in numbers if (one := self._seen_across(gap, n)) is not None]
            self._across[gap] = sorted(each, key=lambda one: one.log_covariance)
        return next((one for one in self._across[gap] if one.number not in nothing), None)

    def _seen_across(self, gap: Break, number: int) -> VisualStep | None:
        robot, step = gap
        path, found = self.paths[robot], self.visits[number]
        begin, end = path.stamps_ns[step : step + 2].tolist()
        stamps = [stamp_ns for stamp_ns, _ in found.right]
        goes_on = bool(stamps) and min(stamps) <= begin and max(stamps) >= end
        if found.visit.robot != robot or not found.modes or not goes_on:
            return None
        first, last = (self._begin_at.get((robot, node), []) for node in (step, step + 1))
        before = [
            one
            for one in found.right
            if one[0] <= begin and all(self._precedes(number, one[0], n, begin) for n in first)
        ]
        after = [
            one
            for one in found.right
            if one[0] >= end and all(self._precedes(n, end, number, one[0]) for n in last)
        ]
        if not before or not after:
            return None
        return watched_step(
            path,
            step,
            number,
            found,
            (self._taken(number, before[-1]), self._taken(number, after[0])),
        )

    def _precedes(self, first: int, first_ns: int, second: int, second_ns: int) -> bool:
        """Whether a picture of one visit was surely not taken after one of another, given their
        stamps and how well the cameras' clocks are known."""
        if self.visits[first].visit.camera == self.visits[second].visit.camera:
            return first_ns <= second_ns
        (offset, sigma), (other_offset, other_sigma) = self._clocks[first], self._clocks[second]
        apart_ns = (second_ns - other_offset) - (first_ns - offset)
        return apart_ns >= _CLOCK_SIGMAS * float(np.hypot(sigma, other_sigma))

    def layout(self, places: Sequence[Place]) -> Layout:
        """Lay out the unknowns and poses of a graph with all robots' nodes and these places."""
        size = count = 0

        def rows(some: int) -> np.ndarray:
            nonlocal size
            size += some
            return np.arange(size - some, size)

        nodes, scales, first = {}, {}, {}
        for robot, path in self.paths.items():
            d = len(path.tangent)
            nodes[robot] = rows(len(path.stamps_ns) * d).reshape(-1, d)
            first[robot], count = count, count + len(path.stamps_ns)
            if np.any(path.scale_sigma > 0):
                scales[robot] = rows(2)
        of_places = {place: rows(6) for place in places}
        cameras = dict.fromkeys(camera for camera, _ in places)
        own = {c: rows(len(self.own_prior[c][0])) for c in cameras if c in self.own_prior}
        at = {place: count + order for order, place in enumerate(places)}
        return Layout(size, nodes, scales, of_places, own, first, at)


def _clock(data: DataSet, found: VisitModes) -> tuple[float, float]:
    """Return a camera's time offset as a visit estimates it, and its sigma, ns."""
    sigma_s = data.site.cameras[found.visit.camera].time_offset_sigma
    if sigma_s == 0 or not found.modes:
        return 0.0, to_ns(sigma_s)
    mode = found.modes[0]
    # The last two unknowns of a mode are the clock's offset and drift.
    variance = float(np.linalg.inv(mode.information)[-2, -2])
    return to_ns(mode.camera.time_offset_s), to_ns(min(np.sqrt(variance), sigma_s))


def _moment(data: DataSet, modes: VisitModes) -> int:
    track = data.tracks[modes.visit.robot]
    return int(np.clip(modes.visit.stamp_ns, track.first_ns, track.last_ns))
