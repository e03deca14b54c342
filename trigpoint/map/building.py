"""The map in its building: by surveyed points, by its origin, or by a floor plan alone.

The map itself stays as the contract has it; this says where it lies, and carries a network over.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from msgspec import Struct

from trigpoint.base.errors import ConfigError, InputError, writing
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, hat
from trigpoint.geometry.uncertainty import carried_covariance, symmetric
from trigpoint.site.config import MapConfig, PointConfig, Site

from .floor_plan import FloorPlan, load_floor_plan, parse_floor_plan, picture_of
from .network import AlternativeRecord, EarlierPose, Network, PoseRecord, save_network
from .survey import Laying, SurveyedPoint, lay

_Placed = TypeVar("_Placed", EarlierPose, AlternativeRecord)

FORMAT = "trigpoint-alignment/1"
ALIGNMENT = "alignment.json"

Trajectories = dict[str, tuple[np.ndarray, Pose]]
"""Robot -> (stamps_ns (n,), poses)."""


class Building(Struct, frozen=True, eq=False):
    """Where the map lies in the building's `frame`; `laying`: None where that is given by the site
    file and so taken as certain; `missing`: surveyed points that the map does not have."""

    frame: str
    frame_from_map: Pose
    plan: FloorPlan | None
    laying: Laying | None = None
    missing: tuple[str, ...] = ()

    @property
    def covariance(self) -> Array:
        """Of `frame_from_map`, (6, 6)."""
        return np.zeros((6, 6)) if self.laying is None else self.laying.covariance


def load_plan(site: Site) -> FloorPlan | None:
    """The site file's floor plan, None where it names none; raise ConfigError in one line."""
    if site.map is None or site.map.plan is None:
        return None
    return load_floor_plan(site.path(site.map.plan))


def attached_plan(site: Site, attachments: Mapping[str, bytes]) -> FloorPlan | None:
    """The same of what a session carries; None where it is not attached."""
    if site.map is None or site.map.plan is None or site.map.plan not in attachments:
        return None
    text = attachments[site.map.plan].decode(errors="replace")
    file = f"attached {site.map.plan}"
    picture = attachments.get(plan_picture(site.map.plan, text))
    if picture is None:
        raise ConfigError(f"{file}: its picture is not attached; give the site file with --site")
    return parse_floor_plan(text, picture, file=file)


def plan_picture(plan: str, text: str) -> str:
    """The picture's path as it is seen from the site file."""
    return str(Path(plan).parent / picture_of(text, file=plan))


def lay_map(
    config: MapConfig,
    plan: FloorPlan | None,
    places: Mapping[str, Array],
    covariance_of: Callable[[Sequence[str]], Array],
) -> Building:
    """Lay the map by what the site file says; `places`: cameras and marks in the map, (3,) each;
    `covariance_of`: the joint one (3n, 3n) of such.

    Raises InputError where the points do not tell it, or contradict each other.
    """
    if not config.points:
        return Building(config.frame, Pose.planar(*(config.origin or (0, 0, 0))), plan)
    known = [name for name in config.points if name in places]
    points = [
        SurveyedPoint(name, places[name], _position(config.points[name], plan), one.sigma)
        for name in known
        for one in [config.points[name]]
    ]
    laying = lay(points, covariance_of(known), is_level=config.level)
    missing = tuple(name for name in config.points if name not in places)
    return Building(config.frame, laying.frame_from_map, plan, laying, missing)


def lay_network(
    site: Site,
    plan: FloorPlan | None,
    network: Network,
    joint: Array,
    trajectories: Trajectories,
) -> Building | None:
    """Lay a solved map; `joint` (6n, 6n): of its located cameras. None where the site file has no
    [map]. Raises as `lay_map` does."""
    if site.map is None:
        return None
    places = {name: _place(network, name) for name in network.located if name in site.map.points}
    places |= _marks(site.map, trajectories)

    def covariance_of(names: Sequence[str]) -> Array:
        rows = _rows(network, names)
        chosen = np.zeros((3 * len(names), len(joint)))
        for i, first in rows.items():
            chosen[3 * i : 3 * i + 3, first : first + 3] = np.eye(3)
        return chosen @ joint @ chosen.T

    return lay_map(site.map, plan, places, covariance_of)


