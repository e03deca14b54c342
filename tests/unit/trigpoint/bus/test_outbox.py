"""What is to be sent waits for nobody."""

import threading
import time

import pytest

from trigpoint.base.errors import BusError
from trigpoint.bus.outbox import Outbox


class Link:
    """Somebody who reads only while the gate is open."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.got: list[int] = []

    def send(self, number: int) -> None:
        self.gate.wait(60.0)
        self.got.append(number)


def test_put_returns_while_nobody_reads_and_the_oldest_is_lost() -> None:
    link, outbox = Link(), Outbox("sends", capacity=5)
    outbox.put(lambda: link.send(0))
    while outbox.flush(0.0) or outbox.waiting:  # until the thread is at the first one
        pass
    for number in range(1, 10):
        outbox.put(lambda number=number: link.send(number))
    assert link.got == []
    assert outbox.lost == 4
    link.gate.set()
    assert outbox.flush(10.0)
    assert link.got == [0, 5, 6, 7, 8, 9]
    assert outbox.close(10.0)


def test_close_leaves_behind_what_nobody_reads() -> None:
    link, outbox = Link(), Outbox("sends")
    for number in range(3):
        outbox.put(lambda number=number: link.send(number))
    assert not outbox.close(0.1)
    with pytest.raises(BusError):
        outbox.put(lambda: None)
    link.gate.set()
    assert outbox.close(10.0)


def test_what_the_bus_refuses_is_lost_and_ends_nothing() -> None:
    def refuse() -> None:
        raise BusError("no")

    outbox, sent = Outbox("sends"), threading.Event()
    outbox.put(refuse)
    outbox.put(sent.set)
    assert sent.wait(60.0)
    assert outbox.lost == 1
    assert outbox.close(10.0)


def test_who_has_nothing_else_to_do_sends_by_itself_until_it_had_to_wait() -> None:
    outbox, senders = Outbox("sends", is_direct=True), list[str]()

    def send() -> None:
        senders.append(threading.current_thread().name)
        time.sleep(0.06)  # somebody does not read

    outbox.put(send)
    outbox.put(send)
    assert outbox.close(10.0)
    assert senders == [threading.current_thread().name, "sends"]


def test_order_is_kept_where_one_sends_by_itself_and_another_comes() -> None:
    link, outbox = Link(), Outbox("sends", is_direct=True)
    first = threading.Thread(target=outbox.put, args=(lambda: link.send(0),))
    first.start()
    while outbox.flush(0.0):  # until the first one is being sent
        pass
    for number in range(1, 4):
        outbox.put(lambda number=number: link.send(number))
    assert link.got == []
    link.gate.set()
    assert outbox.flush(10.0)
    assert link.got == [0, 1, 2, 3]
    first.join()
    assert outbox.close(10.0)


def test_what_is_held_is_sent_in_order_when_somebody_flushes() -> None:
    outbox, sent = Outbox("sends", is_direct=True), list[int]()
    outbox.hold(60.0)
    for number in range(3):
        outbox.put(lambda number=number: sent.append(number))
    assert sent == []
    assert outbox.flush(10.0)
    assert sent == [0, 1, 2]
    assert outbox.close(10.0)


def test_what_is_held_goes_out_when_the_time_is_over() -> None:
    outbox, sent = Outbox("sends"), threading.Event()
    outbox.hold(0.05)
    outbox.put(sent.set)
    assert sent.wait(60.0)
    assert outbox.close(10.0)
