"""A simulated robot's firmware on a pseudo-terminal, in real time.

    python -m trigpoint.tools.simulation.firmware --world lab --seed 1 --epoch-ns E --robot r1 \\
        --link r1.port --log r1.jsonl

What it sends is a pure function of world, seed and time: started again, it goes on where the world
is. Its clock starts at a time of its own and drifts, as a crystal does. `--link` becomes a link to
the pseudo-terminal; the bridge opens the link, and finds the new one after a restart.
"""

import json
import os
import select
import signal
import time
import tty
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TextIO

import numpy as np
import typer

from trigpoint.clock import NANOSECONDS, to_ns
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, log
from trigpoint.network import PoseRecord
from trigpoint.robot.firmware.endpoint import Applied, FirmwareEndpoint

from .odometry import OdometryLog
from .world import load_world

PROGRAM = "trigpoint simulated firmware"
_READ = 4096
_LONGEST_WAIT_S = 0.2


class PseudoTerminal:
    """Both ends of a pty and the link to the bridge's one.

    The bridge's end stays open here too: else nothing could be written while no bridge is there,
    and a bridge that goes away would end this one. What nobody reads is lost, as on a real line.
    """

    def __init__(self, link: Path) -> None:
        self._link = link
        self._ours, self._bridges = os.openpty()
        tty.setraw(self._bridges)  # before anyone opens it, the terminal would send an echo
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._bridges)
        self.lost = 0
        fresh = link.with_name(f"{link.name}.{os.getpid()}")
        fresh.symlink_to(self.path)
        fresh.replace(link)

    def fileno(self) -> int:
        return self._ours

    def read(self) -> bytes:
        """What has come, b"" where nothing has."""
        with suppress(BlockingIOError):
            return os.read(self._ours, _READ)
        return b""

    def write(self, data: bytes) -> None:
        """Hand over what the line takes; the rest is lost and counted."""
        taken = 0
        with suppress(BlockingIOError):
            taken = os.write(self._ours, data)
        self.lost += len(data) - taken

    def close(self) -> None:
        """Take the link away, where it is still ours, and close."""
        if self._link.is_symlink() and str(self._link.readlink()) == self.path:
            self._link.unlink()
        os.close(self._ours)
        os.close(self._bridges)


@dataclass(frozen=True, slots=True)
class FirmwareClock:
    """The firmware's own clock: 0 at `start_ns` (Unix time), fast by `drift_ppm`."""

    start_ns: int
    drift_ppm: float

    def at(self, unix_ns: int) -> int:
        """What it reads at a Unix time."""
        elapsed_ns = unix_ns - self.start_ns
        return elapsed_ns + round(elapsed_ns * self.drift_ppm * 1e-6)


@dataclass(frozen=True, slots=True)
class Readings:
    """A robot's odometry; after the world's end the robot stands still and goes on sending."""

    log: OdometryLog
    epoch_ns: int

    @property
    def period_s(self) -> float:
        return float(self.log.stamps_s[1] - self.log.stamps_s[0])

    def first_after(self, unix_ns: int) -> int:
        """The number of the first reading at or after a time."""
        elapsed_s = (unix_ns - self.epoch_ns) / NANOSECONDS
        return max(0, int(np.ceil((elapsed_s - self.log.stamps_s[0]) / self.period_s)))

    def unix_ns(self, number: int) -> int:
        """When a reading is taken."""
        return self.epoch_ns + to_ns(float(self.log.stamps_s[0]) + number * self.period_s)

    def pose(self, number: int) -> Pose:
        """odom_from_base."""
        return self.log.poses[min(number, len(self.log.stamps_s) - 1)]

    def twist(self, number: int) -> tuple[Array, Array]:
        """Linear and angular speed over the last increment, base frame."""
        if not 0 < number < len(self.log.stamps_s):
            return np.zeros(3), np.zeros(3)
        step = self.pose(number - 1).inverse() @ self.pose(number)
        return step.translation / self.period_s, log(step.rotation) / self.period_s


class Journal:
    """What the robot believes, one JSON object a line: every correction that it took over, and its
    own pose once a second and at the end. Stamps are Unix time."""

    def __init__(self, path: Path | None, files: ExitStack) -> None:
        self._file: TextIO | None = None
        if path is not None:
            self._file = files.enter_context(path.open("a", buffering=1, encoding="utf-8"))

    def correction(self, applied: Applied, stamp_ns: int) -> None:
        self._write(
            kind="correction",
            number=applied.number,
            bridge=applied.bridge,
            stamp_ns=stamp_ns,
            map=str(applied.map_id),
            sequence=applied.sequence,
            establishes=applied.establishes,
            map_from_base=_record(applied.map_from_base),
            map_from_odom=_record(applied.map_from_odom),
        )

    def belief(self, stamp_ns: int, odom_from_base: Pose, map_from_base: Pose | None) -> None:
        self._write(
            kind="belief",
            stamp_ns=stamp_ns,
            odom_from_base=_record(odom_from_base),
            map_from_base=None if map_from_base is None else _record(map_from_base),
        )

    def _write(self, **fields: object) -> None:
        if self._file is not None:
            self._file.write(json.dumps(fields) + "\n")


