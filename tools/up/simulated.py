"""A site with a simulated robot, where there is none yet: the lab's, with cameras that see it.

A robot that is not there is seen by no real camera, so that the lab's own cameras (`sim://`) come
with it; the real cameras of this machine run beside them.
"""

import time
from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import InputError, writing
from trigpoint.site.config import CameraConfig, Site
from trigpoint.site.toml_file import said_of
from trigpoint.tools.parts.specs import firmware
from trigpoint.tools.parts.supervisor import PartSpec
from trigpoint.tools.simulation.site_files import robot_port, write_site
from trigpoint.tools.simulation.world import World, load_world

_SITE, _WORLD, _SEED, _TARGET = "simulated", "lab", 0, "charuco"
_LEAD_S = 10.0
"""From here to the world's start. With the seconds that the robot stands then, the parts have more
than what fusion took to come up beside the others on two busy cores (12 s)."""
_MARKER = "truth.json"
_CHECKPOINT = Path("network/checkpoint.bin")
"""Fusion's: of a world that has ended it would go on with a map that is no more."""


class Simulated(Struct, frozen=True):
    """What was written, and the robot's name and process. It drives for `seconds`, then stands."""

    site: Path
    robot: str
    firmware: PartSpec
    seconds: float


def simulated_site(folder: Path, real: Site | None, cameras: Sequence[str]) -> Simulated:
    """Write the site into a folder; `cameras` of a `real` site come along.

    Raises InputError where another site's files lie there, OperationError where nothing can be
    written.
    """
    if (folder / "site.toml").exists() and not (folder / _MARKER).exists():
        raise InputError(f"{folder} has a site of its own, which is not simulated; give --out DIR")
    epoch_ns = time.time_ns() + to_ns(_LEAD_S)
    world = load_world(_WORLD, seed=_SEED, target=_TARGET)
    robot = world.first_robot
    with writing(folder):
        (folder / _CHECKPOINT).unlink(missing_ok=True)
        site = write_site(
            world,
            folder,
            epoch_ns=epoch_ns,
            name=_SITE,
            more_cameras={} if real is None else _own_cameras(world, real, cameras),
        )
    link = folder.absolute() / robot_port(robot)
    world_of = {"world": _WORLD, "seed": _SEED, "target": _TARGET}
    robots = firmware(robot, epoch_ns=epoch_ns, link=link, stands_s=_LEAD_S, **world_of)
    return Simulated(site, robot, robots, world.duration_s)


def _own_cameras(world: World, real: Site, cameras: Sequence[str]) -> dict[str, dict[str, object]]:
    """The tables of real cameras, under names that the world does not have."""
    return {
        f"own_{name}" if name in world.cameras else name: _keys(real, real.camera(name))
        for name in cameras
    }


def _keys(real: Site, camera: CameraConfig) -> dict[str, object]:
    """What differs from the defaults, with its files by their whole paths."""
    keys = said_of(camera)
    if camera.intrinsics is not None and not camera.estimates_intrinsics:
        keys["intrinsics"] = str(real.path(camera.intrinsics).absolute())
    if camera.file is not None:
        rest = camera.source.partition("://")[2]
        keys["source"] = f"{camera.scheme}://{real.path(rest).absolute()}"
    return keys
