"""Takes the messages of a recording, or of a checkpoint, through a pipeline."""

from collections.abc import Iterable

from trigpoint.contract.messages import Diagnostics, Message, Odometry

from .model.readings import Readings
from .pipeline import Pipeline


class Replay:
    """Messages in order, through a pipeline that is not live. It works as though at each reading
    of odometry, but only where that has anything to do; readings between are taken at once, by the
    next message that is none, or by `flush`. Nothing is sent, and the end is left to `finish` or
    `resumed`."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._has_more = False  # than odometry, since the pipeline was last at work
        self._put_off: dict[str, list[Readings]] = {}

    def take(self, node: str, message: Message | Readings) -> None:
        """Take the next message of a camera or robot, or some of a robot's odometry."""
        if isinstance(message, Odometry):
            self._pipeline.arrivals.add(node, message)
            message = Readings.of([message])
        if isinstance(message, Readings):
            self._take_readings(node, message)
            return
        self.flush()
        self._pipeline.push(node, message)
        self._has_more = True

    def take_moves(self, message: Diagnostics) -> None:
        """Take only that cameras were moved: what is said of clocks is of its moment."""
        self.flush()
        self._pipeline.push_moves(message)
        self._has_more = True

    def flush(self) -> None:
        """Take the readings that were put off."""
        for robot, runs in self._put_off.items():
            self._pipeline.push_readings(robot, Readings.joined(runs))
        self._put_off.clear()

    def _take_readings(self, robot: str, readings: Readings) -> None:
        """One after the other while there is anything to do, and the rest is put off."""
        row = 0
        while row < len(readings) and self._has_work(robot):
            self.flush()
            self._pipeline.push_readings(robot, readings[row : row + 1])
            self._work(robot)
            row += 1
        if row < len(readings):
            self._put_off.setdefault(robot, []).append(readings[row:])

    def _has_work(self, robot: str) -> bool:
        """Whether a reading of a robot's odometry has anything to do."""
        return self._has_more or self._pipeline.waits_for(robot)

    def _work(self, robot: str) -> None:
        if self._has_work(robot):
            self._pipeline.advance()
            self._has_more = False


def replayed(pipeline: Pipeline, messages: Iterable[tuple[str, Message | Readings]]) -> Pipeline:
    """The pipeline after the messages of nodes in this order."""
    replay = Replay(pipeline)
    for node, message in messages:
        replay.take(node, message)
    replay.flush()
    return pipeline
