"""`robot --dry-run` of a robot on the bus says of its odometry what the live bridge says."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trigpoint.base.clock import ManualClock, to_ns
from trigpoint.base.errors import OperationError
from trigpoint.contract import cdr
from trigpoint.contract.cdr_ros import store
from trigpoint.contract.messages import ODOMETRY, Odometry
from trigpoint.contract.topics import ODOMETRY as ODOMETRY_TOPIC
from trigpoint.geometry import Pose
from trigpoint.robot.dry_run import look
from trigpoint.site.config import parse_site
from trigpoint.testing.memory_bus import MemoryBroker, MemoryBus

SITE = """
site = "lab"
target = "target.toml"
[cameras.c1]
source = "sim://c1"
[robots.r1]
"""
NOW_NS = to_ns(1.7e9)


class Robot(ManualClock):
    """A clock by which a robot sends a message whenever time goes on."""

    def __init__(self, bus: MemoryBus, field: str, value: Any) -> None:
        super().__init__(NOW_NS)
        self._put = bus.publisher(ODOMETRY_TOPIC, ODOMETRY_TOPIC.key("lab", "r1")).put
        self._field, self._value, self._count = field, value, 0

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        self._count += 1
        pose = Pose.planar(1e-3 * self._count, 0.0, 0.0)
        found = store().deserialize_cdr(
            cdr.encode(Odometry(self.now_ns(), "odom", "base", pose)), ODOMETRY
        )
        *path, last = self._field.split(".")
        part = found
        for name in path:
            part = getattr(part, name)
        setattr(part, last, self._value)
        self._put(bytes(store().serialize_cdr(found, ODOMETRY)))
        return super().wait(event, timeout_s)


def said(field: str, value: Any) -> list[str]:
    broker, lines = MemoryBroker(), list[str]()
    with broker.session() as bus:
        look(
            parse_site(SITE, directory=Path()),
            "r1",
            lines.append,
            open_bus=lambda _: broker.session(),
            seconds=2.0,
            clock=Robot(bus, field, value),
        )
    return lines


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("header.stamp", store().types["builtin_interfaces/msg/Time"](0, 0), "without a stamp"),
        ("pose.pose.orientation.w", 2.0, "whose length is not 1"),
        ("twist.twist.linear.y", np.nan, "a twist that is not finite"),
    ],
)
def test_what_odometry_lacks_is_said_and_it_is_used(field: str, value: Any, words: str) -> None:
    *_, last = said(field, value)
    assert last.startswith("note: ")
    assert words in last


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("pose.pose.position.x", np.nan, "a position holds a number that is not finite"),
        ("header.stamp.sec", 12, "synchronise the two"),
        ("pose.pose.orientation.w", 0.0, "a quaternion of length 0"),
    ],
)
def test_why_all_that_comes_is_unusable_is_said(field: str, value: Any, words: str) -> None:
    with pytest.raises(OperationError, match=rf"^\d\d odometry messages .*{words}"):
        said(field, value)
