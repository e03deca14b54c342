"""Takes the messages of a recording, or of a checkpoint, through a pipeline."""

from collections.abc import Iterable

from trigpoint.contract.messages import Message, Odometry

from .pipeline import Pipeline


class Replay:
    """Messages in order, through a pipeline that is not live. It works as though at each reading
    of odometry, but only where that has anything to do. Nothing is sent, and the end is left to
    `finish` or `resumed`."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._has_more = False  # than odometry, since the pipeline was last at work

    def take(self, node: str, message: Message) -> None:
        """Take the next message of a camera or robot."""
        self._pipeline.push(node, message)
        if not isinstance(message, Odometry):
            self._has_more = True
        elif self._has_more or self._pipeline.waits_for(node):
            self._pipeline.advance()
            self._has_more = False


def replayed(pipeline: Pipeline, messages: Iterable[tuple[str, Message]]) -> Pipeline:
    """The pipeline after the messages of nodes in this order."""
    replay = Replay(pipeline)
    for node, message in messages:
        replay.take(node, message)
    return pipeline
