"""A drawn session as a folder by the contract: recording, site and target files, truth."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from trigpoint.contract import topics
from trigpoint.contract.messages import CameraInfo, Message, Odometry
from trigpoint.geometry import Pose
from trigpoint.map.network import PoseRecord, encode_tum
from trigpoint.site.target import Target
from trigpoint.site.toml_file import toml_table
from trigpoint.tools.shapes.text import target_text
from trigpoint.tools.simulation.session import EPOCH_NS, write_recording

from .ride import STEP_S, told_noise
from .room import CENTRE_SPREAD, DISTORTION_SPREAD, FOCAL_SPREAD, Camera
from .session import MOUNT_M, MOUNT_RAD, Composition
from .views import Labelled, Picture, shifted

SITE = "lab"


def write_composition(session: Composition, folder: Path) -> Path:
    """Write session.mcap, site.toml, the targets, truth.json and true trajectories; return the
    session's folder. Raises OperationError where there is a session already."""
    directory = folder / session.name

    def write_files() -> list[Path]:
        names = _write_inputs(session, directory)
        _write_truth(session, directory)
        return [directory / name for name in names]

    items = (
        (EPOCH_NS + at_ns, _topic(message), node, message)
        for at_ns, node, message in session.messages()
    )
    write_recording(directory, SITE, write_files, items)
    return directory


def _topic(message: Message) -> topics.Topic:
    if isinstance(message, Odometry):
        return topics.ODOMETRY
    return topics.CAMERA_INFO if isinstance(message, CameraInfo) else topics.SIGHTINGS


def _write_inputs(session: Composition, directory: Path) -> list[str]:
    """Write site.toml and the target files; their names."""
    targets = _target_files(session)
    (directory / "site.toml").write_text(site_text(session), encoding="utf-8")
    for name, target in targets.items():
        (directory / name).write_text(target_text(target), encoding="utf-8")
    return ["site.toml", *targets]


def _target_files(session: Composition) -> dict[str, Target]:
    told = {carrier.name: carrier.told for carrier in session.carriers}
    first = session.carriers[0]
    if len({target.name for target in told.values()}) == 1:
        return {"target.toml": first.told}
    own = {f"{name}_target.toml": target for name, target in told.items() if name != first.name}
    return {"target.toml": first.told} | own


def site_text(session: Composition) -> str:
    """What the site file says."""
    recipe = session.recipe
    tables: dict[str, dict[str, Any]] = {}
    for camera in session.cameras:
        tables[f"cameras.{camera.name}"] = _camera_keys(session, camera)
    noise = structs.asdict(told_noise(recipe))
    always = ("distance", "lateral", "heading_drive", "heading_turn")
    files = list(_target_files(session))
    for index, carrier in enumerate(session.carriers):
        own = {"target": files[index]} if len(files) > 1 else {}
        tables[f"robots.{carrier.name}"] = {"port": "loop://", **own}
        if recipe.in_space:
            tables[f"robots.{carrier.name}"]["planar"] = False
        said = {key: value for key, value in noise.items() if key in always or value}
        tables[f"robots.{carrier.name}.odometry"] = said
    mount = {"target_translation": MOUNT_M, "target_rotation": MOUNT_RAD} if recipe.mount else {}
    tables["fusion"] = mount
    lines = [f'site = "{SITE}"', 'target = "target.toml"', ""]
    lines += [line for name, values in tables.items() for line in toml_table(name, values)]
    return "\n".join(lines)


def _camera_keys(session: Composition, camera: Camera) -> dict[str, Any]:
    recipe = session.recipe
    keys: dict[str, Any] = {
        "source": "dir://none",
        "width": camera.model.width,
        "height": camera.model.height,
    }
    if recipe.lens_spread:
        keys["intrinsics"] = "estimate"
        if recipe.seed % 2:  # the others keep the wide defaults
            keys |= {
                "focal_sigma": FOCAL_SPREAD,
                "centre_sigma": CENTRE_SPREAD,
                "distortion_sigma": DISTORTION_SPREAD,
            }
    if recipe.time_offset_s:
        keys["time_offset_sigma"] = recipe.time_offset_s
    return keys


def _write_truth(session: Composition, directory: Path) -> None:
    trajectories = {}
    for carrier in session.carriers:
        stamps_ns, _ = session.odometry(carrier.name)
        index = np.round(stamps_ns / 1e9 / STEP_S).astype(int)
        rows = encode_tum(stamps_ns + EPOCH_NS, carrier.ride.map_from_base[index])
        trajectories[carrier.name] = f"{carrier.name}_truth.tum"
        (directory / trajectories[carrier.name]).write_bytes(rows)
    truth = truth_of(session) | {"robots": trajectories}
    text = json.dumps(truth, indent=1) + "\n"
    (directory / "truth.json").write_text(text, encoding="utf-8")


def truth_of(session: Composition) -> dict[str, Any]:
    """What happened. `cameras`: where each hung when it last had a sighting that is not wrong as a
    whole; `moves`: when a camera was moved, and where it hung before; `lifts`: when a robot was."""
    what = session.recipe.what
    return {
        "what": what | {"alike": session.recipe.is_alike},
        "cameras": {name: _told(pose) for name, pose in session.last_places().items()},
        "time_offsets": {c.name: round(c.time_offset_s, 9) for c in session.cameras},
        "moves": {
            camera.name: [
                {"at": _stamp(m.at_s), "before": _told(camera.pose_at(m.at_s - STEP_S))}
                for m in camera.moves
            ]
            for camera in session.cameras
            if camera.moves
        },
        "lifts": {
            carrier.name: [_stamp(at_s) for at_s in carrier.ride.lifts_s]
            for carrier in session.carriers
            if carrier.ride.lifts_s
        },
        "sightings": {
            camera.name: [
                _sighting(camera, picture, face)
                for picture in session.pictures[camera.name]
                for face in picture.faces
            ]
            for camera in session.cameras
            if session.pictures[camera.name]
        },
    }


def _sighting(camera: Camera, picture: Picture, face: Labelled) -> dict[str, Any]:
    stamp_ns = EPOCH_NS + shifted(picture, camera.time_offset_s)
    said: dict[str, Any] = {"stamp": stamp_ns / 1e9, "face": face.face}
    if face.robot != "r1":
        said["robot"] = face.robot
    marks = {
        "turned": face.is_turned,
        "displaced": face.is_displaced,
        "misnamed": face.is_misnamed,
        "wild": face.wild,
    }
    return said | {mark: value for mark, value in marks.items() if value}


def _told(pose: Pose) -> dict[str, Any]:
    return structs.asdict(PoseRecord.of(pose))


def _stamp(t_s: float) -> float:
    return round(EPOCH_NS / 1e9 + t_s, 6)
