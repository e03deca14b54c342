"""Takes the messages of a recording through a pipeline."""

from collections.abc import Iterable

from trigpoint.contract.messages import Message, Odometry

from .pipeline import Pipeline


def replayed(pipeline: Pipeline, messages: Iterable[tuple[str, Message]]) -> Pipeline:
    """The pipeline after the messages of nodes in this order, at work at each reading of odometry;
    nothing is sent, and the end is left to its `finish`."""
    for node, message in messages:
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            pipeline.advance()
    return pipeline
