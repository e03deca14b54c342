"""What every robot protocol must do, whatever it speaks."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trigpoint.clock import to_ns
from trigpoint.config import RobotConfig, WheelConfig
from trigpoint.robot.protocol import PROTOCOLS, Protocol, make_protocol

START_NS = to_ns(100.0)


def opened(name: str) -> Protocol:
    config = RobotConfig(port="x", protocol=name, wheels=WheelConfig(0.1, 0.3, 1000))
    return make_protocol("r1", config, boot=7)


@pytest.mark.parametrize("name", list(PROTOCOLS))
@settings(max_examples=50)
@given(st.lists(st.binary(max_size=300), max_size=10))
def test_no_bytes_make_it_raise_or_claim_a_robot(name: str, pieces: list[bytes]) -> None:
    protocol = opened(name)
    events = [event for piece in pieces for event in protocol.receive(piece, START_NS)]
    assert {type(event).__name__ for event in events} <= {"Damaged", "Missing"}


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_bytes_mean_the_same_however_they_are_cut(name: str) -> None:
    data = b"\0garbage\0more\0" * 3
    whole, single = opened(name), opened(name)
    at_once = whole.receive(data, START_NS)
    one_by_one = [e for i in range(len(data)) for e in single.receive(data[i : i + 1], START_NS)]
    assert at_once == one_by_one


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_what_is_due_is_sent_and_then_due_later(name: str) -> None:
    protocol, now_ns, sent = opened(name), START_NS, 0
    for _ in range(200):
        if protocol.due_ns(now_ns) <= now_ns:
            sent += bool(protocol.data_to_send(now_ns))
            assert protocol.due_ns(now_ns) > now_ns
        assert protocol.data_to_send(now_ns) == b""
        protocol.elapse(now_ns)
        now_ns += to_ns(0.05)
    assert sent > 1


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_reset_begins_anew(name: str) -> None:
    protocol = opened(name)
    first = protocol.data_to_send(START_NS)
    protocol.receive(b"half a frame", START_NS)
    protocol.reset()
    assert len(protocol.data_to_send(START_NS)) == len(first)
