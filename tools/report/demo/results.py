"""What a run came to: the estimates beside the truth, in numbers. Pure."""

from collections.abc import Sequence
from enum import Enum

import numpy as np
from msgspec import Struct, field

from trigpoint.contract.topics import topic_of
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import CameraRecord, Network
from trigpoint.tools.networks.distances import Distances, distances
from trigpoint.tools.networks.truth import MOST_SIGMAS, CameraError, NetworkError

PAPER_DISTANCE_ERROR_M = 0.0211
"""Mean error of the distances between cameras that the paper reached with this method."""

_MOST_UNSEEN = 0.03
"""The share of pictures that may go unseen before the figures suffer by it."""


class CameraResult(Struct, frozen=True, eq=False):
    """One camera of the network beside the `truth`, `error` only where it is located. `came_by`:
    whether the robot showed it its target long enough; `pictures` that were looked at and how many
    more were `skipped`, None where its agent did not say; `given_up`: how many of those looked at
    took so long that they were searched in part."""

    name: str
    truth: Pose
    record: CameraRecord
    came_by: bool
    error: CameraError | None = None
    pictures: int | None = None
    skipped: int | None = None
    given_up: int = 0

    @property
    def is_missed(self) -> bool:
        """Whether it could have been located and was not."""
        return self.came_by and self.error is None


class Track(Struct, frozen=True, eq=False):
    """A way in the map: seconds since the world's start (n,), metres (n, 2), heading (n,)."""

    t_s: Array
    places: Array
    headings: Array

    @classmethod
    def of(cls, t_s: Array, poses: Pose) -> "Track":
        return cls(t_s, poses.translation[:, :2], poses.heading)

    def at(self, t_s: Array) -> "Track":
        """Interpolated; held at both ends."""
        x, y = (np.interp(t_s, self.t_s, self.places[:, axis]) for axis in (0, 1))
        turned = np.interp(t_s, self.t_s, np.unwrap(self.headings))
        return Track(t_s, np.stack([x, y], axis=-1), turned)

    def until(self, t_s: float) -> "Track":
        kept = self.t_s <= t_s
        return Track(self.t_s[kept], self.places[kept], self.headings[kept])


class FinalError(Struct, frozen=True):
    """Where a robot believes to be, beside the truth, at the end."""

    place_m: float
    heading_rad: float


class RobotResult(Struct, frozen=True, eq=False):
    """One robot's ways: true; by odometry alone; as fusion said it live; as the robot itself
    believed it, once a second; and as the whole session gives it afterwards.

    `suggestion`: where it was last told to go next."""

    name: str
    truth: Track
    odometry: Track
    live: Track
    believed: Track
    smoothed: Track
    suggestion: Pose | None = None

    def final_error(self, track: Track) -> FinalError | None:
        """A way's last row beside the truth; None where it has no row."""
        if not len(track.t_s):
            return None
        true = self.truth.at(track.t_s[-1:])
        turn = track.headings[-1] - true.headings[0]
        return FinalError(
            float(np.linalg.norm(track.places[-1] - true.places[0])),
            float(abs(np.arctan2(np.sin(turn), np.cos(turn)))),
        )


class KeyCount(Struct, frozen=True):
    """The messages of one key: `path` is the key without its site; `sent` None where its sender did
    not say; `received` by each part that takes it, the recorder left out where another does."""

    path: str
    is_reliable: bool
    sent: int | None
    received: dict[str, int]
    recorded: int

    @property
    def is_complete(self) -> bool:
        """Whether everything that was sent arrived everywhere and is recorded."""
        return {self.sent, self.recorded, *self.received.values()} == {self.recorded}


class Arrival(Enum):
    COMPLETE = "all"
    BROKEN = "NOT ALL"
    UNKNOWN = "a part began anew"
    BEST_EFFORT = "best effort"


class KindCount(Struct, frozen=True):
    """The messages of all keys of one row of the contract: `path` with a `*`, how many keys, and
    what came of them all; None where nobody said."""

    path: str
    keys: int
    sent: int | None
    received: int | None
    recorded: int
    arrival: Arrival

    @property
    def numbers(self) -> tuple[str, str, str]:
        """Sent, received and recorded, for people."""
        known = (self.sent, self.received, self.recorded)
        sent, received, recorded = ("–" if number is None else str(number) for number in known)
        return sent, received, recorded


class Series(Struct, frozen=True, eq=False):
    """A standard deviation over time: seconds (n,), metres (n,)."""

    name: str
    t_s: Array
    sigma_m: Array