def _record(pose: Pose) -> dict[str, tuple[float, ...]]:
    record = PoseRecord.of(pose)
    return {"translation": record.translation, "quaternion": record.quaternion}


class SimulatedFirmware:
    """One running firmware. `zero`: the counters restart, so odometry starts at the origin."""

    def __init__(
        self,
        line: PseudoTerminal,
        endpoint: FirmwareEndpoint,
        readings: Readings,
        clock: FirmwareClock,
        journal: Journal,
        *,
        zero: bool,
    ) -> None:
        self._line, self._endpoint, self._readings = line, endpoint, readings
        self._clock, self._journal = clock, journal
        self._next = readings.first_after(clock.start_ns)
        start = readings.pose(self._next)
        self._counted_from_odom = start.inverse() if zero else Pose.identity()
        self.is_stopping = False

    def run(self) -> None:
        """Send and answer until `is_stopping`."""
        self._line.write(self._endpoint.hello())
        while not self.is_stopping:
            self._wait()
            now_ns = time.time_ns()
            if data := self._line.read():
                answer = self._endpoint.receive(data, self._clock.at(time.time_ns()))
                self._line.write(answer)
                self._note_corrections()
            while self._readings.unix_ns(self._next) <= now_ns:
                self._send(self._next)
                self._next += 1
            self._line.write(self._endpoint.heartbeat(self._clock.at(now_ns)))
        self._note_belief(self._next - 1)

    def _wait(self) -> None:
        left_s = (self._readings.unix_ns(self._next) - time.time_ns()) / NANOSECONDS
        timeout_s = min(max(left_s, 0.0), _LONGEST_WAIT_S)
        select.select([self._line], [], [], timeout_s)

    def _send(self, number: int) -> None:
        stamp_ns = self._readings.unix_ns(number)
        pose = self._counted_from_odom @ self._readings.pose(number)
        twist = self._readings.twist(number)
        self._line.write(self._endpoint.odometry(self._clock.at(stamp_ns), pose, *twist))
        if number % max(1, round(1 / self._readings.period_s)) == 0:
            self._note_belief(number)

    def _note_corrections(self) -> None:
        for applied in self._endpoint.applied:
            elapsed_ns = round(applied.stamp_ns / (1 + self._clock.drift_ppm * 1e-6))
            self._journal.correction(applied, self._clock.start_ns + elapsed_ns)
        self._endpoint.applied.clear()

    def _note_belief(self, number: int) -> None:
        pose = self._counted_from_odom @ self._readings.pose(max(number, 0))
        stamp_ns = self._readings.unix_ns(number)
        self._journal.belief(stamp_ns, pose, self._endpoint.map_from_base)


def main(
    world: Annotated[str, typer.Option(help="A world's name or file.")],
    epoch_ns: Annotated[int, typer.Option(help="Unix time of the world's start, ns.")],
    robot: Annotated[str, typer.Option(help="The robot's name in the world.")],
    link: Annotated[Path, typer.Option(help="Where to put the link to the port.")],
    seed: Annotated[int, typer.Option(help="Of the noise.")] = 0,
    target: Annotated[str | None, typer.Option(help="charuco or checkerboard.")] = None,
    journal: Annotated[
        Path | None, typer.Option("--log", help="Where to write what the robot believes.")
    ] = None,
    drift_ppm: Annotated[float, typer.Option(help="How fast its clock runs.")] = 12.0,
    counters_restart: Annotated[
        bool, typer.Option(help="Count the odometry from zero at this start.")
    ] = False,
    version: Annotated[int, typer.Option(help="Protocol version to claim, for tests.")] = 1,
) -> None:
    """The firmware of a simulated robot on a pseudo-terminal, until it is told to stop."""
    readings = Readings(load_world(world, seed=seed, target=target).odometry(robot), epoch_ns)
    boot = int.from_bytes(os.urandom(4))
    endpoint = FirmwareEndpoint(name=robot, program=PROGRAM, boot=boot, version=version)
    with ExitStack() as files:
        line = PseudoTerminal(link)
        files.callback(line.close)
        firmware = SimulatedFirmware(
            line,
            endpoint,
            readings,
            FirmwareClock(time.time_ns(), drift_ppm),
            Journal(journal, files),
            zero=counters_restart,
        )

        def stop(_number: int, _frame: object) -> None:
            firmware.is_stopping = True

        signal.signal(signal.SIGTERM, stop)
        signal.signal(signal.SIGINT, stop)
        firmware.run()


if __name__ == "__main__":
    typer.run(main)
