"""A fusion node on a bus in memory, and another session beside it."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from msgspec import Struct, field
from support.builders import eventually
from support.fusion.drives import EPOCH_NS

from trigpoint.base.clock import Clock, ManualClock
from trigpoint.bus.bus import Publisher, Reply, Subscription
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import Message
from trigpoint.contract.topics import Topic
from trigpoint.fusion.fixed.network import FixedNetwork
from trigpoint.fusion.inbox import INPUT_TOPICS
from trigpoint.fusion.live.solver_messages import Solver
from trigpoint.fusion.node import FusionNode
from trigpoint.fusion.pipeline import Inputs
from trigpoint.node.node import Node
from trigpoint.testing.memory_bus import MemoryBroker, MemoryBus

Messages = tuple[tuple[str, Message], ...]


class Running(Struct):
    """`clock`: the node's, unless another one was given; it stands where the sessions begin, so
    that nothing is late."""

    bus: MemoryBus
    node: Node
    fusion: FusionNode
    clock: ManualClock
    sent: int = 0
    _publishers: dict[str, Publisher] = field(default_factory=dict)

    def put(self, messages: Messages) -> None:
        """Publish, each on its node's key."""
        for name, message in messages:
            topic = INPUT_TOPICS[type(message)]
            key = topic.key("lab", name)
            if key not in self._publishers:
                self._publishers[key] = self.bus.publisher(topic, key)
            self._publishers[key].put(cdr.encode(message))
            self.sent += 1

    def feed(self, messages: Messages) -> None:
        """Publish, and wait until all of it was taken."""
        self.put(messages)
        assert eventually(lambda: self.taken() == self.sent, timeout_s=120.0)

    def taken(self) -> int:
        return sum(self.node.health.total(f"received {key}") for key in self._publishers)

    def ask(self, path: str, request: object = None) -> dict:
        """A command's answer."""
        reply = self.reply(path, request)
        assert not reply.error, reply.error
        return json.loads(reply.payload)

    def reply(self, path: str, request: object = None) -> Reply:
        """The same, or a refusal; on a busy machine a checkpoint is read for longer than a command
        waits."""
        payload = b"" if request is None else json.dumps(request).encode()
        replies: list[Reply] = []

        def is_answered() -> bool:
            key = topics.command_key("lab", path)
            replies[:] = self.bus.query(key, payload, timeout_s=60.0)
            return "ask again" not in replies[0].error

        assert eventually(is_answered, timeout_s=60.0)
        [reply] = replies
        return reply

    def keep(self, checkpoint: Path) -> None:
        """Wait until all that was taken is on the disk."""
        self.ask("fusion/map")  # answered between two turns
        size = checkpoint.stat().st_size
        self.clock.advance(0.6)
        assert eventually(lambda: checkpoint.stat().st_size > size)
        self.ask("fusion/map")  # a file grows before all of what is being written is there

    def listen(self, topic: Topic) -> Subscription:
        return self.bus.subscribe(topic, topic.expression("lab"))


@contextmanager
def running(
    inputs: Inputs,
    out: Path,
    *,
    clock: Clock | None = None,
    solver: Callable[[Inputs], Solver] | None = None,
    fixed: FixedNetwork | None = None,
) -> Iterator[Running]:
    """Start a fusion node; at the end it is stopped but not finished, as by a kill."""
    broker, standing = MemoryBroker(), ManualClock(EPOCH_NS)
    with (
        broker.session() as bus,
        broker.session() as other,
        Node(bus, site="lab", kind="fusion", name="fusion") as node,
    ):
        fusion = FusionNode(bus, node, inputs, out, clock or standing, solver=solver, fixed=fixed)
        fusion.start()
        yield Running(other, node, fusion, standing)
