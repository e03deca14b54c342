"""Assembles the problem from the data set: node chains, padded batches, priors, initial state."""

from collections import defaultdict

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import NANOSECONDS
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique
from trigpoint.site.config import CameraConfig, FusionConfig, OdometryNoise
from trigpoint.site.target import Target

from .dataset import DataSet
from .known_cameras import KnownCameras
from .observations import Observation, Points, base_from_faces, joined, moving
from .odometry import OdometryTrack
from .problem import (
    Batch,
    CameraState,
    Carried,
    Chain,
    Layout,
    Priors,
    Problem,
    State,
    layout_of,
    true_times_ns,
)
from .trajectory import interpolated

# While no camera sees the robot for long, nodes are inserted in between, so that its trajectory
# there is solved for with the rest and can be interpolated.
_FILL_NS = NANOSECONDS


class Assembled(Struct, frozen=True):
    """A problem, the state to start from, and the node of each used entry of the data set."""

    problem: Problem
    start: State
    node_of: dict[int, int]


def assemble(
    data: DataSet, state: State, entries: list[int], *, anchored: bool = True
) -> Assembled:
    """Assemble the problem over these entries of the data set and all cameras that they name.

    `state`: the initial values of cameras, scales and faces; `anchored`: whether the gauge is fixed
    by the first robot's odometry or by the known cameras, with nodes inserted on long ways between
    sightings; otherwise it is fixed by the first node (a camera alone).
    """
    cameras = _cameras_of(data, state, entries, anchored=anchored)
    by_robot: dict[str, list[int]] = defaultdict(list)
    for index in entries:
        by_robot[data.entries[index].observation.robot].append(index)
    chains, nodes, node_of = {}, {}, {}
    for robot in data.site.robots:
        if robot in by_robot:
            chain = _chain(data, state, robot, by_robot[robot], anchored=anchored)
            chains[robot], nodes[robot] = chain.chain, chain.poses
            node_of |= chain.node_of
    start = State(
        {name: state.cameras[name] for name in cameras},
        {robot: replace(state.robots[robot], map_from_base=nodes[robot]) for robot in chains},
    )
    priors = _priors(data, cameras, list(chains), anchored=anchored)
    layout = layout_of(cameras, chains, priors, start)
    start = State(_of_one_lens(start.cameras, priors.owners), start.robots)
    batches = _batches(data, state, chains, nodes, entries, node_of, layout)
    return Assembled(Problem(chains, batches, priors, layout), start, node_of)


def _cameras_of(data: DataSet, state: State, entries: list[int], *, anchored: bool) -> list[str]:
    seen = {data.entries[index].observation.camera for index in entries}
    known = set(data.known.poses) if anchored else set()
    return [name for name in data.camera_names if name in state.cameras and name in seen | known]


def _of_one_lens(cameras: dict[str, CameraState], owners: dict[str, str]) -> dict[str, CameraState]:
    """Give all places of one camera the lens and the clock that they share."""
    return {
        name: CameraState(
            camera.map_from_camera,
            cameras[owners[name]].lens,
            cameras[owners[name]].time_offset_s,
            cameras[owners[name]].time_drift,
        )
        for name, camera in cameras.items()
    }


class _BuiltChain(Struct, frozen=True):
    chain: Chain
    poses: Pose
    node_of: dict[int, int]


def _chain(
    data: DataSet, state: State, robot: str, entries: list[int], *, anchored: bool
) -> _BuiltChain:
    track, scales = data.tracks[robot], state.robots[robot].scales
    is_first = anchored and robot == data.anchored_robot
    seen = [data.entries[index].observation for index in entries]
    stamps_ns = np.array([observation.stamp_ns for observation in seen], dtype=np.int64)
    clocks = np.array([state.cameras[observation.camera].clock for observation in seen])
    offset, drift = clocks.reshape(-1, 2).T
    times = true_times_ns(stamps_ns, offset + drift * data.since_epoch_s(stamps_ns))
    times = np.clip(times, track.first_ns, track.last_ns)
    moments = unique(np.concatenate([times, [track.first_ns]]) if is_first else times)
    if anchored:
        moments = filled(moments, track)
    group = np.zeros(len(moments), dtype=int)
    motion = None
    if len(moments) > 1:
        # Moments between which the robot stood still share a node.
        motion = track.motion(moments, scales)
        group[1:] = np.cumsum(~motion.is_still)
        motion = motion.where(~motion.is_still)
    node_of = dict(zip(entries, group[np.searchsorted(moments, times)].tolist(), strict=True))
    stamps = moments[np.unique(group, return_index=True)[1]]
    chain = Chain(
        robot=robot,
        stamps_ns=stamps,
        motion=motion if len(stamps) > 1 else None,
        track=track,
        scales=scales,
        planar=track.planar,
        is_anchored=is_first or not anchored,
    )
    guesses = _guesses(data, robot, node_of)
    if is_first:
        guesses[0] = track.odom_from_base[0]
    return _BuiltChain(chain, _start_poses(chain, guesses), node_of)