class DemoResults(Struct, frozen=True, eq=False):
    """Everything that the table and the report show. `covariance`: (6n, 6n) of the network's
    located cameras in their order; `error`: the network against the truth; `walls`: (n, 2, 2) ends
    on the floor; `bound_m`: the mean distance error that the Cramér-Rao bound of this drive lets
    one expect, None where it was not worked out; `is_whole`: whether the session was not cut
    shorter or longer than the drive."""

    world: str
    seed: int
    target: str
    seconds: float
    network: Network
    covariance: Array
    error: NetworkError
    cameras: tuple[CameraResult, ...]
    robots: tuple[RobotResult, ...]
    keys: tuple[KeyCount, ...]
    latencies_s: Array
    series: tuple[Series, ...]
    walls: Array
    restarts: dict[str, int] = field(default_factory=dict)
    rejected: dict[str, int] = field(default_factory=dict)
    bound_m: float | None = None
    is_whole: bool = True

    @property
    def located(self) -> list[CameraResult]:
        return [camera for camera in self.cameras if camera.error is not None]

    @property
    def expected(self) -> list[CameraResult]:
        """The cameras that the robot came by."""
        return [camera for camera in self.cameras if camera.came_by]

    @property
    def overload(self) -> str:
        """That the machine was too busy for the cameras, in words; "" where it was not."""
        skipped = sum(camera.skipped or 0 for camera in self.cameras)
        given_up = sum(camera.given_up for camera in self.cameras)
        made = skipped + sum(camera.pictures or 0 for camera in self.cameras)
        if skipped + given_up <= _MOST_UNSEEN * made:
            return ""
        return (
            f"this machine was too busy for its cameras: of {made} pictures {skipped} were missed "
            f"and {given_up} searched in part, so the cameras are known less well than they might"
        )

    @property
    def distances(self) -> Distances:
        """Between all located cameras."""
        return distances(self.network, self.covariance)

    @property
    def distance_errors_m(self) -> Array:
        """Of those `distances`: estimated minus true (n,)."""
        found, places = self.distances, {c.name: c.truth.translation for c in self.cameras}
        return found.metres - [np.linalg.norm(places[b] - places[a]) for a, b in found.pairs]

    @property
    def kinds(self) -> list[KindCount]:
        """The messages of each row of the contract."""
        groups: dict[str, list[KeyCount]] = {}
        for count in self.keys:
            topic = topic_of(f"site/{count.path}")
            name = topic.path.format(id="*") if topic is not None else count.path
            groups.setdefault(name, []).append(count)
        return [self.counted(name, counts) for name, counts in groups.items()]

    def counted(self, path: str, counts: Sequence[KeyCount]) -> KindCount:
        sent = [count.sent for count in counts if count.sent is not None]
        received = [min(count.received.values()) for count in counts if count.received]
        return KindCount(
            path,
            len(counts),
            sum(sent) if sent else None,
            sum(received) if received else None,
            sum(count.recorded for count in counts),
            self._arrival(counts),
        )

    def _arrival(self, counts: Sequence[KeyCount]) -> Arrival:
        """What became of messages; a part that was started again has counted only since then, so
        numbers that differ say nothing."""
        if not counts[0].is_reliable:
            return Arrival.BEST_EFFORT
        if all(count.is_complete for count in counts):
            return Arrival.COMPLETE
        return Arrival.UNKNOWN if self.restarts else Arrival.BROKEN

    @property
    def failures(self) -> list[str]:
        """Why the run did not do what it should, in words; empty where it did."""
        return [*self._missed(), *self._wrong(), *self._lost(), *self._refused()]

    def _missed(self) -> list[str]:
        return [
            f"camera {camera.name} was missed (it is {camera.record.status})"
            for camera in self.cameras
            if camera.is_missed
        ]

    def _wrong(self) -> list[str]:
        return [
            f"camera {camera.name} is {camera.error.sigmas:.1f} of its sigmas from the truth"
            for camera in self.cameras
            if camera.error is not None and camera.error.sigmas > MOST_SIGMAS
        ]

    def _lost(self) -> list[str]:
        return [
            f"{count.path}: {count.sent} sent, {_received(count)}, {count.recorded} recorded"
            for count in self.keys
            if self._arrival([count]) is Arrival.BROKEN
        ]

    def _refused(self) -> list[str]:
        return [
            f"{node} rejected {number} messages that break the contract (its log says which)"
            for node, number in self.rejected.items()
        ]


def _received(count: KeyCount) -> str:
    received = ", ".join(f"{number} by {part}" for part, number in count.received.items())
    return f"received {received or 'by nobody'}"
