"""Pieces of the simulated firmware; tests/system/test_robot_bridge.py runs it whole."""

import os
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.tools.simulation.motion.odometry import OdometryLog
from trigpoint.tools.simulation.serial.firmware import PseudoTerminal
from trigpoint.tools.simulation.serial.readings import Readings
from trigpoint.tools.simulation.serial.speakers import FirmwareClock

EPOCH_NS = to_ns(1_700_000_000.0)


def readings() -> Readings:
    poses = Pose.planar(0.1 * np.arange(5), np.zeros(5), np.zeros(5))
    return Readings(OdometryLog(np.arange(5) * 0.02, poses), EPOCH_NS)


def test_restarted_firmware_goes_on_with_the_reading_that_is_due() -> None:
    assert readings().first_after(EPOCH_NS - to_ns(5.0)) == 0
    assert readings().first_after(EPOCH_NS + to_ns(0.05)) == 3
    assert readings().unix_ns(3) == EPOCH_NS + to_ns(0.06)


def test_robot_stands_before_the_worlds_start_and_sends_already() -> None:
    standing = replace(readings(), stands_s=4.0)
    assert standing.first_after(EPOCH_NS - to_ns(5.0)) == -200
    assert standing.number(EPOCH_NS - to_ns(0.03)) == -2
    assert standing.unix_ns(-2) == EPOCH_NS - to_ns(0.04)
    assert standing.pose(-2).translation[0] == standing.pose(0).translation[0]
    assert standing.twist(-2)[0].tolist() == [0, 0, 0]


def test_robot_stands_after_the_worlds_end_and_goes_on_sending() -> None:
    assert readings().pose(1000).translation[0] == readings().pose(4).translation[0]
    assert readings().twist(2)[0][0] > 0
    assert readings().twist(1000)[0].tolist() == [0, 0, 0]
    assert readings().unix_ns(1000) == EPOCH_NS + to_ns(20.0)


def test_clock_starts_at_zero_and_drifts() -> None:
    clock = FirmwareClock(EPOCH_NS, 20.0)
    assert clock.at(EPOCH_NS) == 0
    assert clock.at(EPOCH_NS + to_ns(1000.0)) == to_ns(1000.02)


def test_link_leads_to_the_newest_terminal_and_goes_with_it(tmp_path: Path) -> None:
    link = tmp_path / "r1.port"
    first = PseudoTerminal(link)
    second = PseudoTerminal(link)
    assert str(link.readlink()) == second.path
    first.close()  # the link is not its own any more
    assert link.is_symlink()
    second.close()
    assert not link.is_symlink()


def test_bytes_that_nobody_reads_are_lost_and_counted(tmp_path: Path) -> None:
    terminal = PseudoTerminal(tmp_path / "r1.port")
    for _ in range(100):
        terminal.write(b"x" * 1000)
    assert terminal.lost > 0
    assert terminal.read() == b""  # and none came back as an echo
    bridge = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY)
    os.write(bridge, b"hello\n")
    assert terminal.read() == b"hello\n"
    os.close(bridge)
    terminal.close()
