"""Moves that cameras noticed themselves, by their backgrounds."""

from collections.abc import Iterable

from trigpoint.contract.messages import Diagnostics
from trigpoint.contract.nudge import nudges_in
from trigpoint.fusion.model.dataset import CameraMove, DataSet


class Nudges:
    """Which cameras told that they were moved, and are not located again. `is_fixed`: nothing
    locates them, since the map is held."""

    def __init__(self, data: DataSet, *, is_fixed: bool) -> None:
        self._data, self._is_fixed = data, is_fixed
        self._located = frozenset[str]()

    @property
    def open(self) -> dict[str, str]:
        """Such a camera -> what is to be said of it."""
        told = {move.camera for move in self._data.told}
        return {name: self.words(name) for name in told - self._located}

    def words(self, camera: str) -> str:
        """What is said of a camera that was moved and is not located again."""
        until = "the map is learnt anew" if self._is_fixed else "a robot has driven past it"
        return (
            f"camera {camera} was turned or shifted, as its pictures show, and makes no "
            f"corrections until {until}"
        )

    def locate(self, cameras: Iterable[str]) -> None:
        """Take which cameras are located now."""
        self._located = frozenset(cameras)

    def new_in(self, message: Diagnostics) -> list[CameraMove]:
        """The moves of the site's cameras that diagnostics tell of and that are new. What was
        before the map began does not concern it: an agent tells of its last one for as long as it
        runs."""
        moves = [
            CameraMove(nudge.camera, nudge.until_ns, nudge.since_ns)
            for nudge in nudges_in(message)
            if nudge.camera in self._data.site.cameras
        ]
        new = [each for each in moves if each not in self._data.told and not self._is_before(each)]
        self._located -= {move.camera for move in new}
        return new

    def _is_before(self, move: CameraMove) -> bool:
        settled_ns = self._data.settled_ns
        return move.since_ns < settled_ns if settled_ns else not self._data.known.poses