def own_covariances(network: Network) -> Array:
    """(6n, 6n) of the located cameras without their correlations, where the joint one is not at
    hand."""
    located = network.located
    joint = np.zeros((6 * len(located), 6 * len(located)))
    for i, name in enumerate(located):
        joint[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = network.cameras[name].covariance_matrix
    return joint


def carried(building: Building, network: Network, joint: Array) -> tuple[Network, Array]:
    """The network in the building's frame with its joint covariance (6n, 6n), in which cameras
    that were surveyed are known as well as they were."""
    covariance = _carried_joint(building, network, joint)
    located = {name: 6 * i for i, name in enumerate(network.located)}
    cameras = {}
    for name, camera in network.cameras.items():
        first = located.get(name)
        mine = None if first is None else covariance[first : first + 6, first : first + 6]
        cameras[name] = msgspec.structs.replace(
            camera,
            map_from_camera=_carried_pose(building, camera.map_from_camera),
            covariance=None if mine is None else tuple(float(v) for v in mine.reshape(-1)),
            alternatives=tuple(_carried_one(building, one) for one in camera.alternatives),
            earlier=tuple(_carried_one(building, one) for one in camera.earlier),
        )
    robots = {
        name: msgspec.structs.replace(
            robot, map_from_odom=_carried_pose(building, robot.map_from_odom)
        )
        for name, robot in network.robots.items()
    }
    moved = msgspec.structs.replace(network, cameras=cameras, robots=robots, map=building.frame)
    return moved, covariance


def save_building(
    folder: Path, building: Building, network: Network, joint: Array, ways: Trajectories
) -> Path:
    """Write alignment.json, and the network in the building's frame into a folder of its own beside
    it, named like the frame; return that folder. Raises OperationError."""
    moved, covariance = carried(building, network, joint)
    there = folder / building.frame
    save_network(
        there,
        moved,
        covariance=covariance,
        trajectories={
            name: (stamps, building.frame_from_map @ poses)
            for name, (stamps, poses) in ways.items()
        },
    )
    with writing(folder):
        (folder / ALIGNMENT).write_bytes(encode_alignment(building, network))
    return there


class _PointRecord(Struct, frozen=True):
    offset: tuple[float, ...]
    chi2: float
    probability: float
    outlier: bool


class _AlignmentRecord(Struct, frozen=True):
    frame: str
    map_id: str
    frame_from_map: PoseRecord
    covariance: tuple[float, ...]
    points: dict[str, _PointRecord]
    missing: tuple[str, ...]
    format: str = FORMAT


def encode_alignment(building: Building, network: Network) -> bytes:
    """The bytes of alignment.json."""
    residuals = building.laying.residuals if building.laying else ()
    points = {
        one.name: _PointRecord(
            tuple(one.offset_m.tolist()), one.chi2, one.probability, one.is_outlier
        )
        for one in residuals
    }
    record = _AlignmentRecord(
        building.frame,
        network.map_id,
        PoseRecord.of(building.frame_from_map),
        tuple(building.covariance.reshape(-1).tolist()),
        points,
        building.missing,
    )
    return msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n"


def _position(point: PointConfig, plan: FloorPlan | None) -> Array:
    if point.position is not None:
        return np.array(point.position)
    if plan is None or point.pixel is None:
        raise InputError("a surveyed point is a pixel of the plan, which is not there; give it")
    return plan.position(point.pixel)


def _place(network: Network, name: str) -> Array:
    record = network.cameras[name].map_from_camera
    assert record is not None  # it is located
    return np.array(record.translation)


def _marks(config: MapConfig, trajectories: Trajectories) -> dict[str, Array]:
    """Where each mark is in the map: where its robot was at that moment."""
    places = {}
    for name, point in config.points.items():
        stamps_ns, poses = trajectories.get(point.robot or "", (np.empty(0, np.int64), None))
        if poses is None or not len(stamps_ns):
            continue
        number = int(np.searchsorted(stamps_ns, stamps_ns[0] + round(1e9 * point.at)))
        if number < len(stamps_ns):
            places[name] = poses.translation[number]
    return places


def _rows(network: Network, names: Sequence[str]) -> dict[int, int]:
    """Number of a point -> its camera's first row in the joint covariance; marks have none: how
    well the robot's place there is known is left to the mark's sigma."""
    located = network.located
    return {i: 6 * located.index(name) for i, name in enumerate(names) if name in located}


def _carried_joint(building: Building, network: Network, joint: Array) -> Array:
    """By a camera's own error, and by the transform's, which comes in part of the same cameras."""
    names = network.located
    turn = np.kron(np.eye(2 * len(names)), building.frame_from_map.rotation)
    laying = building.laying
    if laying is None or not names:
        return symmetric(turn @ joint @ turn.T)
    moved = np.concatenate([_derivative(building, _place(network, name)) for name in names])
    by_errors = turn
    rows = _rows(network, [one.name for one in laying.residuals])
    for i, first in rows.items():
        by_errors[:, first : first + 3] += moved @ laying.gains[i]
    return symmetric(by_errors @ joint @ by_errors.T + moved @ laying.survey_covariance @ moved.T)


def _derivative(building: Building, place: Array) -> Array:
    """(6, 6): a camera's disturbance by the transform's: δt + δθ × R p, δθ."""
    derivative = np.eye(6)
    derivative[:3, 3:] = -hat(building.frame_from_map.rotation @ place)
    return derivative


def _carried_pose(building: Building, record: PoseRecord | None) -> PoseRecord | None:
    return None if record is None else PoseRecord.of(building.frame_from_map @ record.pose)


def _carried_one(building: Building, record: _Placed) -> _Placed:
    """An earlier or another place of a camera, to which the transform's error is added as if the
    two had nothing to do with each other."""
    covariance = np.array(record.covariance).reshape(6, 6)
    derivative = _derivative(building, np.array(record.map_from_camera.translation))
    covariance = carried_covariance(building.frame_from_map, covariance)
    covariance = covariance + derivative @ building.covariance @ derivative.T
    return msgspec.structs.replace(
        record,
        map_from_camera=PoseRecord.of(building.frame_from_map @ record.map_from_camera.pose),
        covariance=tuple(covariance.reshape(-1).tolist()),
    )
