"""The command `robot`."""

from typing import Annotated

import typer

from trigpoint.contract.access import Kind
from trigpoint.metrics.serving import metrics_served
from trigpoint.node.node import Node, stopped_by_signals
from trigpoint.site.config import ROS2_PROTOCOL, load_site
from trigpoint.site.option import SITE_FILE, MetricsAt, SiteFile
from trigpoint.zenoh import open_bus

from .dry_run import look
from .line.protocol import check_protocol
from .node import KIND, RobotNode
from .ros2 import RosRobotNode

# How long a dry run waits for a bus that it can do without.
_LOOK_S = 1.0


def main(
    robot: Annotated[str, typer.Option(help="The robot's name in the site file.")],
    site: SiteFile = SITE_FILE,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Only look: say for five seconds what the robot sends and what it would be sent. "
            "Nothing goes to the bus, and to the robot only the questions who it is and what its "
            "clock reads.",
        ),
    ] = False,
    metrics: MetricsAt = "",
) -> None:
    """The serial bridge of one robot: odometry from its port to the bus, corrections back."""
    loaded = load_site(site)
    check_protocol(loaded.robot(robot))  # a wrong name is told before anything is opened
    if dry_run:
        look(loaded, robot, typer.echo, open_bus=lambda one: open_bus(one, patience_s=_LOOK_S))
        return
    with open_bus(loaded, (Kind.ROBOT, robot)) as bus:
        node = Node(bus, site=loaded.name, kind=KIND, name=robot)
        with metrics_served(loaded, metrics, [node]), stopped_by_signals(node):
            is_ros = loaded.robot(robot).protocol_name == ROS2_PROTOCOL
            (RosRobotNode if is_ros else RobotNode)(bus, node, loaded, robot).start()
            node.wait()
