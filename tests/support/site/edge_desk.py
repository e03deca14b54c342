"""A site with one camera whose pictures a test hands over, on a bus in memory."""

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from support.pictures.boards import charuco, picture_of, placed, plain_picture, target_of

from trigpoint.base.clock import Clock
from trigpoint.bus.bus import Subscription
from trigpoint.contract.cdr import decode
from trigpoint.contract.topics import Topic
from trigpoint.edge.node import EdgeNode
from trigpoint.edge.sources import frames as frames_module
from trigpoint.edge.sources.frames import Frame, Unreadable
from trigpoint.geometry import CameraModel
from trigpoint.node.node import Node
from trigpoint.site.config import CameraConfig, parse_site
from trigpoint.site.target import Target
from trigpoint.testing.memory_bus import MemoryBroker

BOARD = charuco()
VIEW = placed(BOARD, distance=0.9, tilt_deg=20)
SEEN, EMPTY = picture_of([VIEW]), plain_picture()

Scripted = tuple[int, np.ndarray] | Frame | Unreadable | Exception | None
"""What a source gives, raises, or of a picture its stamp and itself."""


class ScriptedFrames:
    """A source whose stamps and pictures the test hands over; an exception among them is raised,
    and the next opening goes on behind it. It says that it skipped one picture for each."""

    script: Iterator[Scripted]
    opened = 0
    own_lens: CameraModel | None = None

    def __init__(self, url: str, camera: CameraConfig, *, clock: object) -> None:
        type(self).opened += 1
        self.skipped = 0

    @property
    def intrinsics(self) -> CameraModel | None:
        return self.own_lens

    def frames(self, stopping: threading.Event) -> Iterator[Frame | Unreadable | None]:
        for item in self.script:
            if stopping.is_set():
                return
            if isinstance(item, Exception):
                raise item
            self.skipped += 1
            yield Frame(item[1], item[0]) if isinstance(item, tuple) else item

    def close(self) -> None:
        pass


class Desk:
    """A site with one camera, an agent that is not started yet, and ears on everything it sends."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self._stack, self.folder = stack, folder
        self.broker = MemoryBroker()
        self.bus = stack.enter_context(self.broker.session())

    def listen(self, topic: Topic) -> Subscription:
        return self.bus.subscribe(topic, topic.key("lab", "c1"))

    def start(
        self,
        *pictures: tuple[int, np.ndarray] | Frame | Exception,
        camera: str = "",
        script: Iterator[Scripted] | None = None,
        target: Target | None = None,
        clock: Clock | None = None,
    ) -> Node:
        """Start the agent on these pictures, or on those of a script; at a rate that leaves time
        for all of a picture on a busy machine, unless `camera` says one."""
        ScriptedFrames.script = script or iter(pictures)
        text = f'site = "lab"\ntarget = "t.toml"\n[cameras.c1]\nsource = "script://"\n{camera}\n'
        if not camera.startswith("rate"):
            text += "rate = 0.5\n"
        site = parse_site(text + '[robots.r1]\nport = "loop://"\n', directory=self.folder)
        node = Node(self.bus, site="lab", kind="edge", name="c1", clock=clock)
        agent = EdgeNode(self.bus, node, site, "c1", [target or target_of(BOARD)])
        self._stack.enter_context(node)
        agent.start()
        return node


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    monkeypatch.setattr(frames_module, "source_class", lambda _scheme: ScriptedFrames)
    monkeypatch.setattr(ScriptedFrames, "opened", 0)
    monkeypatch.setattr(ScriptedFrames, "own_lens", None)
    with ExitStack() as stack:
        yield Desk(stack, tmp_path)


def taken(subscription: Subscription) -> list[object]:
    """Everything that came, decoded."""
    messages = []
    while (sample := subscription.take(0.2)) is not None:
        messages.append(decode(sample.encoding.partition(";")[2], sample.payload))
    return messages
