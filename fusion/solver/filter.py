"""The live side of the smoother: what a batch solution knows, carried on sighting by sighting.

The state is the dense part of the problem (cameras, lenses, scales and each robot's last pose) as
mean and covariance about a fixed linearisation point. A new sighting appends a node, odometry links
it to the robot's last one, and that is marginalised out; this is exact but for the fixed point,
which the next batch solution moves. A step costs the same in a state of any size (see `gaussian`).
Filters are immutable, so that going back to an earlier one for a late sighting costs nothing.
"""

from functools import cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, base_from_faces, points_of
from trigpoint.fusion.model.prediction import picture_factor
from trigpoint.fusion.model.problem import (
    Batch,
    CameraState,
    Carried,
    Chain,
    Layout,
    Priors,
    Problem,
    RobotState,
    State,
    layout_of,
)
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever

from .equations import EXACT, Reduced, covariance_of
from .gaussian import Gaussian

# A pose with a larger sigma counts as unknown: behind a jump of the odometry nothing connects it to
# the map.
_LOOSE_M = 20.0
_LOOSE_RAD = 1.0
# Of a robot that may be anywhere, about a pose that a sighting shows: so weak that it adds nothing.
_UNKNOWN_M = 10.0
_UNKNOWN_RAD = 3.0


class RobotEstimate(Struct, frozen=True):
    """A robot at a time: map_from_base, and the covariance (6, 6) of its disturbance."""

    stamp_ns: int
    map_from_base: Pose
    covariance: Array


