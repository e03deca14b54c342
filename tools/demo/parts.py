"""The processes of a demo: one a part of the system, started as a user would start them."""

from trigpoint.contract.topics import alive_key
from trigpoint.tools.parts.specs import PAGE, firmware, nodes, trigpoint
from trigpoint.tools.parts.supervisor import PartSpec
from trigpoint.tools.simulation.world import World

from .folder import DemoFolder, DemoRecord

_AGENT_PROCESSES = 2


def parts_of(world: World, folder: DemoFolder, record: DemoRecord) -> list[PartSpec]:
    """All parts. The slow ones to start come first."""
    here = DemoFolder(folder.path.resolve())
    specs = nodes(
        str(here.site),
        cameras=list(world.cameras),
        robots=list(world.robots),
        agents=_AGENT_PROCESSES,
        out=str(here.path),
    )
    for robot in world.robots:
        world_of = {"world": record.world, "seed": record.seed, "target": record.target}
        said = {"log": here.journal(robot), "protocol": record.protocol, **world_of}
        specs.append(firmware(robot, epoch_ns=record.epoch_ns, link=here.port(robot), **said))
    return specs


def viewer_of(folder: DemoFolder) -> PartSpec:
    """The live view in a window; it goes when the user closes it."""
    site = str(folder.site.resolve())
    return PartSpec("viewer", trigpoint("view", "--site", site), PAGE, needed=False)


def tokens_of(world: World) -> set[str]:
    alive = [("recorder", "main"), ("fusion", "fusion")]
    alive += [("edge", camera) for camera in world.cameras]
    alive += [("robot", robot) for robot in world.robots]
    return {alive_key(world.site_name, kind, name) for kind, name in alive}
