"""What an agent of eight cameras takes of a core: pictures of the drive, one camera before the
robot, through the whole of each edge node; the bus is in memory."""

import itertools
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import ClassVar

from benchmarks.table import Row, share_of
from benchmarks.timing import WorkClock, worked
from trigpoint.base.clock import Clock, to_ns
from trigpoint.edge.node import EdgeNode
from trigpoint.edge.sources.frames import SOURCES, Frame
from trigpoint.geometry import CameraModel
from trigpoint.node.node import Node
from trigpoint.site.config import CameraConfig, Site, parse_site
from trigpoint.testing.memory_bus import MemoryBroker

from .detection import one_thread
from .views import gallery

CAMERAS, RATE_HZ = 8, 10.0
_SECONDS = 10
# Different pictures of each camera, played to and fro.
_PICTURES = 24


class PlayedFrames:
    """`played://CAMERA`: pictures from memory, `RATE_HZ` a second by their stamps and the clock."""

    pictures: ClassVar[dict[str, Iterator[Frame]]] = {}
    lens: ClassVar[CameraModel]

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        del camera
        self._frames = self.pictures[url.partition("://")[2]]
        self._clock = clock

    @property
    def intrinsics(self) -> CameraModel:
        """The lab's."""
        return self.lens

    @property
    def skipped(self) -> int:
        """None is; where the machine is slow, the next just comes late."""
        return 0

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """All pictures, at the rate or as fast as they are taken."""
        for frame in self._frames:
            if self._clock.wait(stopping, 1 / RATE_HZ):
                return
            yield frame

    def close(self) -> None:
        """Nothing is held open."""


def run(effort: float = 1.0) -> list[Row]:
    """Both kinds of target."""
    seconds = share_of(_SECONDS, effort)
    with one_thread():
        return [row for target in ("charuco", "checkerboard") for row in _rows(target, seconds)]


def _rows(target: str, seconds: int) -> list[Row]:
    with ExitStack() as stack:
        stack.enter_context(_played(target, seconds))
        took, nodes = worked(lambda: _agent(stack, target))
    pictures = sum(node.health.total("pictures") for node in nodes)
    given_up = sum(node.health.lost("given_up") for node in nodes)
    load = took * CAMERAS * RATE_HZ / pictures
    what = f"{CAMERAS} cameras at {RATE_HZ:.0f} Hz, {target}"
    return [
        Row("agent", f"{what}, of a core", "cores", load, 1.0, "one core"),
        Row("agent", f"{what}, given up", "pictures", given_up, pictures, "all pictures"),
    ]


def _played(target: str, seconds: int) -> ExitStack:
    """The pictures of every camera under `played://`, until it is closed."""
    pictures, stack = gallery(target), ExitStack()
    (before_robot,) = pictures.sequences(1, _PICTURES)
    PlayedFrames.lens = next(iter(pictures.world.cameras.values())).model
    shown = [[view.picture for _, view in before_robot]]
    empty = [view.picture for view in pictures.without_faces(_PICTURES)]
    shown += [empty] * (CAMERAS - 1)
    for number, own in enumerate(shown):
        to_and_fro = itertools.cycle([*own, *own[-2:0:-1]])
        PlayedFrames.pictures[f"c{number}"] = (
            Frame(next(to_and_fro), to_ns((1 + index) / RATE_HZ))
            for index in range(round(seconds * RATE_HZ))
        )
    SOURCES["played"] = f"{__name__}:{PlayedFrames.__name__}"
    stack.callback(SOURCES.pop, "played")
    return stack


def _agent(stack: ExitStack, target: str) -> list[Node]:
    """The agent's nodes, after all pictures went through them."""
    bus = stack.enter_context(MemoryBroker().session())
    site, nodes = _site(), list[Node]()
    for name in site.cameras:
        node = Node(bus, site=site.name, kind="edge", name=name)
        agent = EdgeNode(bus, node, site, name, [gallery(target).target], clock=WorkClock())
        stack.enter_context(node)
        agent.start()
        nodes.append(node)
    for node in nodes:
        node.wait()
    return nodes


def _site() -> Site:
    cameras = "\n".join(
        f'[cameras.c{number}]\nsource = "played://c{number}"\nrate = {RATE_HZ}'
        for number in range(CAMERAS)
    )
    text = f'site = "lab"\ntarget = "t.toml"\n{cameras}\n[robots.r1]\nport = "loop://"\n'
    return parse_site(text, directory=Path())
