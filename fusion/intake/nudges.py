"""Moves that cameras noticed themselves, by their backgrounds."""

from collections.abc import Iterator

from trigpoint.contract.messages import Diagnostics
from trigpoint.contract.nudge import nudges_in
from trigpoint.fusion.model.dataset import CameraMove, DataSet


def told_moves(data: DataSet, message: Diagnostics) -> Iterator[CameraMove]:
    """The moves of the site's cameras that diagnostics tell of and that are new. What was before
    the map began does not concern it: an agent tells of its last one for as long as it runs."""
    for nudge in nudges_in(message):
        move = CameraMove(nudge.camera, nudge.until_ns, nudge.since_ns)
        is_before = move.since_ns < data.epoch_ns if data.epoch_ns else not data.known.poses
        if nudge.camera in data.site.cameras and move not in data.told and not is_before:
            yield move


def nudged_words(camera: str) -> str:
    """What is said of a camera that was moved and is not located again."""
    return (
        f"camera {camera} was turned or shifted, as its pictures show; it makes no corrections "
        "until a robot has driven past it"
    )
