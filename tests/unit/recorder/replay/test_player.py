"""A session back on the bus."""

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from msgspec.structs import replace
from support.builders import eventually

from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import InputError, OperationError
from trigpoint.bus.bus import Sample
from trigpoint.contract.correction import CorrectionMark, decode_mark, encode_mark
from trigpoint.contract.topics import CORRECTION, DIAGNOSTICS, ODOMETRY, SIGHTINGS
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.replay.pace import Controls, Span, span_of
from trigpoint.recorder.replay.player import Plan, plan, replay
from trigpoint.recorder.session.recording import RecordedSample, open_recording
from trigpoint.testing.memory_bus import MemoryBroker


def keys_of(chosen: Plan) -> set[str]:
    return {route.key for route in chosen.routes}


def test_the_same_bytes_come_in_the_same_order(session_file: Path) -> None:
    recording, broker = open_recording(session_file), MemoryBroker()
    with broker.session() as bus, broker.session() as listener:
        odometry = listener.subscribe(ODOMETRY, "lab/robot/*/odom")
        chosen = plan(recording, bus, site="lab", keys="**")
        counts = replay(
            recording,
            bus,
            chosen.routes,
            rate=2.0,
            clock=ManualClock(),
            stopping=threading.Event(),
        )
        got = []
        while sample := odometry.take(0.0):
            assert sample.encoding == ODOMETRY.encoding
            got.append(sample.payload)
    assert got == [sample.payload for sample in recording.samples([ODOMETRY])]
    expected = {k: n for k, n in recording.counts.items() if k != DIAGNOSTICS.key("lab")}
    assert counts == expected


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_the_pace_is_the_recorded_one_times_the_rate(session_file: Path, rate: float) -> None:
    recording, clock = open_recording(session_file), ManualClock()
    with MemoryBroker().session() as bus:
        chosen = plan(recording, bus, site="lab", keys="**/odom")
        before_s = clock.elapsed_ns() / 1e9
        replay(recording, bus, chosen.routes, rate=rate, clock=clock, stopping=threading.Event())
    logs = [sample.log_ns for sample in recording.samples([ODOMETRY])]
    lasted_s = clock.elapsed_ns() / 1e9 - before_s
    assert lasted_s == pytest.approx(0.5 + (logs[-1] - logs[0]) / 1e9 / rate, abs=1e-3)


def test_it_stops_when_asked(session_file: Path) -> None:
    recording, stopping = open_recording(session_file), threading.Event()
    stopping.set()
    with MemoryBroker().session() as bus:
        chosen = plan(recording, bus, site="lab", keys="**")
        counts = replay(
            recording, bus, chosen.routes, rate=1.0, clock=ManualClock(), stopping=stopping
        )
    assert sum(counts.values()) == 0


@pytest.mark.parametrize("keys", ["lab/camera/*/sightings", "camera/*/sightings", "**/sightings"])
def test_keys_are_chosen_with_or_without_the_site(session_file: Path, keys: str) -> None:
    recording = open_recording(session_file)
    with MemoryBroker().session() as bus:
        chosen = keys_of(plan(recording, bus, site="lab", keys=keys))
    assert chosen == {SIGHTINGS.key("lab", camera) for camera in ("c1", "c2", "c3", "c4")}


def test_another_site_gets_keys_of_its_own(session_file: Path) -> None:
    with MemoryBroker().session() as bus:
        chosen = plan(open_recording(session_file), bus, site="attic", keys="**/odom")
    assert [route.sent_as for route in chosen.routes] == ["attic/robot/r1/odom"]


def test_keys_that_match_nothing_are_an_error(session_file: Path) -> None:
    with MemoryBroker().session() as bus, pytest.raises(InputError, match="no key matches"):
        plan(open_recording(session_file), bus, site="lab", keys="robot/r7/**")


def test_keys_of_living_senders_are_left_out(session_file: Path) -> None:
    recording, broker = open_recording(session_file), MemoryBroker()
    with broker.session() as bus, broker.session() as other:
        other.declare_alive("lab/alive/fusion/main")
        other.declare_alive("lab/alive/edge/c1")
        chosen = plan(recording, bus, site="lab", keys="**")
        elsewhere = plan(recording, bus, site="attic", keys="**")
    fusions = {"lab/robot/r1/pose", "lab/robot/r1/correction", "lab/tf", "lab/camera/c1/pose"}
    assert fusions <= set(chosen.left_out)
    assert "lab/camera/c1/sightings" in chosen.left_out
    assert {"lab/camera/c2/sightings", "lab/robot/r1/odom"} <= keys_of(chosen)
    assert set(elsewhere.left_out) == {"lab/diagnostics"}


