"""The command `edge`."""

from contextlib import ExitStack
from typing import Annotated

import cv2
import typer

from trigpoint.contract.access import Kind
from trigpoint.metrics.serving import metrics_served
from trigpoint.node.node import Node, stop_on_signals
from trigpoint.node.watchdog import Watchdog
from trigpoint.site.config import load_site
from trigpoint.site.option import SITE_FILE, MetricsAt, SiteFile
from trigpoint.zenoh import open_bus

from .node import KIND, EdgeNode, load_targets
from .sources.opencv_log import quieten_opencv

_LOOK_S = 0.1


def main(
    camera: Annotated[
        list[str], typer.Option(help="A camera's name in the site file; may be given again.")
    ],
    site: SiteFile = SITE_FILE,
    metrics: MetricsAt = "",
) -> None:
    """The agent of one or several cameras: finds the robots' targets in their pictures."""
    loaded = load_site(site)
    targets = load_targets(loaded)
    names = list(dict.fromkeys(camera))
    # A wrong name, or two names for one device, is told before anything is opened.
    loaded.check_one_machine(cameras=names)
    # The cameras of an agent share the cores by their own threads; OpenCV's would fight for them.
    cv2.setNumThreads(1)
    quieten_opencv()
    with ExitStack() as stack:
        # In a secured site each camera shows its own certificate, in a session that ends with it.
        shared = None if loaded.bus.tls else stack.enter_context(open_bus(loaded))
        lives = [stack.enter_context(ExitStack()) for _ in names]
        buses = [
            shared or life.enter_context(open_bus(loaded, (Kind.CAMERA, name)))
            for name, life in zip(names, lives, strict=True)
        ]
        watchdog = Watchdog()
        nodes = [
            Node(bus, site=loaded.name, kind=KIND, name=name, watchdog=watchdog)
            for bus, name in zip(buses, names, strict=True)
        ]
        agents = [
            EdgeNode(bus, node, loaded, name, targets)
            for bus, node, name in zip(buses, nodes, names, strict=True)
        ]
        stop_on_signals(nodes)
        stack.enter_context(metrics_served(loaded, metrics, nodes))
        for node, agent, life in zip(nodes, agents, lives, strict=True):
            life.enter_context(node)
            agent.start()
        stack.callback(lambda: [node.stop() for node in nodes])
        _wait_for_all(nodes, lives)


def _wait_for_all(nodes: list[Node], lives: list[ExitStack]) -> None:
    """Return when every node has ended, each of which is gone once its source is over; raise what
    ended one of them. `nodes` keeps those that run."""
    while nodes:
        for node, life in list(zip(nodes, lives, strict=True)):
            if node.stopping.wait(_LOOK_S / len(nodes)):
                node.wait()
                life.close()
                nodes.remove(node)
                lives.remove(life)
