"""What a run came to: the estimates beside the truth, in numbers. Pure."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.tools.networks.truth import CameraError

PAPER_DISTANCE_ERROR_M = 0.0211
"""Mean error of the distances between cameras that the paper reached with this method."""

_MOST_UNSEEN = 0.03
"""The share of pictures that may go unseen before the figures suffer by it."""

MOST_SIGMAS = 5.0
"""Of three values that are normally distributed, one in 65 000 lies further out than this."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraResult:
    """One camera. `estimate`, `covariance` (6, 6) and `error` only where it is located; `came_by`:
    whether the robot showed it its target long enough; `pictures` that were looked at and how many
    more were `skipped`, None where its agent did not say; `given_up`: how many of those looked at
    took so long that they were searched in part."""

    name: str
    truth: Pose
    status: str
    came_by: bool
    estimate: Pose | None = None
    covariance: Array | None = None
    error: CameraError | None = None
    undetermined: tuple[str, ...] = ()
    sightings: int = 0
    rejected: int = 0
    pictures: int | None = None
    skipped: int | None = None
    given_up: int = 0

    @property
    def is_missed(self) -> bool:
        """Whether it could have been located and was not."""
        return self.came_by and self.error is None

    @property
    def sigma_m(self) -> float:
        """Root of the position covariance's trace: the error's expected size."""
        return self._root_of_trace(0, 3)

    @property
    def sigma_rad(self) -> float:
        """The same of the rotation."""
        return self._root_of_trace(3, 6)

    def _root_of_trace(self, start: int, end: int) -> float:
        assert self.covariance is not None
        return float(np.sqrt(np.trace(self.covariance[start:end, start:end])))


@dataclass(frozen=True, slots=True)
class PairResult:
    """The distance between two cameras: estimated minus true, and its sigma by the covariance."""

    first: str
    second: str
    error_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Track:
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
        """What was up to a moment."""
        kept = self.t_s <= t_s
        return Track(self.t_s[kept], self.places[kept], self.headings[kept])


@dataclass(frozen=True, slots=True)
class FinalError:
    """Where a robot believes to be, beside the truth, at the end."""

    place_m: float
    heading_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class RobotResult:
    """One robot's ways: true; by odometry alone; as fusion said it live; as the robot itself
    believed it, once a second; and as the whole session gives it afterwards.

    `suggestion`: where it was last told to go next."""

    name: str
    truth: Track
    odometry: Track
    live: Track
    believed: Track
    smoothed: Track
    corrections: int = 0
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


@dataclass(frozen=True, slots=True)
class KeyCount:
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
    """What became of the messages of some keys."""

    COMPLETE = "all"
    BROKEN = "NOT ALL"
    UNKNOWN = "a part began anew"
    BEST_EFFORT = "best effort"


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A standard deviation over time: seconds (n,), metres (n,)."""

    name: str
    t_s: Array
    sigma_m: Array


@dataclass(frozen=True, slots=True, eq=False)
class DemoResults:
    """Everything that the table and the report show. `walls`: (n, 2, 2) ends on the floor;
    `covariance`: (6n, 6n) of the located cameras in their order; `mean_distance_error_m`: over all
    pairs of them, None where there is none; `bound_m`: the mean distance error that the
    Cramér-Rao bound of this drive lets one expect, None where it was not worked out; `is_whole`:
    whether the session was not cut shorter or longer than the drive."""

    site: str
    world: str
    seed: int
    target: str
    seconds: float
    cameras: tuple[CameraResult, ...]
    covariance: Array
    mean_distance_error_m: float | None
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
    def pairs(self) -> list[PairResult]:
        """Every pair of located cameras."""
        numbered = enumerate(self.located)
        return [
            _pair(a, b, _position_covariance(self.covariance, i, j))
            for (i, a), (j, b) in itertools.combinations(numbered, 2)
        ]

    @property
    def promised_distance_error_m(self) -> float | None:
        """The mean distance error that the network's own covariance lets one expect.

        The mean of |e| of a normal e is its sigma times √(2/π).
        """
        sigmas = [pair.sigma_m for pair in self.pairs]
        return float(np.sqrt(2 / np.pi) * np.mean(sigmas)) if sigmas else None

    def arrival(self, counts: Sequence[KeyCount]) -> Arrival:
        """What became of the messages of keys of one kind; a part that was started again has
        counted only since then, so numbers that differ say nothing."""
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
            f"camera {camera.name} was missed (it is {camera.status})"
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
            if self.arrival([count]) is Arrival.BROKEN
        ]

    def _refused(self) -> list[str]:
        return [
            f"{node} rejected {number} messages that break the contract (its log says which)"
            for node, number in self.rejected.items()
        ]


def _received(count: KeyCount) -> str:
    received = ", ".join(f"{number} by {part}" for part, number in count.received.items())
    return f"received {received or 'by nobody'}"


def _pair(a: CameraResult, b: CameraResult, covariance: Array) -> PairResult:
    """`covariance`: (6, 6) of both places, a's first."""
    assert a.estimate is not None
    assert b.estimate is not None
    apart = b.estimate.translation - a.estimate.translation
    distance = float(np.linalg.norm(apart))
    gradient = np.concatenate([-apart, apart]) / distance
    true = float(np.linalg.norm(b.truth.translation - a.truth.translation))
    sigma = float(np.sqrt(gradient @ covariance @ gradient))
    return PairResult(a.name, b.name, distance - true, sigma)


def _position_covariance(covariance: Array, i: int, j: int) -> Array:
    """(6, 6) of the places of the cameras number i and j in the joint covariance."""
    rows = [*range(6 * i, 6 * i + 3), *range(6 * j, 6 * j + 3)]
    return covariance[np.ix_(rows, rows)]
