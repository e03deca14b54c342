"""The processes of a demo: one a part of the system, started as a user would start them."""

from pathlib import Path

from trigpoint.contract.topics import alive_key
from trigpoint.tools.parts.specs import (
    FUSION,
    PAGE,
    RECORDER,
    agent,
    bridge,
    firmware,
    shares,
    trigpoint,
)
from trigpoint.tools.parts.supervisor import PartSpec
from trigpoint.tools.simulation.world import World

from .folder import DemoFolder, DemoRecord

_AGENT_PROCESSES = 2


def parts_of(world: World, folder: DemoFolder, record: DemoRecord) -> list[PartSpec]:
    """All parts. The slow ones to start come first."""
    out = str(folder.path.resolve())
    site = f"{out}/site.toml"
    return [
        PartSpec("recorder", trigpoint("record", "--site", site, "--out", out), RECORDER),
        PartSpec("fusion", trigpoint("fusion", "--site", site, "--out", out), FUSION),
        *(agent(cameras, site) for cameras in shares(list(world.cameras), _AGENT_PROCESSES)),
        *(bridge(robot, site) for robot in world.robots),
        *(_firmware(robot, DemoFolder(Path(out)), record) for robot in world.robots),
    ]


def viewer_of(folder: DemoFolder) -> PartSpec:
    """The live view in a window; it goes when the user closes it."""
    site = str(folder.site.resolve())
    return PartSpec("viewer", trigpoint("view", "--site", site), PAGE, needed=False)


def tokens_of(world: World) -> set[str]:
    """The liveliness tokens of a system that is up."""
    nodes = [("recorder", "main"), ("fusion", "fusion")]
    nodes += [("edge", camera) for camera in world.cameras]
    nodes += [("robot", robot) for robot in world.robots]
    return {alive_key(world.site_name, kind, name) for kind, name in nodes}


def _firmware(robot: str, folder: DemoFolder, record: DemoRecord) -> PartSpec:
    return firmware(
        robot,
        epoch_ns=record.epoch_ns,
        link=folder.port(robot),
        world=record.world,
        seed=record.seed,
        target=record.target,
        log=folder.journal(robot),
        protocol=record.protocol,
    )