class Filter(Struct, frozen=True, eq=False, dict=True):
    """A Gaussian estimate about a fixed point. `state`: that point, with one node of each robot,
    its last; `stamps_ns`: of those nodes; `source`: the distribution as it was computed;
    `holds_cameras`: what is known of cameras stays as it is, and sightings tell of robots alone."""

    state: State
    stamps_ns: dict[str, int]
    layout: Layout
    source: Reduced | Gaussian
    holds_cameras: bool = False

    @cached_property
    def known(self) -> Gaussian:
        """The distribution of the step from the fixed point; raise LinAlgError where something is
        not determined at all."""
        if isinstance(self.source, Gaussian):
            return self.source
        covariance = self.source.covariance()
        return Gaussian.of(-covariance @ self.source.gradient, covariance)

    @property
    def is_worth_settling(self) -> bool:
        """Whether one of the next steps will have to evaluate the full covariance."""
        return isinstance(self.source, Gaussian) and self.source.is_worth_settling

    def settled(self) -> "Filter":
        """The same filter with its covariance evaluated; raise LinAlgError as `known` does."""
        return replace(self, source=self.known.settled())

    def copy(self) -> "Filter":
        """The same filter for another thread, its covariance evaluated."""
        return replace(self, source=self.known.copy())

    @property
    def reduced(self) -> Reduced:
        """The estimate in information form."""
        if isinstance(self.source, Reduced):
            return self.source
        information = covariance_of(self.source.covariance)
        return Reduced(self.layout, information, -information @ self.source.mean)

    @classmethod
    def at_origin(cls, data: DataSet) -> "Filter":
        """Before any sighting: the first robot where its odometry begins, or the known cameras."""
        state = data.first_state()
        stamps, robots = {}, {}
        anchored = data.anchored_robot
        if anchored is not None and len(data.tracks[anchored]):
            track = data.tracks[anchored]
            robots[anchored] = replace(
                state.robots[anchored], map_from_base=Pose.stack([track.odom_from_base[0]])
            )
            stamps[anchored] = track.first_ns
        state = State(state.cameras, state.robots | robots)
        priors = Priors.none()
        chains = {
            name: Chain.unlinked(name, np.array([stamps[name]]), data.tracks[name])
            for name in robots
        }
        layout = layout_of(list(state.cameras), chains, priors, state)
        information = np.zeros((layout.size, layout.size))
        for name in robots:
            last = layout.last[name]
            information[last, last] = EXACT
        if data.known.poses:
            columns = np.concatenate([layout.pose[name] for name in data.known.poses])
            information[np.ix_(columns, columns)] = data.known_at_start.of_poses.information
        reduced = Reduced(layout, information, np.zeros(layout.size))
        return cls(state, stamps, layout, reduced)

    @classmethod
    def in_fixed_map(
        cls,
        data: DataSet,
        cameras: dict[str, CameraState],
        covariance: Array,
        robot: str,
        stamp_ns: int,
        map_from_base: Pose,
        scales: Array,
    ) -> "Filter":
        """A robot of which nothing is known, linearised at a pose, among cameras of a joint
        covariance (6n, 6n) that stay; `scales` (2,): of its odometry."""
        track = data.tracks[robot]
        faces = base_from_faces(data.targets[robot])
        state = State(cameras, {robot: RobotState(Pose.stack([map_from_base]), scales, faces)})
        chain = Chain.unlinked(robot, np.array([stamp_ns]), track, scales)
        layout = layout_of(list(cameras), {robot: chain}, Priors.none(), state)
        unknown = np.repeat([_UNKNOWN_M**2, _UNKNOWN_RAD**2], 3)[track.tangent]
        whole = np.zeros((layout.size, layout.size))
        whole[: len(covariance), : len(covariance)] = covariance
        whole[np.ix_(layout.last[robot], layout.last[robot])] = np.diag(unknown)
        source = Gaussian.of(np.zeros(layout.size), whole)
        return cls(state, {robot: stamp_ns}, layout, source, holds_cameras=True)

    @classmethod
    def after(cls, state: State, problem: Problem, reduced: Reduced) -> "Filter":
        """The filter that carries a batch solution on from its last nodes."""
        stamps, robots = {}, dict(state.robots)
        for name, chain in problem.chains.items():
            nodes = state.robots[name].map_from_base
            robots[name] = replace(state.robots[name], map_from_base=Pose.stack([nodes[-1]]))
            stamps[name] = int(chain.stamps_ns[-1])
        return cls(State(state.cameras, robots), stamps, reduced.layout, reduced)

    def spread(self, covariances: dict[str, Array]) -> "Filter":
        """The same with these covariances (6, 6) added to those of cameras' poses."""
        if not covariances:
            return self
        whole = self.known.covariance.copy()
        for camera, covariance in covariances.items():
            columns = self.layout.pose[camera]
            whole[np.ix_(columns, columns)] += covariance
        return replace(self, source=Gaussian.of(self.known.mean, whole))

    def has_robot(self, robot: str) -> bool:
        """Whether the robot is located in the map."""
        return robot in self.stamps_ns

    def has_camera(self, camera: str) -> bool:
        """Whether the camera is part of the state."""
        return camera in self.layout.pose

    def robot(self, data: DataSet, robot: str, stamp_ns: int | None = None) -> RobotEstimate:
        """The robot at its last node, or propagated to a later time by its odometry.

        Raises LinAlgError where nothing determines it.
        """
        last = self.layout.last[robot]
        tangent = data.tracks[robot].tangent
        disturbance, full = np.zeros(6), np.zeros((6, 6))
        disturbance[tangent] = self.known.mean_of(last)
        full[np.ix_(tangent, tangent)] = self.known.covariance_of(last)
        pose = self.state.robots[robot].map_from_base[0].disturbed(disturbance)
        estimate = RobotEstimate(self.stamps_ns[robot], pose, full)
        if stamp_ns is None or stamp_ns <= estimate.stamp_ns:
            return estimate
        if robot in self.layout.scales:
            return self.carried(data, robot, stamp_ns).robot(data, robot)
        return carried_on(data, robot, estimate, stamp_ns, self.scales(robot))

    def carried(self, data: DataSet, robot: str, stamp_ns: int) -> "Filter":
        """The filter with the robot's last pose propagated to a later time by its odometry; unlike
        `carried_on`, with the uncertainty of its scales."""
        start = self.robot(data, robot)
        if stamp_ns <= start.stamp_ns:
            return self
        guess = carried_on(data, robot, start, stamp_ns, self.scales(robot)).map_from_base
        return self.advanced(data, robot, stamp_ns, guess)

    def before(self, data: DataSet, robot: str, camera: str, stamp_ns: int) -> Array:
        """Covariance (6, 6) of a robot's pose relative to a camera, at the robot's last node or
        later by its odometry.

        It may be far smaller than that of either in the map. A disturbance (δt, δθ) of the camera
        moves what stands before it by δt + δθ × a, with a the vector from the camera to it.
        """
        ahead = self.carried(data, robot, stamp_ns)
        last = self.layout.last[robot]
        pose = self.layout.pose[camera]
        eye = self.state.cameras[camera].map_from_camera.disturbed(ahead.known.mean_of(pose))
        place = ahead.robot(data, robot).map_from_base
        taken_along = lever(place.translation - eye.translation)
        apart = np.concatenate([np.eye(6)[:, data.tracks[robot].tangent], -taken_along], axis=1)
        return apart @ ahead.known.covariance_of(np.concatenate([last, pose])) @ apart.T

    def scales(self, robot: str) -> Array:
        """The robot's scale errors at the fixed point, (2,)."""
        return self.state.robots[robot].scales

    def advanced(self, data: DataSet, robot: str, stamp_ns: int, guess: Pose) -> "Filter":
        """The filter with the robot's last pose moved on by odometry; `guess`: its new fixed
        point. Raises LinAlgError as `OdometryTrack.step` does."""
        before, start_ns = self.state.robots[robot], self.stamps_ns[robot]
        last, scales = self.layout.last[robot], self.layout.scales_of(robot)
        matrix, shift, noise = data.tracks[robot].step(
            start_ns, stamp_ns, self.scales(robot), before.map_from_base[0], guess
        )
        of = np.concatenate([last, scales])
        moved = self.known.moved(last, of, matrix[:, : len(of)], shift, noise)
        there = replace(before, map_from_base=Pose.stack([guess]))
        state = State(self.state.cameras, self.state.robots | {robot: there})
        stamps_ns = self.stamps_ns | {robot: stamp_ns}
        return replace(self, state=state, stamps_ns=stamps_ns, source=moved)

    def updated(
        self, data: DataSet, observation: Observation, *, share: float = 1.0
    ) -> tuple["Filter", float]:
        """The filter after an observation of the robot at its last node; also the observation's
        normalised innovation squared, χ² with twice as many degrees of freedom as corners.
        `share`: its weight.

        The picture's equations are replaced by their triangular factor, so that there are only as
        many as unknowns that it bears on.
        """
        robot = observation.robot
        moment = np.array([self.stamps_ns[robot]])
        chain = Chain.unlinked(robot, moment, data.tracks[robot], self.scales(robot))
        name = observation.camera
        clock = self.state.cameras[name] if name in self.layout.time_offset else None
        batch = _batch(data, chain, observation, share, clock)
        problem = Problem({robot: chain}, (batch,), Priors.none(), self.layout)
        factor, columns = picture_factor(problem, batch, self.state)
        where = np.concatenate([self.layout.last[robot], columns])
        free = self.layout.last[robot] if self.holds_cameras else None
        after, whitened = self.known.updated(where, factor[:-1, :-1], factor[:-1, -1], free=free)
        return replace(self, source=after), float(factor[-1, -1] ** 2 + whitened @ whitened)