def test_a_living_robot_is_never_corrected_from_a_recording(session_file: Path) -> None:
    broker = MemoryBroker()
    with broker.session() as bus, broker.session() as robot:
        robot.declare_alive("lab/alive/robot/r1")
        with pytest.raises(OperationError, match="robot/r1 runs there"):
            plan(open_recording(session_file), bus, site="lab", keys="robot/r1/correction")


def put_back(path: Path, **options: Any) -> list[Sample]:
    recording, broker = open_recording(path), MemoryBroker()
    with broker.session() as bus, broker.session() as listener:
        everything = listener.subscribe(replace(ODOMETRY, queue=100_000), "lab/**")
        chosen = plan(recording, bus, site="lab", keys="**")
        options = {"stopping": threading.Event(), "clock": ManualClock(), **options}
        replay(recording, bus, chosen.routes, rate=1000.0, **options)
        got = []
        while sample := everything.take(0.0):
            got.append(sample)
    return got


def test_attachments_are_given_back(tmp_path: Path) -> None:
    writer, key = McapWriter(tmp_path / "s.mcap"), CORRECTION.key("lab", "r1")
    for number in range(3):
        mark = encode_mark(CorrectionMark(UUID(int=7), number))
        writer.add(CORRECTION, key, b"pose", log_ns=number, published_ns=number, attachment=mark)
    writer.finish()
    marks = [decode_mark(sample.attachment) for sample in put_back(tmp_path / "s.mcap")]
    assert marks == [CorrectionMark(UUID(int=7), number) for number in range(3)]


def test_a_part_of_a_session_is_replayed(session_file: Path) -> None:
    recording = open_recording(session_file)
    span = span_of(recording.start_ns, 1.0, 2.0, loops=False)
    expected = [
        sample
        for sample in recording.samples()
        if 10**9 <= sample.log_ns - recording.start_ns <= 2 * 10**9
        and sample.topic is not DIAGNOSTICS
    ]
    assert by_key(put_back(session_file, span=span)) == by_key(expected)


def by_key(samples: Sequence[Sample | RecordedSample]) -> dict[str, list[bytes]]:
    """Payloads in their order; between keys a subscriber takes turns."""
    found: dict[str, list[bytes]] = {}
    for sample in samples:
        found.setdefault(sample.key, []).append(sample.payload)
    return found


def test_a_loop_goes_on_until_it_is_stopped(session_file: Path) -> None:
    class Counted(ManualClock):
        """Stops the replay when the session has been replayed twice."""

        def wait(self, event: threading.Event, timeout_s: float) -> bool:
            if self.now_ns() > 0.5e9 + 2.2 * 4e6:
                event.set()
            return super().wait(event, timeout_s)

    once = len(put_back(session_file))
    got = put_back(session_file, span=Span(loops=True), clock=Counted())
    assert 2 * once < len(got) < 3 * once


def test_a_held_replay_goes_message_by_message(session_file: Path) -> None:
    controls, stopping = Controls(), threading.Event()
    recording, broker = open_recording(session_file), MemoryBroker()
    with broker.session() as bus, broker.session() as listener:
        odometry = listener.subscribe(ODOMETRY, "lab/robot/r1/odom")
        chosen = plan(recording, bus, site="lab", keys="**/odom")
        controls.pause()
        options: dict[str, Any] = {"stopping": stopping, "clock": ManualClock()}
        player = threading.Thread(
            target=replay,
            args=(recording, bus, chosen.routes),
            kwargs={"rate": 1.0, "controls": controls, **options},
        )
        player.start()
        for number in range(1, 4):
            controls.step()
            assert eventually(lambda wanted=number: odometry.received == wanted)
        controls.pause()
        player.join(10)
        assert odometry.received == recording.counts[ODOMETRY.key("lab", "r1")]


def test_a_prefix_makes_a_site_of_its_own(session_file: Path) -> None:
    with MemoryBroker().session() as bus:
        chosen = plan(open_recording(session_file), bus, site="again_lab", keys="**/odom")
    assert [route.sent_as for route in chosen.routes] == ["again_lab/robot/r1/odom"]
