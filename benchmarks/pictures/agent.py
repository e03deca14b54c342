"""Pictures played through the whole of an agent; its bus is in memory, and its clock counts its own
work, so that a busy machine gives up no more.

`run`: what eight cameras take of a core, one of them before the robot. `python -m benchmarks shown
FOLDER… --target target.toml`: in which share of its pictures a still is published that is shown
for a second.
"""

import itertools
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import typer

from benchmarks.table import Row, share_of
from benchmarks.timing import WorkClock, worked
from trigpoint.base.clock import Clock, to_ns
from trigpoint.edge.node import EdgeNode
from trigpoint.edge.sources.frames import SOURCES, Frame
from trigpoint.edge.sources.picture_files import pictures_in, read_picture
from trigpoint.geometry import CameraModel
from trigpoint.node.node import Node
from trigpoint.site.config import CameraConfig, parse_site
from trigpoint.site.target import Target, load_target
from trigpoint.testing.memory_bus import MemoryBroker

from .views import gallery

CAMERAS, RATE_HZ, SHOWN = 8, 10.0, 10
_SECONDS = 10
# Different pictures of each camera, played to and fro.
_PICTURES = 24
_CAMERA = """[cameras.{0}]
source = "played://{0}"
width = {1}
height = {2}
rate = {3}
"""
_SITE = 'site = "lab"\ntarget = "t.toml"\n{}[robots.r1]\nport = "loop://"\n'


class PlayedFrames:
    """`played://CAMERA`: frames from memory, as fast as they are taken by the agent's clock."""

    played: ClassVar[dict[str, Iterator[Frame]]] = {}
    lens: ClassVar[CameraModel | None] = None

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        del camera
        self._frames = self.played[url.partition("://")[2]]
        self._clock = clock

    @property
    def intrinsics(self) -> CameraModel | None:
        """The lab's; stills do not tell."""
        return self.lens

    @property
    def skipped(self) -> int:
        """None is; where the machine is slow, the next just comes late."""
        return 0

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """All of them, at the rate of the agent's clock."""
        for frame in self._frames:
            if self._clock.wait(stopping, 1 / RATE_HZ):
                return
            yield frame

    def close(self) -> None:
        """Nothing is held open."""


def played(
    frames: dict[str, Iterator[Frame]], target: Target, size: tuple[int, int]
) -> tuple[float, list[Node]]:
    """Play every camera's frames through an agent; what it worked, seconds, and its nodes."""
    cameras = "".join(_CAMERA.format(name, *size, RATE_HZ) for name in frames)
    site = parse_site(_SITE.format(cameras), directory=Path())
    SOURCES["played"] = f"{__name__}:{PlayedFrames.__name__}"
    PlayedFrames.played = frames

    def through(stack: ExitStack) -> list[Node]:
        bus, nodes = stack.enter_context(MemoryBroker().session()), list[Node]()
        for name in frames:
            node = Node(bus, site=site.name, kind="edge", name=name)
            agent = EdgeNode(bus, node, site, name, [target], clock=WorkClock())
            stack.enter_context(node)
            agent.start()
            nodes.append(node)
        for node in nodes:
            node.wait()
        return nodes

    try:
        with ExitStack() as stack:
            return worked(lambda: through(stack))
    finally:
        del SOURCES["played"]


def run(effort: float = 1.0) -> list[Row]:
    """Both kinds of target; before each of the other cameras a room in which nothing moves, or
    another room in every picture."""
    seconds = share_of(_SECONDS, effort)
    rows = list[Row]()
    for choice in ("charuco", "checkerboard"):
        pictures = gallery(choice)
        other = [view.picture for view in pictures.without_faces(_PICTURES)]
        rows += _rows(choice, "still rooms", pictures.rooms(_PICTURES), seconds)
        rows += _rows(choice, "other rooms in every picture", [other], seconds)
    return rows


def _rows(choice: str, where: str, rooms: list[list[np.ndarray]], seconds: int) -> list[Row]:
    pictures = gallery(choice)
    (before_robot,) = pictures.sequences(1, _PICTURES)
    PlayedFrames.lens = lens = next(iter(pictures.world.cameras.values())).model
    empty = itertools.islice(itertools.cycle(rooms), CAMERAS - 1)
    shown = [[view.picture for _, view in before_robot], *empty]
    frames = {f"c{number}": _to_and_fro(own, seconds) for number, own in enumerate(shown)}
    took, nodes = played(frames, pictures.target, (lens.width, lens.height))
    count = sum(node.health.total("pictures") for node in nodes)
    given_up = sum(node.health.lost("given_up") for node in nodes)
    load = took * CAMERAS * RATE_HZ / count
    what = f"{CAMERAS} cameras at {RATE_HZ:.0f} Hz, {choice}, {where}"
    return [
        Row("agent", f"{what}, of a core", "cores", load, 1.0, "one core"),
        Row("agent", f"{what}, given up", "pictures", given_up, count, "all pictures"),
    ]


def _to_and_fro(own: list[np.ndarray], seconds: int) -> Iterator[Frame]:
    pictures = itertools.cycle([*own, *own[-2:0:-1]])
    for index in range(round(seconds * RATE_HZ)):
        yield Frame(next(pictures), to_ns((1 + index) / RATE_HZ))


def _stills(folder: Path, size: tuple[int, int]) -> Iterator[Frame]:
    """Every picture of a folder for its second, cut to (width, height)."""
    for number, file in enumerate(pictures_in(folder)):
        picture = np.ascontiguousarray(read_picture(file)[: size[1], : size[0]])
        for again in range(SHOWN):
            yield Frame(picture, to_ns((1 + SHOWN * number + again) / RATE_HZ))


def main(
    folders: Annotated[list[Path], typer.Argument(help="Each a camera's pictures.")],
    target: Annotated[Path, typer.Option(help="The target in them: one face in each picture.")],
) -> list[Row]:
    """Play folders of stills through an agent."""
    rows = list[Row]()
    for folder in folders:
        shapes = [read_picture(file).shape[:2] for file in pictures_in(folder)]
        height, width = np.min(shapes, axis=0).tolist()
        frames = {"c1": _stills(folder, (width, height))}
        _, [node] = played(frames, load_target(target), (width, height))
        pictures, faces = node.health.total("pictures"), node.health.total("faces")
        given_up, name = node.health.lost("given_up"), folder.name
        rows += [
            Row("shown", f"{name}, published", "faces", faces, pictures, "all pictures", True),
            Row("shown", f"{name}, given up in part", "pictures", given_up, pictures, "all"),
        ]
    return rows
