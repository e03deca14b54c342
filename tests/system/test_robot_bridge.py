"""The robot bridge against a simulated firmware in a process of its own, on a pseudo-terminal."""

import os
import signal
import subprocess
import sys
import time
import tty
from contextlib import suppress

import numpy as np
from support.builders import eventually
from support.commands import Cli
from support.site.robot_desk import MAP, PERIOD_NS, SITE, Desk, desk

from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import CORRECTION
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.tools.simulation.world import load_world

__all__ = ["desk"]  # the fixture


def dry_run(desk: Desk) -> subprocess.CompletedProcess[str]:
    words = ["robot", "--site", str(desk.folder / "site.toml"), "--robot", "r1", "--dry-run"]
    return subprocess.run(
        [sys.executable, "-m", "trigpoint", *words],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_odometry_on_the_bus_is_the_worlds_at_the_moments_of_reading(desk: Desk) -> None:
    desk.start_firmware()
    world = load_world("lab", seed=1).odometry("r1")
    with desk.bridge() as node:
        messages = desk.take(50)
        assert node.health.total("odometry") >= 50
    # The robot never stands here, so a pose tells which reading it is.
    apart = [np.abs(message.pose.difference(world.poses)).max(axis=1) for message in messages]
    numbers = [int(np.argmin(each)) for each in apart]
    assert numbers == list(range(numbers[0], numbers[0] + 50))
    assert max(each.min() for each in apart) < 1e-9
    # Stamps are as good as the best exchange so far, which on a busy machine is late to come.
    late_ns = [
        m.stamp_ns - desk.epoch_ns - n * PERIOD_NS for n, m in zip(numbers, messages, strict=True)
    ]
    assert abs(np.median(late_ns)) < PERIOD_NS / 2


def test_correction_reaches_the_robot_which_acknowledges_it_and_moves_its_map(desk: Desk) -> None:
    desk.start_firmware()
    map_from_odom = Pose.planar(10.0, 3.0, 1.0)
    with desk.bridge() as node:
        desk.place(node, map_from_odom)
        assert node.health.total("frames_established") == 1
        off = Pose.planar(1.0, 0.0, 0.0) @ map_from_odom
        message = desk.take(60)[-3]
        desk.correct(message, off @ message.pose)
        assert eventually(lambda: node.health.lost("corrections_refused_jump") == 1)
    note = desk.noted("correction")[0]
    assert note["establishes"]
    assert note["map"] == str(MAP)
    np.testing.assert_allclose(note["map_from_odom"]["translation"], [10, 3, 0], atol=1e-4)


def test_restarted_bridge_is_heard_by_a_firmware_that_forgets_no_number(desk: Desk) -> None:
    """Corrections are numbered above the earlier bridge's; its start is told by its boot."""
    desk.start_firmware()
    map_from_odom = Pose.planar(10.0, 3.0, 1.0)
    for _ in range(2):
        with desk.bridge() as node:
            desk.place(node, map_from_odom)
    notes = [note for note in desk.noted("correction") if note["establishes"]]
    assert len(notes) == 2
    assert notes[1]["number"] > notes[0]["number"]
    assert notes[1]["bridge"] != notes[0]["bridge"]


def test_killed_firmware_is_found_again_and_its_odometry_goes_on(desk: Desk) -> None:
    firmware = desk.start_firmware()
    with desk.bridge() as node:
        messages = desk.take(60)
        firmware.send_signal(signal.SIGKILL)
        firmware.wait(60.0)
        desk.port.unlink()  # as a device node goes when it is unplugged
        *_, before = [*messages, *desk.rest()]
        desk.start_firmware("--counters-restart")
        after = desk.take(1)[0]
        assert after.stamp_ns > before.stamp_ns
        # It counts from zero now, metres away; the frame on the bus goes on where it was.
        assert np.linalg.norm(before.pose.translation) > 1.0
        np.testing.assert_allclose(after.pose.difference(before.pose), 0, atol=1e-9)
        assert node.health.lost("firmware_restarts") == 1
        assert node.health.total("connections") == 2


def test_bridge_that_is_started_again_goes_on_with_the_same_robot(desk: Desk) -> None:
    desk.start_firmware()
    with desk.bridge():
        first = desk.take(60)[-1]
    with desk.bridge() as node:
        while desk.take(1)[0].stamp_ns <= first.stamp_ns:
            pass
        assert node.health.lost("firmware_restarts") == 0


def test_garbage_on_the_line_is_counted_and_the_odometry_still_comes(desk: Desk) -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    desk.port.symlink_to(os.ttyname(theirs))
    robot = FirmwareEndpoint(name="r1", program="test", boot=1)
    with desk.bridge() as node:
        os.write(ours, b"\0noise\0" + robot.hello())
        os.set_blocking(ours, False)
        stamp_ns = 0

        def goes_on() -> bool:
            nonlocal stamp_ns
            with suppress(BlockingIOError):
                os.write(ours, robot.receive(os.read(ours, 4096), time.monotonic_ns()))
            stamp_ns = max(stamp_ns + 1, time.monotonic_ns())
            reading = robot.odometry(stamp_ns, Pose.identity(), np.zeros(3), np.zeros(3))
            os.write(ours, b"\x07garbage\0" + reading)
            return node.health.total("odometry") > 10

        assert eventually(goes_on)
        assert node.health.lost("serial_framing_errors") > 5
        report = node.diagnostics().statuses[0]
        assert "serial framing errors" in report.message
    os.close(ours)
    os.close(theirs)


def test_garbage_on_the_bus_is_rejected_and_its_sender_named(desk: Desk) -> None:
    desk.start_firmware()
    with desk.bridge() as node:
        message = desk.take(5)[-3]
        publisher = desk.bus.publisher(CORRECTION, CORRECTION.key(desk.site.name, "r1"))
        publisher.put(b"garbage", attachment=bytes(24))
        publisher.put(
            encode(PoseEstimate(message.stamp_ns, "map", message.pose, np.eye(6))),
            attachment=b"short",
        )
        assert eventually(lambda: node.health.total("rejected") == 2)
        assert desk.bus.identity in node.health.last_error
        assert desk.take(5)


def test_dry_run_says_what_comes_and_ends_well(desk: Desk) -> None:
    desk.start_firmware()
    done = dry_run(desk)
    assert done.returncode == 0, done.stderr
    assert "robot «r1», firmware «trigpoint simulated firmware»" in done.stdout
    assert done.stdout.count("odometry messages in this second") >= 3
    assert desk.noted("correction") == []


def test_dry_run_names_a_wrong_version(desk: Desk) -> None:
    desk.start_firmware("--version", "2")
    done = dry_run(desk)
    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert "version 2 of the serial protocol, this bridge version 1; update this bridge" in line


def test_port_that_does_not_exist_is_one_clear_line(desk: Desk, cli: Cli) -> None:
    said = cli("robot", "--site", desk.folder / "site.toml", "--robot", "r1", "--dry-run", status=1)
    [line] = said.err.splitlines()
    assert f"Port {desk.port} does not exist; this machine has " in line


def test_unknown_protocol_is_one_clear_line_that_lists_what_there_is(desk: Desk, cli: Cli) -> None:
    (desk.folder / "site.toml").write_text(SITE + 'protocol = "mavlnik"\n')
    line = cli.refused("robot", "--site", desk.folder / "site.toml", "--robot", "r1")
    assert "no robot protocol «mavlnik»; site.toml may name " in line
