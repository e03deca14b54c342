"""Drives whose odometry, or its times, are not as they should be: what `calibrate` says of them."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.site_files import write_site
from trigpoint.tools.simulation.world import World, load_world

from .bags import STORE, Message, write_mcap
from .case import LOCATED, Case, Kind

ODOM, SIGHTINGS = "nav_msgs/msg/Odometry", "trigpoint_msgs/msg/Sightings"
_EVERY = 5
"""Of the odometry: 10 Hz are enough, and quicker."""


@cache
def _world() -> World:
    """Once around the lab, past one camera."""
    world = load_world("loop", seed=1, target="charuco")
    for name in list(world.cameras)[1:]:
        del world.cameras[name]
    return world


@cache
def drive() -> tuple[tuple[str, int, bytes], ...]:
    """Type, time of recording and bytes of a sound drive's messages."""
    with TemporaryDirectory() as folder:
        write_session(_world(), Path(folder))
        samples = list(open_recording(Path(folder)).samples())
    odometry = [one for one in samples if one.topic.type_name == ODOM][::_EVERY]
    others = [one for one in samples if one.topic.type_name == SIGHTINGS]
    kept = sorted([*odometry, *others], key=lambda one: one.log_ns)
    return tuple((one.topic.type_name, one.log_ns, bytes(one.payload)) for one in kept)


def calibrated(
    folder: Path, change: Callable[[int, Any], None] = lambda _number, _odometry: None
) -> tuple[str | Path, ...]:
    """The words to calibrate the drive as a foreign bag, each odometry message changed before."""
    messages, number = [], 0
    for kind, log_ns, data in drive():
        payload = data
        if kind == ODOM:
            found = STORE.deserialize_cdr(data, ODOM)
            change(number, found)
            payload, number = bytes(STORE.serialize_cdr(found, ODOM)), number + 1
        messages.append(Message("/odom" if kind == ODOM else "/seen", kind, log_ns, payload))
    bag = write_mcap(folder / "bag.mcap", messages)
    site, out = write_site(_world(), folder), folder / "out"
    roles = ("--topic", "c1=/seen", "--topic", "r1=/odom")
    return ("calibrate", bag, "--site", site, "--out", out, *roles)


def stamped(odometry: Any, stamp_ns: int) -> None:
    odometry.header.stamp.sec, odometry.header.stamp.nanosec = divmod(stamp_ns, 10**9)


def two_clocks(folder: Path, random: np.random.Generator) -> Case:
    """Odometry by a simulator's clock, which may not have begun at first, or by one that is years
    or hours off."""
    begin_ns = int(random.choice([0, to_ns(1e3), to_ns(1.6e9), to_ns(1.7e9 - 9e3)]))
    waits = int(random.integers(0, 5))

    def change(number: int, odometry: Any) -> None:
        stamped(odometry, begin_ns + to_ns(0.1 * max(0, number - waits)))

    return Case(calibrated(folder, change), (1,), (r"overlap|clock|sim(ulat\w+)? ?time",))


def overlapping_clocks(folder: Path, random: np.random.Generator) -> Case:
    """Odometry that is seconds off, so that pictures are held against it all the same."""
    by_s = float(random.uniform(2, 9)) * float(random.choice([-1, 1]))

    def change(_number: int, odometry: Any) -> None:
        stamp = odometry.header.stamp
        stamped(odometry, stamp.sec * 10**9 + stamp.nanosec + to_ns(by_s))

    says = (r"\d\.\d s (ahead of|behind) those of c1", "clocks")
    return Case(calibrated(folder, change), (0, 1), says)


def zero_stamps(folder: Path, random: np.random.Generator) -> Case:
    """None, or none but a few, has a stamp: the times of recording are taken, which is said."""
    stamped_ones = int(random.choice([0, 3]))

    def change(number: int, odometry: Any) -> None:
        if number >= stamped_ones:
            stamped(odometry, 0)

    return Case(calibrated(folder, change), (0,), (r"stamp", r"record", LOCATED))


def needless_nan(folder: Path, random: np.random.Generator) -> Case:
    """In a field that nobody needs: all of it is used."""
    part, axis = str(random.choice(["linear", "angular"])), str(random.choice(["x", "y", "z"]))
    every = int(random.choice([1, 7]))

    def change(number: int, odometry: Any) -> None:
        if number % every == 0:
            setattr(getattr(odometry.twist.twist, part), axis, np.nan)

    return Case(calibrated(folder, change), (0,), (LOCATED,))


def quaternion_length(folder: Path, random: np.random.Generator) -> Case:
    """Not 1: its meaning is plain."""
    by = float(random.choice([random.uniform(0.3, 0.95), random.uniform(1.05, 3.0)]))

    def change(_number: int, odometry: Any) -> None:
        turn = odometry.pose.pose.orientation
        turn.x, turn.y, turn.z, turn.w = (by * value for value in (turn.x, turn.y, turn.z, turn.w))

    return Case(calibrated(folder, change), (0,), (LOCATED,))


