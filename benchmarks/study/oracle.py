"""The bound of a simulated session, from all that its simulator knows."""

import msgspec
import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import (
    Observation,
    Reading,
    base_from_faces,
    observation_of,
    view_of,
)
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.pipeline import Inputs
from trigpoint.geometry import Pose
from trigpoint.tools.networks.cramer_rao import Bound, Oracle, cramer_rao
from trigpoint.tools.simulation.world import Shown

from .in_memory import Simulated


def bound_of(inputs: Inputs, session: Simulated) -> Bound:
    """The bound of the cameras' poses, with an earlier pose of a moved camera as `name@k`."""
    return cramer_rao(*known_to_oracle(inputs, session))


def known_to_oracle(inputs: Inputs, session: Simulated) -> tuple[DataSet, Oracle]:
    """What came in, and the truth of it."""
    data = _data(inputs, session)
    for robot, track in data.tracks.items():
        for node, message in session.messages:
            if node == robot and isinstance(message, Odometry):
                track.add(message.stamp_ns, message.pose)
    world = session.world
    oracle = Oracle(
        cameras=_cameras(session),
        places=_places(data, session),
        scale_errors={name: world.odometry(name).scale_errors for name in world.robots},
        base_from_face={n: base_from_faces(r.carried) for n, r in world.robots.items()},
        lifted_ns={name: session.lifted_ns(name) for name in world.robots},
    )
    return data, oracle


def _data(inputs: Inputs, session: Simulated) -> DataSet:
    """A data set with a camera for each pose that one had, and without what is not true."""
    site, lenses = inputs.site, dict(inputs.lenses)
    cameras = dict(site.cameras)
    for name in inputs.site.cameras:
        for k in range(len(session.moved_ns(name))):
            cameras[f"{name}@{k}"] = cameras[name]
            lenses[f"{name}@{k}"] = lenses[name]
    site = msgspec.structs.replace(site, cameras=cameras)
    # Of a known network what is still true: not the cameras that hang elsewhere by now.
    known = inputs.known.without(lambda _, name: bool(session.world.cameras[name].moves))
    return DataSet(site, inputs.targets, lenses, known)


def _cameras(session: Simulated) -> dict[str, CameraState]:
    cameras = {}
    for name, camera in session.world.cameras.items():
        last = CameraState(session.cameras[name], camera.model, camera.time_offset_s)
        cameras[name] = last
        moves = [move for move in camera.moves if move.at_s > 0]
        for k, move in enumerate(moves):
            before = camera.map_from_camera_at(move.at_s - 1e-6)
            cameras[f"{name}@{k}"] = replace(last, map_from_camera=before)
    return cameras


def _places(data: DataSet, session: Simulated) -> list[tuple[Observation, Pose]]:
    """Every observation that has a good corner, as it is to be read, where the robot stood."""
    places = []
    for (camera, stamp_ns), faces in session.sighted.items():
        true_ns = stamp_ns - to_ns(session.world.cameras[camera].time_offset_s)
        for robot in data.targets:
            track = data.tracks[robot]
            if not track.first_ns <= true_ns <= track.last_ns or track.is_in_gap(true_ns):
                continue
            shown = [face for face in faces if face.robot == robot and face.is_good.any()]
            if shown:
                name = _as_it_hung(session, camera, true_ns)
                observation = _observation(data, name, stamp_ns, shown)
                # A rolling shutter sees it a little before or after the picture's stamp.
                seen_ns = true_ns + observation.stamp_ns - stamp_ns
                pose = session.map_from_base(robot, np.array([seen_ns]))[0]
                places.append((observation, pose))
    return places


def _as_it_hung(session: Simulated, camera: str, true_ns: int) -> str:
    moved_ns = session.moved_ns(camera)
    k = sum(true_ns >= moment for moment in moved_ns)
    return camera if k == len(moved_ns) else f"{camera}@{k}"


def _observation(data: DataSet, name: str, stamp_ns: int, shown: list[Shown]) -> Observation:
    """What a camera saw of one robot, under the name of where it hung."""
    target, camera = data.targets[shown[0].robot], data.site.cameras[name]
    views, readings, outliers = [], [], []
    index = {face.id: i for i, face in enumerate(target.faces)}
    for face in shown:
        view = view_of(target, replace(face.sighting, face=face.face), camera)
        assert view is not None  # it is the face that was simulated
        views.append(view)
        readings.append(Reading(index[face.face], face.is_turned))
        outliers.append(~face.is_good)
    observation = observation_of(name, shown[0].robot, stamp_ns, tuple(views))
    return observation.read_as(tuple(readings)).with_outliers(tuple(outliers))
