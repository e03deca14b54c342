"""What becomes of an agent whose source is lost, hangs, freezes or ends."""

import logging
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from support.builders import eventually
from support.site.edge_desk import EMPTY, SEEN, Desk, ScriptedFrames, desk, taken

from trigpoint.base.errors import FrameError
from trigpoint.contract.messages import Sightings
from trigpoint.contract.topics import SIGHTINGS
from trigpoint.edge.sources.frames import Frame, Stamp
from trigpoint.node.health import Health

__all__ = ["desk"]  # the fixture


def test_end_of_the_source_ends_the_node(desk: Desk) -> None:
    node = desk.start((1000, EMPTY))
    assert node.stopping.wait(60.0)


def test_frame_that_is_not_newer_is_refused_and_counted(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    node = desk.start((2000, EMPTY), (2000, EMPTY), (1000, EMPTY), (3000, EMPTY))
    node.wait()
    stamps = [message.stamp_ns for message in taken(ears) if isinstance(message, Sightings)]
    assert stamps == [2000, 3000]
    assert node.health.lost("out_of_order") == 2


def test_lost_source_is_told_and_opened_again(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trigpoint.edge.node._FIRST_PAUSE_S", 0.01)
    ears = desk.listen(SIGHTINGS)
    node = desk.start((1000, EMPTY), FrameError("cam: the camera was lost"), (2000, EMPTY))
    node.wait()
    assert len(taken(ears)) == 2
    assert ScriptedFrames.opened == 2
    assert node.health.total("source_lost") == 1
    assert "cam: the camera was lost" in node.health.last_error


def test_frozen_pictures_are_flagged_and_not_looked_at(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    frozen = Frame(SEEN, 2000, Stamp.MONOTONIC, passed_over=20, is_frozen=True)
    node = desk.start(Frame(SEEN, 1000, Stamp.MONOTONIC, passed_over=4), frozen)
    node.wait()
    assert len(taken(ears)) == 1
    assert node.health.lost("frozen") == 1
    assert node.health.total("passed_over") == 24
    assert node.health.report().values["stamps"] == "by the kernel's monotonic clock"


def test_pauses_grow_while_the_source_stays_lost(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.edge.node._FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr("trigpoint.edge.node._LONGEST_PAUSE_S", 0.03)
    said: list[str] = []
    monkeypatch.setattr(Health, "hold", lambda _health, _name, text: said.append(text))
    losses = [FrameError("cam: gone") for _ in range(3)]
    desk.start((1000, EMPTY), *losses, (2000, EMPTY)).wait()
    assert ScriptedFrames.opened == 4
    assert said == ["cam: gone (trying again in 0 s)"] * 3


def test_lost_source_stays_said_until_it_is_back(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("trigpoint.edge.node._FIRST_PAUSE_S", 0.3)
    caplog.set_level(logging.INFO, "trigpoint")
    is_back, may_end = threading.Event(), threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray] | Exception]:
        yield FrameError("cam: gone")
        is_back.wait(60.0)
        yield 1000, EMPTY
        may_end.wait(60.0)

    node = desk.start(script=script())
    assert eventually(lambda: "cam: gone" in node.health.report().message)
    monkeypatch.setattr("trigpoint.node.health._MEMORY_NS", 0)
    assert "cam: gone" in node.health.report().message
    is_back.set()
    assert eventually(lambda: node.health.report().message == "running")
    may_end.set()
    node.wait()
    assert "gives pictures again, after" in caplog.text


def test_state_of_the_source_is_in_the_diagnostics(desk: Desk) -> None:
    has_begun, may_end = threading.Event(), threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray]]:
        has_begun.wait(60.0)
        yield 1000, EMPTY
        may_end.wait(60.0)

    node = desk.start(script=script())

    def is_said(state: str) -> bool:
        return eventually(lambda: node.health.report().values.get("source") == state)

    assert is_said("opening")
    has_begun.set()
    assert is_said("running")
    may_end.set()
    node.wait()
    assert is_said("ended")
    shown = {"detection.seconds", "sighting_delay.seconds", "calibration_views"}
    assert shown <= node.health.report().values.keys()


def test_camera_that_hangs_silences_the_watchdog_and_is_named(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.edge.node._PATIENCE_S", 0.3)
    monkeypatch.setattr("trigpoint.edge.node._PATIENT_PERIODS", 0.0)
    may_end = threading.Event()

    def script() -> Iterator[tuple[int, np.ndarray]]:
        yield 1000, EMPTY
        may_end.wait(60.0)  # a driver that does not return

    node = desk.start(script=script())
    assert eventually(lambda: node.watchdog.hung == ("edge/c1 sees",))
    (status,) = node.diagnostics().statuses
    assert status.message == "no sign of life of: edge/c1 sees"
    may_end.set()
    node.wait()
    assert eventually(lambda: node.watchdog.hung == ())


def test_skipped_pictures_are_counted_as_lost(desk: Desk) -> None:
    node = desk.start((1000, EMPTY), (2000, EMPTY))
    node.wait()
    assert eventually(lambda: node.health.lost("pictures") == 2)
