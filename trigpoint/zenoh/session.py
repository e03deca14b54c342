"""A Zenoh session, and its samples as the bus's own types.

Callbacks run on Zenoh's receiving thread (`called_at_once`) and only append to our queues. Measured
with a busy interpreter, the worst wait was 12 ms; Zenoh's own callback threads with their unbounded
queues took 44 to 410 ms and kept the program from ending.
"""

import ctypes
import json
import os
import sys
from collections.abc import Callable
from typing import TypedDict, TypeVar

import zenoh
from zenoh import CongestionControl, Priority, Reliability

from trigpoint.base.errors import BusError
from trigpoint.bus.bus import Sample
from trigpoint.bus.settings import Settings
from trigpoint.contract.topics import Delivery, Topic

_SWITCH_INTERVAL_S = 0.001
_ARENA_MAX, _ARENAS = -8, 2
"""mallopt's parameter, and how many heaps: each reconnection allocates megabytes on whichever of
twenty threads, and with glibc's default each had a heap that grew to the most of it."""
_RUNTIME = "(rx: (worker_threads: 8), acc: (worker_threads: 4), net: (worker_threads: 2))"
"""A peer that does not read blocks one of the receiving threads for up to 10 s while it is being
sent the history that it asked for. With two threads, Zenoh's default, two such peers held up
everything (measured: commands unanswered for 10 s beside a stopped subscriber).
And closing a TCP link waits until the other end has acknowledged what was sent (`SO_LINGER`,
Zenoh's issues 1101 and 2350). With one thread that accepts, Zenoh's default, everything that a
router relays stood still meanwhile (measured with 100 ms of delay and 5 % of loss: 0.3 to 0.6 s at
a time, that thread in `close`)."""
FLUSH_S = 0.5
CLOSE_S = 5.0
"""Time limits for sending what is left, and for closing as a whole, if the process was not told to
stop."""

_QUALITY: dict[Delivery, tuple[CongestionControl, Priority, bool]] = {
    Delivery.NEWEST: (CongestionControl.DROP, Priority.BACKGROUND, False),
    Delivery.RECOVERED: (CongestionControl.BLOCK, Priority.DATA_HIGH, False),
    Delivery.LAST_VALUE: (CongestionControl.BLOCK, Priority.DATA, False),
    Delivery.RELIABLE: (CongestionControl.BLOCK, Priority.DATA, False),
    Delivery.URGENT: (CongestionControl.BLOCK, Priority.REAL_TIME, True),
    Delivery.BEST_EFFORT: (CongestionControl.DROP, Priority.DATA_LOW, False),
}
"""Congestion, priority, express. BLOCK is for small control data: DROP would lose the newest."""


class Quality(TypedDict):
    """How Zenoh sends a topic's samples: a publisher's arguments."""

    encoding: str
    congestion_control: CongestionControl
    priority: Priority
    express: bool
    reliability: Reliability


Arrival = tuple[int, zenoh.Sample]
"""Arrival time by this machine's clock, nanoseconds; and the sample."""
_Said = TypeVar("_Said")


def open_session(settings: Settings) -> zenoh.Session:
    """Open a Zenoh session; raise BusError."""
    # How long receiving threads wait for the interpreter while another thread computes.
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    if (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)) is not None:  # glibc's
        mallopt(_ARENA_MAX, _ARENAS)
    os.environ.setdefault("ZENOH_RUNTIME", _RUNTIME)  # read when the first session opens
    config = zenoh.Config()
    try:
        for key, value in settings.values().items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as reason:
        if settings.mode == "client":
            names = ", ".join(settings.connect)
            raise BusError(f"the bus cannot reach {names} (bus.connect)") from None
        raise BusError(f"the bus cannot be opened: {plain(reason)}") from None


def quality_of(topic: Topic) -> Quality:
    """How a topic's delivery is had from Zenoh."""
    congestion, priority, express = _QUALITY[topic.delivery]
    is_reliable = topic.delivery.is_reliable
    return Quality(
        encoding=topic.encoding,
        congestion_control=congestion,
        priority=priority,
        express=express,
        reliability=Reliability.RELIABLE if is_reliable else Reliability.BEST_EFFORT,
    )


def called_at_once(
    function: Callable[[_Said], None], *, end: Callable[[], None] | None = None
) -> "zenoh.handlers.Callback[_Said]":
    """A callback that runs on the receiving thread; `end` is called when nothing more will come."""
    return zenoh.handlers.Callback(function, end, indirect=False)


def has_link(session: zenoh.Session) -> bool:
    """Whether the session is connected to anybody."""
    info = session.info
    return bool(info.routers_zid() or info.peers_zid())


def identity_of(identifier: object) -> str:
    """A session's identifier as text; Zenoh writes it with or without leading zeros."""
    return str(identifier).lstrip("0")


def plain(error: zenoh.ZError) -> str:
    """Zenoh's error text without its source locations."""
    return str(error).partition(" at /")[0].replace("\n", " ").rstrip("! ")


def sample_of(arrival: Arrival) -> Sample:
    """An arrival as a Sample; without a sender's timestamp, it is stamped with its arrival."""
    received_ns, raw = arrival
    stamp, source, attachment = raw.timestamp, raw.source_info, raw.attachment
    if source is not None:
        sender = identity_of(source.source_id.zid)
    else:
        sender = identity_of(stamp.get_id()) if stamp is not None else ""
    return Sample(
        key=str(raw.key_expr),
        payload=raw.payload.to_bytes(),
        encoding=str(raw.encoding),
        published_ns=stamp.get_time_as_ntp64().as_nanos() if stamp is not None else received_ns,
        received_ns=received_ns,
        attachment=attachment.to_bytes() if attachment is not None else b"",
        sender=sender,
    )


def key_of(arrival: Arrival) -> str:
    """The key that it was sent on."""
    return str(arrival[1].key_expr)


def share_of(arrival: Arrival) -> str:
    """The owner of a share of a queue: a sender on a key."""
    stamp = arrival[1].timestamp
    return f"{arrival[1].key_expr} {stamp.get_id() if stamp is not None else ''}"