def is_placed(covariance: Array) -> bool:
    """Whether this covariance (6, 6) is small enough for its pose to be used."""
    return bool(
        np.trace(covariance[:3, :3]) < _LOOSE_M**2 and np.trace(covariance[3:, 3:]) < _LOOSE_RAD**2
    )


def carried_on(
    data: DataSet, robot: str, estimate: RobotEstimate, stamp_ns: int, scales: Array
) -> RobotEstimate:
    """An estimate propagated to a later time by odometry."""
    if stamp_ns <= estimate.stamp_ns:
        return estimate
    pose, covariance = data.tracks[robot].carried_on(
        estimate.stamp_ns, stamp_ns, scales, estimate.map_from_base, estimate.covariance
    )
    return RobotEstimate(stamp_ns, pose, covariance)


def _batch(
    data: DataSet, chain: Chain, observation: Observation, share: float, camera: CameraState | None
) -> Batch:
    """The batch of one observation; `camera`: its clock's estimate, where that is to be updated."""
    points = points_of(observation, data.targets[observation.robot])
    jitter = data.jitter.get(observation.robot)
    stamps_ns, nodes = np.array([observation.stamp_ns]), np.zeros(1, dtype=int)
    since_epoch_s, carried = data.since_epoch_s(stamps_ns), None
    if camera is not None:
        carried = Carried.of(chain, nodes, stamps_ns, camera.offset_s(since_epoch_s))
    return Batch(
        camera=observation.camera,
        robot=observation.robot,
        nodes=nodes,
        face_points=points.face_points[None],
        faces=points.faces[None],
        pixels=points.pixels[None],
        weights=points.weights[None] * np.sqrt(share),
        shares=np.array([share]),
        sources=np.zeros(1, dtype=int),
        since_epoch_s=since_epoch_s,
        carried=carried,
        jitter=jitter.in_pictures(np.zeros((1, 3))) if jitter is not None else None,
    )