def unusable_pose(folder: Path, random: np.random.Generator) -> Case:
    """A place or turn that is none in all messages: said, with how many."""
    field = str(random.choice(["position", "orientation"]))
    value = 0.0 if field == "orientation" else float(random.choice([np.nan, np.inf]))

    def change(_number: int, odometry: Any) -> None:
        spoilt = getattr(odometry.pose.pose, field)
        for axis in ("x", "y", "z") if field == "position" else ("x", "y", "z", "w"):
            setattr(spoilt, axis, value)

    count = sum(kind == ODOM for kind, *_ in drive())
    says = (rf"\b{count}\b", r"finite|nan\b|quaternion|length")
    return Case(calibrated(folder, change), (1, 2), says)


def a_few_unusable(folder: Path, random: np.random.Generator) -> Case:
    """Some poses, or stamps, that are none among good ones: left out and counted."""
    every, is_stamp = int(random.integers(20, 60)), bool(random.integers(2))

    def change(number: int, odometry: Any) -> None:
        if number % every == 0 and is_stamp:
            odometry.header.stamp.nanosec += 10**9
        elif number % every == 0:
            odometry.pose.pose.position.x = np.nan

    count = len(range(0, sum(kind == ODOM for kind, *_ in drive()), every))
    return Case(calibrated(folder, change), (0,), (rf"\b{count}\b", LOCATED))


def other_conventions(folder: Path, random: np.random.Generator) -> Case:
    """A quaternion's w first, x and y exchanged, no heading: said, whatever becomes of it."""
    kind = int(random.integers(3))

    def change(_number: int, odometry: Any) -> None:
        pose = odometry.pose.pose
        turn = pose.orientation
        if kind == 0:
            turn.x, turn.y, turn.z, turn.w = turn.w, turn.x, turn.y, turn.z
        elif kind == 1:
            pose.position.x, pose.position.y = pose.position.y, pose.position.x
        else:
            turn.x, turn.y, turn.z, turn.w = 0.0, 0.0, 0.0, 1.0

    says = ("x, y, z, w", "axes", "heading")[kind]
    return Case(calibrated(folder, change), (0, 1), (says,))


def against_the_pictures(folder: Path, random: np.random.Generator) -> Case:
    """Mirrored (NED), in feet, by wheels' diameters, backwards, or one that never moves: the
    pictures alone contradict it."""
    says, change = list(_CONTRADICTED.items())[random.integers(len(_CONTRADICTED))]
    statuses = (0, 1) if says == _STUCK else (1,)
    return Case(calibrated(folder, change), statuses, (says,), never=("put down elsewhere",))


def _by(x: float, y: float, heading: float = 1.0) -> Callable[[int, Any], None]:
    def change(_number: int, odometry: Any) -> None:
        place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
        place.x, place.y, turn.z = x * place.x, y * place.y, heading * turn.z
        turn.w = turn.w if heading else 1.0

    return change


_STUCK = "does not move while cameras see it"
_CONTRADICTED: Mapping[str, Callable[[int, Any], None]] = {
    "mirrored.*NED": _by(1, -1, -1),
    r"told 3\.\d+ times too long .feet": _by(1 / 0.3048, 1 / 0.3048),
    "too long .diameters for radii": _by(2, 2),
    "drove backwards": _by(-1, -1),
    _STUCK: _by(0, 0, 0),
}


def other_units(folder: Path, random: np.random.Generator) -> Case:
    """Lengths in milli- or centimetres or inches, stamps whose seconds are others, or which lack
    the nanoseconds."""
    kind, by = int(random.integers(4)), float(random.choice([39.37, 100, 1000]))

    def change(_number: int, odometry: Any) -> None:
        stamp, place = odometry.header.stamp, odometry.pose.pose.position
        if kind == 0:
            place.x, place.y = by * place.x, by * place.y
        elif kind == 1:
            stamp.nanosec = 0
        else:
            ticks = (stamp.sec * 10**9 + stamp.nanosec) // (10**6, 1)[kind - 2]
            stamp.sec, stamp.nanosec = (ticks + 2**31) % 2**32 - 2**31, 0

    says = ("metres", "nanoseconds", "milli- or nano", "milli- or nano")[kind]
    return Case(calibrated(folder, change), (0, 1) if kind == 1 else (1,), (says,))


ODOMETRY: Mapping[str, Kind] = {
    "two clocks": two_clocks,
    "stamps of zero": zero_stamps,
    "NaN where nobody looks": needless_nan,
    "a quaternion's length": quaternion_length,
    "no pose in odometry": unusable_pose,
    "a few poses that are none": a_few_unusable,
    "other axes or another order": other_conventions,
    "other units": other_units,
    "odometry against the pictures": against_the_pictures,
    "two clocks that overlap": overlapping_clocks,
}