def filled(moments: np.ndarray, track: OdometryTrack) -> np.ndarray:
    """The moments, with more inserted between two that lie far apart, but at most one in each step
    of odometry: a step in which the robot stood may last for days."""
    parts = [moments]
    for gap in np.flatnonzero(np.diff(moments) > 2 * _FILL_NS):
        start_ns, end_ns = moments[gap], moments[gap + 1]
        count = int((end_ns - start_ns) // _FILL_NS)
        spacing_ns = (end_ns - start_ns) / count
        first, last = np.searchsorted(track.stamps_ns, [start_ns, end_ns])
        steps = np.maximum(track.stamps_ns[max(first - 1, 0) : last], start_ns) - start_ns
        # The first of the evenly spaced moments in each step: there may be billions of them.
        which = unique(steps // spacing_ns + 1)
        parts.append((start_ns + which[which < count] * spacing_ns).astype(np.int64))
    return unique(np.concatenate(parts))


def _guesses(data: DataSet, robot: str, node_of: dict[int, int]) -> dict[int, Pose | None]:
    """Where the entries have a robot, by node."""
    entries = [(node, data.entries[index]) for index, node in node_of.items()]
    return {node: each.map_from_base for node, each in entries if each.observation.robot == robot}


def _start_poses(chain: Chain, guesses: dict[int, Pose | None]) -> Pose:
    """The initial pose of each node: its guess, or by odometry between and beyond the guesses."""
    known = {node: guesses[node] for node in sorted(guesses) if guesses[node] is not None}
    poses = Pose.stack([pose for pose in known.values() if pose is not None])
    if len(known) == len(chain):
        return poses
    if not known:
        return Pose.identity().repeated(len(chain))
    moments = chain.stamps_ns[list(known)]
    return interpolated(chain.track, chain.scales, moments, poses, chain.stamps_ns)


def _batches(
    data: DataSet,
    state: State,
    chains: dict[str, Chain],
    poses: dict[str, Pose],
    entries: list[int],
    node_of: dict[int, int],
    layout: Layout,
) -> tuple[Batch, ...]:
    pairs: dict[tuple[str, str], list[int]] = defaultdict(list)
    for index in entries:
        observation = data.entries[index].observation
        pairs[observation.camera, observation.robot].append(index)
    return tuple(
        _batch(data, state, chains[robot], poses[robot], camera, indices, node_of, layout)
        for (camera, robot), indices in pairs.items()
    )


def _batch(
    data: DataSet,
    state: State,
    chain: Chain,
    poses: Pose,
    camera: str,
    indices: list[int],
    node_of: dict[int, int],
    layout: Layout,
) -> Batch:
    target: Target = data.targets[chain.robot]
    observations = [data.entries[index].observation for index in indices]
    stamps_ns = np.array([observation.stamp_ns for observation in observations])
    since_epoch_s = data.since_epoch_s(stamps_ns)
    offset_s = state.cameras[camera].offset_s(since_epoch_s)
    times_ns = true_times_ns(stamps_ns, offset_s)
    observations = moving(observations, chain.track, times_ns, chain.scales)
    points = padded_points(observations, target)
    shares = np.array([data.entries[index].share for index in indices])
    nodes = np.array([node_of[index] for index in indices])
    carried = None
    if camera in layout.time_offset:
        carried = Carried.of(chain, nodes, stamps_ns, offset_s)
    jitter = data.jitter.get(chain.robot)
    return Batch(
        camera=camera,
        robot=chain.robot,
        nodes=nodes,
        face_points=points.face_points,
        faces=points.faces,
        pixels=points.pixels,
        weights=points.weights * np.sqrt(shares)[:, None],
        shares=shares,
        sources=np.array(indices),
        since_epoch_s=since_epoch_s,
        carried=carried,
        jitter=None if jitter is None else jitter.in_pictures(poses.translation[nodes]),
    )


def _priors(data: DataSet, cameras: list[str], robots: list[str], *, anchored: bool) -> Priors:
    site = data.site
    noise = {name: site.robots[name].odometry for name in robots}
    fusion = site.fusion
    places = {name: data.places_of(data.site_camera(name)) for name in cameras}
    owners = {name: next(each for each in places[name] if each in cameras) for name in cameras}
    configs = {name: site.cameras[data.site_camera(name)] for name in set(owners.values())}
    known = KnownCameras.none()
    if anchored:
        of_robots = {"faces", "scales"}
        known = data.known_at_start.without(lambda k, name: k in of_robots and name not in robots)
        known = _by_places(known, data, owners)

    def free(kind: str, name: str, sigmas: Array) -> Array:
        """Sigmas, infinite where more is known than they say."""
        is_known = name in known.faces if kind == "faces" else (kind, name) in known.values
        return np.full_like(sigmas, np.inf) if is_known else sigmas

    lenses = {name: data.lenses[name] for name in configs if configs[name].estimates_intrinsics}
    of_faces = np.array([fusion.target_translation, fusion.target_rotation])
    return Priors(
        owners=owners,
        lens={
            name: (lens.parameters, free("lens", name, lens_sigmas(configs[name], lens)))
            for name, lens in lenses.items()
        },
        time_offset={
            name: free("clock", name, np.array([camera.time_offset_sigma, camera.time_drift_sigma]))
            for name, camera in configs.items()
            if camera.time_offset_sigma > 0
        },
        scales={
            name: free("scales", name, np.array([each.distance_scale, each.heading_scale]))
            for name, each in noise.items()
            if estimates_scales(each)
        },
        faces={
            name: (base_from_faces(data.targets[name]), *free("faces", name, of_faces).tolist())
            for name in robots
            if estimates_faces(fusion)
        },
        known=known,
    )


def _by_places(known: KnownCameras, data: DataSet, owners: dict[str, str]) -> KnownCameras:
    """What is known, its lenses and clocks by the places whose columns they have."""
    owner_of = {data.site_camera(name): owner for name, owner in owners.items()}
    values = {
        (kind, owner_of.get(name, name)): value for (kind, name), value in known.values.items()
    }
    return replace(known, values=values)


def estimates_scales(noise: OdometryNoise) -> bool:
    """Whether an odometry's scales are estimated."""
    return noise.distance_scale > 0 or noise.heading_scale > 0


def estimates_faces(fusion: FusionConfig) -> bool:
    """Whether the faces' places on the robots are estimated."""
    return fusion.target_translation > 0 or fusion.target_rotation > 0


def lens_sigmas(camera: CameraConfig, lens: CameraModel) -> Array:
    """Prior sigmas of `lens.parameters` from the site file."""
    return np.array(
        [
            camera.focal_sigma * lens.fx,
            camera.focal_sigma * lens.fy,
            camera.centre_sigma * lens.width,
            camera.centre_sigma * lens.width,
            *([camera.distortion_sigma] * len(lens.distortion)),
        ]
    )


def padded_points(observations: list[Observation], target: Target) -> Points:
    """`points_of` of observations (n) of one robot, padded to the widest of them: (n, K, 3),
    (n, K), (n, K, 2) and (n, K), all of them 0 where an observation has no more corners."""
    views = [view for observation in observations for view in observation.views]
    readings = [reading for observation in observations for reading in observation.chosen or ()]
    assert len(readings) == len(views)
    sizes = np.array([len(view.corners) for view in views])
    faces = np.repeat([reading.face for reading in readings], sizes)
    is_turned = np.repeat([reading.is_turned for reading in readings], sizes)
    corners = np.concatenate([view.corners for view in views])
    counts = np.array([face.corner_count for face in target.faces])
    ids = np.where(is_turned, counts[faces] - 1 - corners, corners)
    first = np.cumsum(counts) - counts
    weights = np.repeat([1 / view.sigma for view in views], sizes)
    weights[np.concatenate([flags for each in observations for flags in each.wild])] = 0.0
    widths = np.array([observation.corner_count for observation in observations])
    rows = np.repeat(np.arange(len(widths)), widths)
    at = rows, np.arange(len(rows)) - (np.cumsum(widths) - widths)[rows]
    shape = (len(widths), int(widths.max()))
    points = Points(
        np.zeros((*shape, 3)), np.zeros(shape, int), np.zeros((*shape, 2)), np.zeros(shape)
    )
    in_face = np.concatenate([f.corners for f in target.faces])[first[faces] + ids]
    sweep = joined(views)
    if sweep is not None:
        poses = base_from_faces(target)[faces]
        shift = sweep.shift((poses.rotation @ in_face[..., None])[..., 0] + poses.translation)
        in_face = in_face + (shift[:, None] @ poses.rotation)[:, 0]
    points.face_points[at] = in_face
    points.faces[at] = faces
    points.pixels[at] = np.concatenate([view.pixels for view in views])
    points.weights[at] = weights
    return points
