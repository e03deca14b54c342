"""Takes the messages of a recording, or of a checkpoint, through a pipeline."""

from collections.abc import Iterable

from trigpoint.contract.messages import Message, Odometry

from .pipeline import Pipeline


class Replay:
    """Messages in order, through a pipeline that is not live. It works as though at each reading
    of odometry, but only where that has anything to do; readings between are taken at once, by the
    next message that is none, or by `flush`. Nothing is sent, and the end is left to `finish` or
    `resumed`."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._has_more = False  # than odometry, since the pipeline was last at work
        self._readings: dict[str, list[Odometry]] = {}

    def take(self, node: str, message: Message) -> None:
        """Take the next message of a camera or robot."""
        pipeline = self._pipeline
        is_awaited = self._has_more or pipeline.waits_for(node)
        if isinstance(message, Odometry) and not is_awaited and node in pipeline.site.robots:
            self._readings.setdefault(node, []).append(message)
            return
        self.flush()
        pipeline.push(node, message)
        if not isinstance(message, Odometry):
            self._has_more = True
        elif is_awaited:
            pipeline.advance()
            self._has_more = False

    def flush(self) -> None:
        """Take the readings that were put off."""
        for robot, readings in self._readings.items():
            self._pipeline.push_odometry(robot, readings)
        self._readings.clear()


def replayed(pipeline: Pipeline, messages: Iterable[tuple[str, Message]]) -> Pipeline:
    """The pipeline after the messages of nodes in this order."""
    replay = Replay(pipeline)
    for node, message in messages:
        replay.take(node, message)
    replay.flush()
    return pipeline
