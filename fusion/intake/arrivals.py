"""What came of each camera and robot: why a camera of which much came may be unseen all the same.

Pictures and odometry by two clocks show in times that never overlap. Pure: no bus, no clock.
"""

from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime

from msgspec import Struct, structs

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.base.words import counted
from trigpoint.contract.messages import Mended, Message, Odometry, Sightings
from trigpoint.fusion.estimators.unfit_inputs import UnfitInputs
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.readings import Readings
from trigpoint.map.network import Network
from trigpoint.site.config import Site

from .odometry_doubts import OdometryDoubts

# No clock that was ever set shows a time before 1973: it counts from its own start.
_NEVER_SET_NS = to_ns(1e8)

# Pictures of targets that come more rarely, on the whole, are not stamped in seconds.
_LONGEST_PERIOD_S = 100.0
# Time zones are quarters of hours apart, at most 14 hours from UTC.
_ZONE_S, _MOST_ZONES, _BEGIN_S = 900.0, 56, 30.0


class Span(Struct, frozen=True):
    """From the first stamp to the last of `count` messages."""

    first_ns: int
    last_ns: int
    count: int = 1

    def __str__(self) -> str:
        if self.counts_from_start:
            return f"{to_seconds(self.first_ns):.1f} s to {to_seconds(self.last_ns):.1f} s"
        first, last = (
            datetime.fromtimestamp(stamp_ns // 10**9, UTC)
            for stamp_ns in (self.first_ns, self.last_ns)
        )
        return f"{first:%Y-%m-%d %H:%M:%S} to {last:%Y-%m-%d %H:%M:%S} UTC"

    @property
    def counts_from_start(self) -> bool:
        """Whether it is by a simulator's clock, or by one that counts from when it was started."""
        return self.first_ns > -_NEVER_SET_NS and self.last_ns < _NEVER_SET_NS

    @property
    def period_s(self) -> float:
        """From one to the next, in the mean."""
        return to_seconds(self.last_ns - self.first_ns) / self.count

    def with_stamp(self, stamp_ns: int) -> "Span":
        first_ns, last_ns = min(self.first_ns, stamp_ns), max(self.last_ns, stamp_ns)
        return Span(first_ns, last_ns, self.count + 1)

    def apart_ns(self, other: "Span") -> int:
        """How much lies between the two; 0 where they overlap."""
        return max(self.first_ns - other.last_ns, other.first_ns - self.last_ns, 0)


class Arrivals:
    """All messages of the site's cameras and robots. `tracks`: the robots' odometry; `seen`:
    camera -> when it saw a target; `unreadable`: camera -> what is wrong with all that it sent;
    `misdescribed`: camera -> what its pictures show in place of the target file's boards;
    `clocks`: camera -> whose stamps lie otherwise to its own than to the times of recording;
    `unused`: camera -> why pictures of it were left out, as the pipeline says; `odometry`: what is
    odd about that; `unfit`: given lenses, and scales of odometry, that pictures contradict."""

    def __init__(self, site: Site, tracks: Mapping[str, OdometryTrack]) -> None:
        self._tracks = tracks
        self._tolerance_ns = {
            name: to_ns(camera.most_time_offset_s) for name, camera in site.cameras.items()
        }
        self.odometry = OdometryDoubts(site, tracks)
        self._mended = Counter[tuple[str, Mended]]()
        self.seen: dict[str, Span] = {}
        self.unreadable: dict[str, str] = {}
        self.misdescribed: dict[str, str] = {}
        self.clocks: dict[str, str] = {}
        self._exchanged: dict[str, str] = {}
        self.unused: dict[str, str] = {}
        self.unfit = UnfitInputs()

    def add(self, node: str, message: Message) -> None:
        """Note a message of a camera or robot; what a robot's odometry says, by `add_odometry`."""
        if isinstance(message, Odometry | Sightings) and message.mended:
            self._mended.update((node, lack) for lack in message.mended)
        if isinstance(message, Odometry) and _are_exchanged(message):
            self._exchanged[node] = (
                f"robot {node}: its odometry says that it is the pose of {message.child_frame_id} "
                f"in {message.frame_id or '«»'}, and is taken for that of the base in odom; if its "
                "frames are not only named so, give the inverse"
            )
        if isinstance(message, Sightings) and message.faces and node in self._tolerance_ns:
            span, stamp_ns = self.seen.get(node), message.stamp_ns
            self.seen[node] = span.with_stamp(stamp_ns) if span else Span(stamp_ns, stamp_ns)

    def add_odometry(self, robot: str, readings: Readings, *, stale: int) -> None:
        """Note odometry of a robot of the site file, of which so many are no newer than before."""
        self.odometry.add(robot, readings, stale=stale)

    @property
    def notes(self) -> list[str]:
        """What a user should know of it, as text."""
        return [*self.mended, *self.doubts]

    @property
    def mended(self) -> list[str]:
        """What messages lacked, and what was taken in its place."""
        found = self._mended.items()
        return [f"{node}: {counted(count, 'message')} {lack}" for (node, lack), count in found]

    @property
    def doubts(self) -> list[str]:
        """What came and cannot be right, as text."""
        wrong = self.misdescribed.items()
        described = [f"{name}: {words}" for name, words in wrong if name in self.seen]
        apart = self.apart
        clocks = [f"{name}: {words}" for name, words in self.clocks.items() if name not in apart]
        lenses = [
            f"{name}: its pictures do not fit its lens: {lens.words}; calibrate it (trigpoint "
            'intrinsics), or write intrinsics = "estimate"'
            for name, lens in self.unfit.lenses.items()
        ]
        scales = [
            f"robot {name}: what cameras saw fits its odometry only if {each.words}"
            for name, each in self.unfit.scales.items()
        ]
        odometry = [*self.odometry.texts, *self._exchanged.values(), *scales]
        return [*odometry, *described, *clocks, *lenses]

    @property
    def contradicted(self) -> str:
        """Why cameras are not where they seem: clocks that are apart, robots' odometry that they
        contradict, or a target, or lenses that are not theirs; "" where nothing is known against
        that."""
        causes = list[str]()
        if cameras := ", ".join(sorted(self.clocks)):
            causes.append(f"pictures of {cameras} and odometry are stamped by two clocks")
        harmful = [name for name, each in self.unfit.scales.items() if each.is_harmful]
        if robots := ", ".join(sorted({*self.odometry.otherwise, *harmful})):
            causes.append(
                f"what cameras saw contradicts the odometry of {robots} as it is read, or the "
                "target file"
            )
        if any(lens.is_harmful for lens in self.unfit.lenses.values()):
            causes.append(
                "cameras are farther off than their sigmas, since pictures do not fit the lens of "
                f"{', '.join(sorted(self.unfit.lenses))}"
            )
        return "; and ".join(causes)

    @property
    def are_elsewhere(self) -> bool:
        """Whether what contradicts them puts cameras elsewhere by more than is little."""
        unfit = [*self.unfit.scales.values(), *self.unfit.lenses.values()]
        return bool(self.clocks or self.odometry.otherwise) or any(
            each.is_harmful and each.is_far for each in unfit
        )

    @property
    def apart(self) -> dict[str, str]:
        """Camera -> what is wrong and what to do, for those that saw targets only at times from
        which there is no odometry of any robot."""
        tracks = self._tracks.items()
        odometry = {name: Span(t.first_ns, t.last_ns) for name, t in tracks if len(t)}
        found = {}
        for camera, seen in self.seen.items():
            gaps_ns = {robot: seen.apart_ns(span) for robot, span in odometry.items()}
            nearest = min(gaps_ns, key=lambda robot: gaps_ns[robot], default=None)
            if nearest is not None and gaps_ns[nearest] > self._tolerance_ns[camera]:
                found[camera] = _words(seen, nearest, odometry[nearest])
        return found

    def explained(self, network: Network) -> Network:
        """The network with the reason why a camera is unseen that sent much."""
        reasons = {
            name: f"{_saw(seen)}, none of which could be used" for name, seen in self.seen.items()
        }
        reasons |= self.unused | self.apart | self.misdescribed
        reasons |= {
            name: f"nothing of it could be read: {words}" for name, words in self.unreadable.items()
        }
        cameras = dict(network.cameras)
        for name, why in reasons.items():
            if cameras[name].status == "unseen":
                cameras[name] = structs.replace(cameras[name], undetermined=(why,))
        return structs.replace(network, cameras=cameras)


def _saw(seen: Span) -> str:
    return f"it saw a target in {counted(seen.count, 'picture')}"


def _zones_apart(one: Span, other: Span) -> float:
    """By how many hours two begin apart, where that is by time zones; else 0. What is recorded at
    once begins within half a minute."""
    quarters = to_seconds(one.first_ns - other.first_ns) / _ZONE_S
    whole = round(abs(quarters))
    is_by_zones = abs(abs(quarters) - whole) * _ZONE_S < _BEGIN_S and whole <= _MOST_ZONES
    return whole * _ZONE_S / 3600 if is_by_zones else 0.0


def _words(seen: Span, robot: str, odometry: Span) -> str:
    by_start = [
        name
        for name, span in (("pictures", seen), ("odometry", odometry))
        if span.counts_from_start
    ]
    if odometry.first_ns == odometry.last_ns:
        why = "all of the odometry has one stamp; have its driver stamp every message anew"
    elif len(by_start) == 1:
        why = (
            f"the clock of the {by_start[0]} counts from 0, as a simulator's does, or one that was "
            "never set; stamp both by one clock (`use_sim_time` for all nodes or for none)"
        )
    elif seen.period_s > _LONGEST_PERIOD_S:
        why = (
            f"by their stamps these pictures are {seen.period_s:.3g} s apart; are the seconds in "
            "them milli- or nanoseconds?"
        )
    elif zones := _zones_apart(seen, odometry):
        why = (
            f"they begin {zones:g} h apart, as where one is stamped in local time; stamp both in "
            "UTC, or synchronise the clocks (chrony)"
        )
    else:
        why = (
            f"{to_seconds(seen.apart_ns(odometry)):.1f} s lie between them; synchronise the clocks "
            "(chrony), and record both at once"
        )
    return (
        f"{_saw(seen)}, stamped {seen}, and the odometry of {robot} is stamped {odometry}: the two "
        f"never overlap, so no picture can be used; {why}"
    )


def _are_exchanged(odometry: Odometry) -> bool:
    """Whether the frames say that it is the pose of odom in the base; namespaces do not count."""
    frame, child = (
        name.rpartition("/")[2] for name in (odometry.frame_id, odometry.child_frame_id)
    )
    return child == "odom" and frame not in ("odom", "map")
