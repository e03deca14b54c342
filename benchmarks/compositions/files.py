"""A drawn session as a folder by the contract: recording, site and target files, truth."""

from pathlib import Path
from typing import Any

import numpy as np

from trigpoint.contract import topics
from trigpoint.contract.messages import CameraInfo, Message, Odometry
from trigpoint.geometry import Pose
from trigpoint.site.target import Target
from trigpoint.site.toml_file import toml_table
from trigpoint.tools.simulation.session import EPOCH_NS, write_recording
from trigpoint.tools.simulation.site_files import (
    noise_keys,
    target_names,
    write_targets,
    write_truth_of,
)

from .ride import STEP_S, told_noise
from .room import CENTRE_SPREAD, DISTORTION_SPREAD, FOCAL_SPREAD, Camera
from .session import MOUNT_M, MOUNT_RAD, Composition

SITE = "lab"


def write_composition(session: Composition, folder: Path) -> Path:
    """Write session.mcap, site.toml, the targets, truth.json and true trajectories; return the
    session's folder. In truth.json is where each camera hung when it last had a sighting that is
    not wrong as a whole. Raises OperationError where there is a session already."""
    directory = folder / session.name

    def write_files() -> list[Path]:
        (directory / "site.toml").write_text(site_text(session), encoding="utf-8")
        names = write_targets(_targets(session), directory)
        write_truth_of(session.last_places(), _ways(session), directory)
        return [directory / name for name in ("site.toml", *dict.fromkeys(names.values()))]

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


def site_text(session: Composition) -> str:
    """What the site file says."""
    recipe = session.recipe
    tables: dict[str, dict[str, Any]] = {}
    for camera in session.cameras:
        tables[f"cameras.{camera.name}"] = _camera_keys(session, camera)
    noise, names = noise_keys(told_noise(recipe)), target_names(_targets(session))
    for robot, name in names.items():
        tables[f"robots.{robot}"] = {"port": "loop://", "target": name}
        if recipe.in_space:
            tables[f"robots.{robot}"]["planar"] = False
        tables[f"robots.{robot}.odometry"] = noise
    mount = {"target_translation": MOUNT_M, "target_rotation": MOUNT_RAD} if recipe.mount else {}
    tables["fusion"] = mount
    lines = [f'site = "{SITE}"', ""]
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


def _targets(session: Composition) -> dict[str, Target]:
    return {carrier.name: carrier.told for carrier in session.carriers}


def _ways(session: Composition) -> dict[str, tuple[np.ndarray, Pose]]:
    """Each robot's true poses at its odometry's messages."""
    ways = {}
    for carrier in session.carriers:
        stamps_ns, _ = session.odometry(carrier.name)
        index = np.round(stamps_ns / 1e9 / STEP_S).astype(int)
        ways[carrier.name] = stamps_ns + EPOCH_NS, carrier.ride.map_from_base[index]
    return ways
