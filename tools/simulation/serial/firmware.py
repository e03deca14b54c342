"""A simulated robot's firmware on a pseudo-terminal, in real time.

    python -m trigpoint.tools.simulation.serial.firmware --world lab --seed 1 \\
        --epoch-ns E --robot r1 --link r1.port --log r1.jsonl

What it sends is a pure function of world, seed and time: started again, it goes on where the world
is. Its clock starts at a time of its own and drifts, as a crystal does. `--link` becomes a link to
the pseudo-terminal; the bridge opens the link, and finds the new one after a restart.
"""

import os
import select
import signal
import time
import tty
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Annotated, TextIO

import msgspec
import typer

from trigpoint.base.clock import NANOSECONDS, to_ns
from trigpoint.base.errors import ConfigError
from trigpoint.geometry import Pose
from trigpoint.map.network import PoseRecord
from trigpoint.robot.firmware.endpoint import Applied, FirmwareEndpoint
from trigpoint.tools.simulation.world import load_world

from .readings import Readings
from .speakers import (
    PROGRAM,
    ArduinoSpeaker,
    Create2Speaker,
    FirmwareClock,
    MavlinkSpeaker,
    Speaker,
    TrigpointSpeaker,
)

_READ = 4096
_LONGEST_WAIT_S = 0.2
_NOTE_EVERY_S = 1.0


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


class Journal:
    """What the robot believes, one JSON object a line: every correction that it took over, and its
    own pose once a second and at the end. Stamps are Unix time; `at_ns`: when it took one over."""

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
            at_ns=time.time_ns(),
            map=str(applied.map_id),
            sequence=applied.sequence,
            establishes=applied.establishes,
            map_from_base=PoseRecord.of(applied.map_from_base),
            map_from_odom=PoseRecord.of(applied.map_from_odom),
        )

    def belief(self, stamp_ns: int, odom_from_base: Pose, map_from_base: Pose | None) -> None:
        self._write(
            kind="belief",
            stamp_ns=stamp_ns,
            odom_from_base=PoseRecord.of(odom_from_base),
            map_from_base=None if map_from_base is None else PoseRecord.of(map_from_base),
        )

    def _write(self, **fields: object) -> None:
        if self._file is not None:
            self._file.write(msgspec.json.encode(fields).decode() + "\n")


class SimulatedFirmware:
    def __init__(
        self, line: PseudoTerminal, speaker: Speaker, readings: Readings, journal: Journal
    ) -> None:
        self._line, self._speaker, self._readings = line, speaker, readings
        self._journal = journal
        self._noted_ns = 0
        self.is_stopping = False

    def run(self) -> None:
        """Send and answer until `is_stopping`."""
        self._line.write(self._speaker.begin())
        while not self.is_stopping:
            self._wait()
            if data := self._line.read():
                self._line.write(self._speaker.receive(data, time.time_ns()))
                for applied, stamp_ns in self._speaker.applied():
                    self._journal.correction(applied, stamp_ns)
            now_ns = time.time_ns()
            self._line.write(self._speaker.speak(now_ns))
            if now_ns >= self._noted_ns + to_ns(_NOTE_EVERY_S):
                self._note_belief(now_ns)
        self._note_belief(time.time_ns())

    def _wait(self) -> None:
        left_s = (self._speaker.due_ns() - time.time_ns()) / NANOSECONDS
        timeout_s = min(max(left_s, 0.0), _LONGEST_WAIT_S)
        select.select([self._line], [], [], timeout_s)

    def _note_belief(self, now_ns: int) -> None:
        """Where the robot believes it was at its newest reading."""
        self._noted_ns = now_ns
        number = self._readings.number(now_ns)
        stamp_ns = self._readings.unix_ns(number)
        pose = self._readings.pose(number)
        self._journal.belief(stamp_ns, pose, self._speaker.believed(now_ns))


def make_speaker(
    protocol: str, robot: str, readings: Readings, clock: FirmwareClock, *, zero: bool, version: int
) -> Speaker:
    """The robot's end of the line for a protocol; raise ConfigError that lists what there is."""
    match protocol:
        case "trigpoint":
            boot = int.from_bytes(os.urandom(4))
            endpoint = FirmwareEndpoint(name=robot, program=PROGRAM, boot=boot, version=version)
            return TrigpointSpeaker(endpoint, readings, clock, zero=zero)
        case "create2":
            return Create2Speaker(readings, clock.start_ns)
        case "mavlink":
            return MavlinkSpeaker(readings, clock)
        case "ros_arduino_bridge":
            return ArduinoSpeaker(readings, clock.start_ns)
    raise ConfigError(
        f"there is no simulated robot that speaks «{protocol}»; choose of "
        "trigpoint, create2, mavlink, ros_arduino_bridge"
    )


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
    protocol: Annotated[str, typer.Option(help="What it speaks.")] = "trigpoint",
    version: Annotated[int, typer.Option(help="Protocol version to claim, for tests.")] = 1,
    stands_s: Annotated[float, typer.Option(help="How long it stands and sends before.")] = 0.0,
) -> None:
    """The firmware of a simulated robot on a pseudo-terminal, until it is told to stop."""
    odometry = load_world(world, seed=seed, target=target).odometry(robot)
    readings = Readings(odometry, epoch_ns, stands_s)
    clock = FirmwareClock(time.time_ns(), drift_ppm)
    speaker = make_speaker(protocol, robot, readings, clock, zero=counters_restart, version=version)
    with ExitStack() as files:
        line = PseudoTerminal(link)
        files.callback(line.close)
        firmware = SimulatedFirmware(line, speaker, readings, Journal(journal, files))

        def stop(_number: int, _frame: object) -> None:
            firmware.is_stopping = True

        signal.signal(signal.SIGTERM, stop)
        signal.signal(signal.SIGINT, stop)
        firmware.run()


if __name__ == "__main__":
    typer.run(main)
