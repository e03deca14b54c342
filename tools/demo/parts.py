"""The processes of a demo: one a part of the system, started as a user would start them."""

import sys
from pathlib import Path

from trigpoint.contract.topics import alive_key
from trigpoint.tools.simulation.world import World

from .folder import DemoFolder, DemoRecord
from .supervisor import PartSpec

AGENTS, BRIDGES, FIRMWARE, RECORDER, FUSION = range(1, 6)
"""Ranks: the cameras' agents first, since a last sighting may still make a correction; then the
bridges and the robots behind them; then the recorder, while fusion can still give it the network;
then fusion."""

_VIEWER = 0
_AGENT_PROCESSES = 2
_FIRMWARE_MODULE = "trigpoint.tools.simulation.serial.firmware"
# -P: a folder in the working directory that is called like a module must not be taken for it.
_PYTHON = (sys.executable, "-P", "-m")


def parts_of(world: World, folder: DemoFolder, record: DemoRecord) -> list[PartSpec]:
    """All parts. The slow ones to start come first."""
    out = str(folder.path.resolve())
    site = ("--site", f"{out}/site.toml")
    return [
        PartSpec("recorder", _trigpoint("record", *site, "--out", out), RECORDER),
        PartSpec("fusion", _trigpoint("fusion", *site, "--out", out), FUSION),
        *(_agent(cameras, site) for cameras in shares(list(world.cameras), _AGENT_PROCESSES)),
        *(_bridge(robot, site) for robot in world.robots),
        *(_firmware(robot, Path(out), record) for robot in world.robots),
    ]


def viewer_of(folder: DemoFolder) -> PartSpec:
    """The live view in a window; it goes when the user closes it."""
    site = str(folder.site.resolve())
    return PartSpec("viewer", _trigpoint("view", "--site", site), _VIEWER, needed=False)


def tokens_of(world: World) -> set[str]:
    """The liveliness tokens of a system that is up."""
    nodes = [("recorder", "main"), ("fusion", "fusion")]
    nodes += [("edge", camera) for camera in world.cameras]
    nodes += [("robot", robot) for robot in world.robots]
    return {alive_key(world.site_name, kind, name) for kind, name in nodes}


def shares(names: list[str], count: int) -> list[list[str]]:
    """Names dealt out like cards, so that neighbours come into different shares."""
    return [share for i in range(count) if (share := names[i::count])]


def _agent(cameras: list[str], site: tuple[str, ...]) -> PartSpec:
    chosen = [word for camera in cameras for word in ("--camera", camera)]
    return PartSpec(f"edge {' '.join(cameras)}", _trigpoint("edge", *site, *chosen), AGENTS)


def _bridge(robot: str, site: tuple[str, ...]) -> PartSpec:
    return PartSpec(f"robot {robot}", _trigpoint("robot", *site, "--robot", robot), BRIDGES)


def _firmware(robot: str, out: Path, record: DemoRecord) -> PartSpec:
    folder = DemoFolder(out)
    options = {
        "--world": record.world,
        "--seed": str(record.seed),
        "--target": record.target,
        "--epoch-ns": str(record.epoch_ns),
        "--robot": robot,
        "--link": str(folder.port(robot)),
        "--log": str(folder.journal(robot)),
        "--protocol": record.protocol,
    }
    words = [word for pair in options.items() for word in pair]
    return PartSpec(f"firmware {robot}", (*_PYTHON, _FIRMWARE_MODULE, *words), FIRMWARE)


def _trigpoint(*words: str) -> tuple[str, ...]:
    return (*_PYTHON, "trigpoint", *words)
