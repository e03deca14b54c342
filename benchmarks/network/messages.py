"""CDR bytes of messages: ours, checked and from or to our own types, against bare rosbags."""

from collections.abc import Callable

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from benchmarks.table import Row, share_of
from benchmarks.timing import side_by_side
from trigpoint.contract import cdr
from trigpoint.contract.messages import (
    SIGHTINGS,
    FaceSighting,
    Message,
    Odometry,
    Picture,
    Sightings,
)
from trigpoint.geometry import Pose

STAMP_NS = 1_700_000_000_123_456_789
PICTURE_BYTES = 100_000
_TIMES = 1000


def run(effort: float = 1.0) -> list[Row]:
    """Encode and decode one message of each kind; microseconds."""
    store, times = bare_store(), share_of(_TIMES, effort)
    jobs = {"Odometry": odometry(), "Sightings, 2 faces": sightings(), "picture, 100 kB": picture()}
    return [
        row for what, message in jobs.items() for row in _both_ways(what, message, store, times)
    ]


def odometry(stamp_ns: int = STAMP_NS) -> Odometry:
    """A reading."""
    return Odometry(stamp_ns, "r1/odom", "r1/base", Pose.planar(1.0, 2.0, 0.5))


def sightings() -> Sightings:
    """Two ChArUco faces in one picture."""
    ids = np.arange(12, dtype=np.uint16)
    pixels = np.random.default_rng(0).uniform(0, 480, (12, 2)).astype(np.float32)
    faces = tuple(FaceSighting("three-plane", face, ids, pixels, 0.1) for face in (0, 1))
    return Sightings(STAMP_NS, "c1/optical", 640, 480, faces)


def picture() -> Picture:
    """Bytes that no compression makes smaller, as a JPEG's are."""
    data = np.random.default_rng(0).integers(0, 256, PICTURE_BYTES, np.uint8).tobytes()
    return Picture(STAMP_NS, "c1/optical", "jpeg", data)


def bare_store() -> Typestore:
    """A type store of rosbags with our own types."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own = get_types_from_msg(cdr.definition(SIGHTINGS), SIGHTINGS)
    store.register({name: fields for name, fields in own.items() if name.startswith("trigpoint")})
    return store


def _both_ways(what: str, message: Message, store: Typestore, times: int) -> list[Row]:
    name, payload = cdr.type_name(message), cdr.encode(message)
    bare = store.deserialize_cdr(payload, name)
    if bytes(store.serialize_cdr(bare, name)) != payload:
        raise AssertionError(f"{what}: ours and rosbags' bytes differ")

    def row(way: str, ours: Callable[[], object], other: Callable[[], object]) -> Row:
        our_s, bare_s = side_by_side(ours, other, times=times)
        return Row("messages", f"{way} {what}", "µs", 1e6 * our_s, 1e6 * bare_s, "rosbags")

    return [
        row("encode", lambda: cdr.encode(message), lambda: store.serialize_cdr(bare, name)),
        row(
            "decode",
            lambda: cdr.decode(name, payload),
            lambda: store.deserialize_cdr(payload, name),
        ),
    ]
