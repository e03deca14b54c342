"""A simulated robot of each protocol behind a pseudo-terminal: its odometry, and where it is."""

import json
import os
import threading
import time
import tty
from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest
from support.site.robot_desk import MAP, PERIOD_NS, Desk, desk

from trigpoint.base.clock import SystemClock, to_ns
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import Odometry, PoseEstimate
from trigpoint.contract.topics import CORRECTED
from trigpoint.geometry import Pose
from trigpoint.robot.dry_run import look
from trigpoint.robot.line.guess import guessed
from trigpoint.site.config import parse_site
from trigpoint.tools.simulation.world import load_world

__all__ = ["desk"]  # the fixture

WHEELS = {
    "ros_arduino_bridge": "[robots.r1.wheels]\ndiameter = 0.146\ntrack = 0.2969\nticks = 8384\n"
}
MAP_FROM_ODOM = Pose.planar(10.0, 3.0, 1.0)


def speak(desk: Desk, protocol: str) -> None:
    text = desk.site.text + f'protocol = "{protocol}"\n' + WHEELS.get(protocol, "")
    (desk.folder / "site.toml").write_text(text)
    desk.site = parse_site(text, directory=desk.folder)
    desk.start_firmware("--protocol", protocol)


@pytest.mark.parametrize("protocol", ["create2", "mavlink", "ros_arduino_bridge"])
def test_odometry_is_the_worlds_and_the_robots_place_is_on_the_bus(
    desk: Desk, protocol: str
) -> None:
    speak(desk, protocol)
    world = load_world("lab", seed=1).odometry("r1")
    corrected = desk.bus.subscribe(CORRECTED, CORRECTED.key("lab", "r1"))
    with desk.bridge() as node:
        desk.place(node, MAP_FROM_ODOM)
        messages = desk.take(60)
    # Counts begin at the bridge's start, in a frame of their own: compared is the way between.
    seconds = np.array([(message.stamp_ns - desk.epoch_ns) / 1e9 for message in messages])
    numbers = np.clip(np.round(seconds / 0.02).astype(int), 0, len(world.stamps_s) - 1)
    ways = [messages[0].pose.inverse() @ message.pose for message in messages]
    truth = [world.poses[numbers[0]].inverse() @ world.poses[number] for number in numbers]
    apart = np.array([way.difference(true) for way, true in zip(ways, truth, strict=True)])
    # Half a reading's time at 0.4 m/s, a count of the wheels, and what arrival says of time.
    assert np.median(np.abs(apart).max(axis=1)) < 0.02
    assert node.health.total("frames_established") == 1
    assert node.health.lost("odometry_impossible") == 0
    last = None
    while (sample := corrected.take(0.2)) is not None:
        last = decode(CORRECTED.type_name, sample.payload)
    assert isinstance(last, PoseEstimate)
    at = {message.stamp_ns: message for message in [*messages, *desk.rest()]}[last.stamp_ns]
    np.testing.assert_allclose(last.pose.difference(MAP_FROM_ODOM @ at.pose)[:2], 0, atol=0.05)


@pytest.mark.parametrize("protocol", ["trigpoint", "create2", "mavlink", "ros_arduino_bridge"])
def test_protocol_of_a_robot_is_guessed(desk: Desk, protocol: str) -> None:
    speak(desk, protocol)
    time.sleep(0.2)
    found = guessed(str(desk.port))
    assert found is not None
    assert found.protocol == protocol


def test_nobody_at_a_port_is_no_guess() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    try:
        assert guessed(os.ttyname(theirs), listen_s=0.05) is None
    finally:
        os.close(ours)
        os.close(theirs)


def test_map_that_the_site_does_not_know_is_asked_for(desk: Desk) -> None:
    """The bridge asks `fusion/map` by itself, and only while corrections want to place a robot."""
    asked = []

    def answer(_request: bytes) -> bytes:
        asked.append(time.monotonic())
        return json.dumps({"map_id": str(MAP)}).encode()

    desk.start_firmware()
    with desk.bridge(), closing(desk.bus.serve("lab/fusion/map", answer)):
        desk.take(60)
        assert not asked
        desk.correct(desk.take(60)[-3], MAP_FROM_ODOM)
        deadline = time.monotonic() + 60.0
        while not asked and time.monotonic() < deadline:
            desk.take(5)
        assert asked


class ClockUntil(SystemClock):
    """The machine's clock, for somebody who waits no longer once `is_over`."""

    def __init__(self, is_over: Callable[[], bool]) -> None:
        self._is_over = is_over

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return super().wait(event, timeout_s) or self._is_over()


def corrections_of(said: list[str]) -> list[str]:
    return [line for line in said if line.startswith("would send a correction")]


def test_dry_run_says_what_it_would_send_and_sends_nothing(desk: Desk) -> None:
    desk.start_firmware()
    world, said = load_world("lab", seed=1).odometry("r1"), []
    answer = json.dumps({"map_id": str(MAP)}).encode()
    with closing(desk.bus.serve("lab/fusion/map", lambda _: answer)):
        run = threading.Thread(
            target=look,
            args=(desk.site, "r1", said.append),
            kwargs={
                "open_bus": lambda _: desk.broker.session(),
                "seconds": 60.0,
                "clock": ClockUntil(lambda: len(corrections_of(said)) > 1),
            },
        )
        run.start()
        while run.is_alive():
            run.join(0.1)
            number = int((time.time_ns() - desk.epoch_ns - to_ns(0.1)) // PERIOD_NS)
            pose = world.poses[min(number, len(world.stamps_s) - 1)]
            stamp_ns = desk.epoch_ns + number * PERIOD_NS
            desk.correct(Odometry(stamp_ns, "", "", pose), MAP_FROM_ODOM @ pose)
    told = corrections_of(said)
    assert told[0].startswith("would send a correction, which places it anew: x ")
    assert len(told) > 1
    assert any("corrections: " in line for line in said)
    assert desk.noted("correction") == []
