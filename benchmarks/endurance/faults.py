"""What a soak run breaks, and how: each kind, and by which key one sees that all is well again."""

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from benchmarks.network.impairment import Impairment
from benchmarks.network.segments import Segments
from trigpoint.tools.parts.supervisor import Part

FAIR = Impairment(delay_s=0.002, bits_per_s=100e6)
_BAD = Impairment(delay_s=0.05, loss=0.05, bits_per_s=20e6)
_BREAK_S, _STOP_S = 3.0, 10.0
_BAD_S = 8.0
_FLAPS = 3
# Below the ten seconds after which a clock that was set is believed.
_CLOCK_S = 5.0
_CLOCK_SOURCE = Path(__file__).with_name("set_clock.c")
RECORDING = "recording"
"""The key by which one sees that the recording grows; it is none of the bus."""


class SettableClock:
    """A Unix clock that can be set for one program, by a preloaded library: whoever runs behind its
    words `preloaded` has this machine's time, and what `set_by` adds."""

    def __init__(self, folder: Path) -> None:
        self._offset, self._library = folder / "clock_offset", folder / "set_clock.so"
        self.set_by(0.0)
        compiler = shutil.which("cc") or "gcc"
        words = [compiler, "-shared", "-fPIC", "-O2", "-Wall", "-o", str(self._library)]
        subprocess.run([*words, str(_CLOCK_SOURCE), "-ldl"], check=True, timeout=60)

    def set_by(self, seconds: float) -> None:
        """Set it; 0 is right again. The file stays the same, for it is mapped."""
        with self._offset.open("r+b" if self._offset.exists() else "wb") as file:
            file.write(round(seconds * 1e9).to_bytes(8, "little", signed=True))

    @property
    def preloaded(self) -> tuple[str, ...]:
        """Before a command."""
        return ("env", f"LD_PRELOAD={self._library}", f"SOAK_CLOCK={self._offset}")


class Fault(Struct, frozen=True):
    """`act` breaks something, for a while, and mends it; `ends_program`: one begins anew by it."""

    kind: str
    key: str
    act: Callable[[], None]
    ends_program: bool = False


class Faults:
    """`disk`: the folder, a file system of its own, that is written to."""

    def __init__(
        self,
        programs: dict[str, Part],
        segments: Segments,
        clock: SettableClock,
        disk: Path,
    ) -> None:
        self._programs, self._links = programs, segments.links
        self._cameras = segments.spaces["cameras"]
        self._clock, self._disk = clock, disk

    def each(self) -> list[Fault]:
        """Every kind once, in the order of a round."""
        return [
            Fault("cameras' cable pulled", "sightings", lambda: self._cut("cameras")),
            Fault("router killed", "odom", lambda: self._kill("router"), True),
            Fault("cameras' agent killed", "sightings", lambda: self._kill("edge"), True),
            Fault("robot's network bad", "odom", lambda: self._spoil("robot")),
            Fault("cameras' clock set by 2 s", "sightings", self._set_clock),
            Fault("robot killed (its cable)", "odom", lambda: self._kill("firmware"), True),
            Fault("disk full", RECORDING, self._fill),
            Fault("bridge killed", "odom", lambda: self._kill("robot"), True),
            Fault("a camera floods the site", "odom", self._flood),
            Fault("fusion killed", "robot_pose", lambda: self._kill("fusion"), True),
            Fault("cameras' agent frozen", "sightings", lambda: self._freeze("edge")),
            Fault("recorder killed", RECORDING, lambda: self._kill("recorder"), True),
            Fault("cameras' link flaps", "sightings", lambda: self._flap("cameras")),
            Fault("fusion frozen", "robot_pose", lambda: self._freeze("fusion")),
            Fault("robot's cable pulled", "odom", lambda: self._cut("robot")),
            Fault("all restarted in turn", "robot_pose", self._roll, True),
        ]

    def _kill(self, name: str) -> None:
        part = self._programs[name]
        part.send(signal.SIGKILL)
        part.wait(time.monotonic() + _STOP_S)
        time.sleep(_BREAK_S)
        part.start()

    def _roll(self) -> None:
        """As a rolling update does: each program is stopped in order and begun anew."""
        for part in self._programs.values():
            part.send(signal.SIGTERM)
            if not part.wait(time.monotonic() + _STOP_S):
                part.send(signal.SIGKILL)
                part.wait(time.monotonic() + _STOP_S)
            part.start()
            time.sleep(_BREAK_S)

    def _freeze(self, name: str) -> None:
        self._programs[name].send(signal.SIGSTOP)
        time.sleep(_BREAK_S)
        self._programs[name].send(signal.SIGCONT)

    def _cut(self, name: str) -> None:
        self._links[name].is_up = False
        time.sleep(_BREAK_S)
        self._links[name].is_up = True

    def _flap(self, name: str) -> None:
        for _ in range(_FLAPS):
            self._cut(name)
            time.sleep(_BREAK_S)

    def _spoil(self, name: str) -> None:
        self._links[name].impairment = _BAD
        time.sleep(_BAD_S)
        self._links[name].impairment = FAIR

    def _set_clock(self) -> None:
        self._clock.set_by(2.0)
        time.sleep(_CLOCK_S)
        self._clock.set_by(0.0)

    def _fill(self) -> None:
        filler = self._disk / "filler"
        with filler.open("wb", buffering=0) as file, suppress(OSError):
            while True:  # until nothing fits any more
                file.write(bytes(max(4096, shutil.disk_usage(self._disk).free // 2)))
        time.sleep(_BREAK_S)
        filler.unlink()

    def _flood(self) -> None:
        words = [sys.executable, "-m", "benchmarks.network.node", "flood"]
        site = str(self._disk.parent / "cameras.toml")
        line = self._cameras.command(*words, site, str(_BREAK_S), "0")
        go = "go\n{}\n"  # and that there is nothing to wait for
        subprocess.run(line, input=go, stdout=subprocess.DEVNULL, text=True, check=True, timeout=60)
