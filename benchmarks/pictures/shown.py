"""A folder of stills as a camera of 10 Hz, each shown for a second, through the whole of an agent:
in which share of its pictures is the board published?

`python -m benchmarks shown FOLDER --target target.toml`
"""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.timing import WorkClock
from trigpoint.base.clock import Clock, to_ns
from trigpoint.edge.node import EdgeNode
from trigpoint.edge.sources.frames import SOURCES, Frame
from trigpoint.edge.sources.picture_files import pictures_in, read_picture
from trigpoint.geometry import CameraModel
from trigpoint.node.node import Node
from trigpoint.site.config import CameraConfig, parse_site
from trigpoint.site.target import Target, load_target
from trigpoint.testing.memory_bus import MemoryBroker

from .detection import one_thread

RATE_HZ, SHOWN = 10.0, 10
_SITE = f"""site = "lab"
target = "t.toml"
[cameras.c]
source = "shown://{{folder}}"
width = {{width}}
height = {{height}}
rate = {RATE_HZ}
[robots.r]
port = "loop://"
"""


class ShownFrames:
    """`shown://FOLDER`: each picture SHOWN times, stamped at the rate, as fast as they are taken;
    those that are larger than the camera's are cut."""

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        del clock
        self._part = np.s_[: camera.height, : camera.width]
        self._files = pictures_in(Path(url.partition("://")[2]))

    @property
    def intrinsics(self) -> CameraModel | None:
        """Stills do not tell."""
        return None

    @property
    def skipped(self) -> int:
        """None is."""
        return 0

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Every picture for its second."""
        for number, file in enumerate(self._files):
            picture = np.ascontiguousarray(read_picture(file)[self._part])
            for again in range(SHOWN):
                if stopping.is_set():
                    return
                yield Frame(picture, to_ns((1 + SHOWN * number + again) / RATE_HZ))

    def close(self) -> None:
        """Nothing is held open."""


def shown(folder: Path, target: Target) -> tuple[int, int, int]:
    """How many pictures went through the agent, how many faces it published, and how many pictures
    it gave up in part. Its clock counts its own work, so that a busy machine gives up no more."""
    SOURCES["shown"] = f"{__name__}:{ShownFrames.__name__}"
    height, width = np.min([read_picture(f).shape[:2] for f in pictures_in(folder)], axis=0)
    text = _SITE.format(folder=folder.resolve(), width=width, height=height)
    site = parse_site(text, directory=Path())
    try:
        with MemoryBroker().session() as bus:
            node = Node(bus, site=site.name, kind="edge", name="c")
            agent = EdgeNode(bus, node, site, "c", [target], clock=WorkClock())
            with node:
                agent.start()
                node.wait()
            health = node.health
            return health.total("pictures"), health.total("faces"), health.lost("given_up")
    finally:
        del SOURCES["shown"]


def main(
    folders: Annotated[list[Path], typer.Argument(help="Each a camera's pictures.")],
    target: Annotated[Path, typer.Option(help="The target in them: one face in each picture.")],
) -> None:
    """Play folders of stills through an agent."""
    with one_thread():
        for folder in folders:
            pictures, faces, given_up = shown(folder, load_target(target))
            typer.echo(
                f"{folder.name}: a face published in {faces} of {pictures} pictures "
                f"({faces / pictures:.3f}), {given_up} given up in part"
            )
