"""Starts the parts of the system as processes, starts again what ends, and stops them in order."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from typing import BinaryIO, Self

from msgspec import Struct

from trigpoint.base.closing import Closing
from trigpoint.base.errors import InputError, OperationError, TrigpointError

from .output import Output

STOP_S = 5.0
"""A part that has not stopped by then is killed; each promises to stop within two seconds, unless
it writes something irreplaceable."""

_MOST_RESTARTS = 5
_STEADY_S = 60.0
"""A part that ran for so long before it ended begins to count anew: a camera that hangs once a day
is no part that does not stay alive."""
_REFUSED = 2  # the exit status of what is wrong with a file or with a command's words


class PartSpec(Struct, frozen=True):
    """One process. Parts of a lower `rank` stop first, those of one rank together; one that is not
    `needed` (a window that the user may close) is not started again; one that is `optional` is, but
    where it does not stay alive the others go on without it."""

    name: str
    command: tuple[str, ...]
    rank: int = 0
    needed: bool = True
    optional: bool = False


class Part:
    """A running part and what it says."""

    def __init__(self, spec: PartSpec, output: Output) -> None:
        self.spec, self.output = spec, output
        self.restarts = 0
        self._failures = 0
        self._began_s = 0.0
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def number(self) -> int:
        assert self._process is not None
        return self._process.pid

    @property
    def is_running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        """Start the process; it is in a session of its own, so that Ctrl-C does not reach it."""
        self._began_s = time.monotonic()
        with self.output.attach() as log:
            self._process = _open(self.spec.command, log)

    def start_again(self) -> None:
        """Start it once more and count it. Raises InputError where it was refused, OperationError
        where it does not stay alive."""
        if self._process is not None and self._process.returncode == _REFUSED:
            raise InputError(f"{self.ended()}{self.output.where}")
        if time.monotonic() - self._began_s > _STEADY_S:
            self._failures = 0
        if self._failures >= _MOST_RESTARTS:
            raise OperationError(f"{self.ended()}, {self._failures + 1} times{self.output.where}")
        self._failures += 1
        self.restarts += 1
        self.start()

    def ended(self) -> str:
        """How the process ended, with the last line of its log."""
        assert self._process is not None
        status = self._process.returncode
        if status < 0:
            return f"{self.spec.name} was ended by {signal.Signals(-status).name}"
        last = self.output.last_line().removeprefix("trigpoint: ")
        return f"{self.spec.name} ended with status {status}: {last or 'it said nothing'}"

    def has_failed(self) -> bool:
        """Whether it ended by itself with an error, which it would do again."""
        return self._process is not None and (self._process.poll() or 0) > 0

    def send(self, number: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(number)

    def wait(self, until_s: float) -> bool:
        """Wait for the end until a monotonic time; return whether it ended."""
        if self._process is None:
            return True
        try:
            self._process.wait(max(0.0, until_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            return False
        return True


class Supervisor(Closing):
    """All parts; leaving the context stops them. `say` gets one line for the user at a time."""

    def __init__(
        self,
        specs: Sequence[PartSpec],
        output: Callable[[str], Output],
        *,
        say: Callable[[str], None],
        stop_s: float | None = None,
    ) -> None:
        """`output`: where a part of this name writes; `stop_s`: how long a stop may take before the
        part is killed, if not STOP_S."""
        self.parts = [Part(spec, output(spec.name)) for spec in specs]
        self._say = say
        self._stop_s = STOP_S if stop_s is None else stop_s

    def __enter__(self) -> Self:
        try:
            for part in self.parts:
                part.start()
        except BaseException:
            self._kill()
            raise
        return self

    def close(self) -> None:
        """Stop all; where somebody is in a hurry (a second Ctrl-C), kill them."""
        try:
            self.stop()
        except BaseException:
            self._kill()
            raise

    @property
    def processes(self) -> dict[str, int]:
        """Part -> process id."""
        return {part.spec.name: part.number for part in self.parts}

    @property
    def restarts(self) -> dict[str, int]:
        """Part -> how often it was started again; only those that were."""
        return {part.spec.name: part.restarts for part in self.parts if part.restarts}

    def expect_all(self) -> None:
        """Raise OperationError where a part ended while the system comes up."""
        for part in self.parts:
            if part.spec.needed and part.has_failed():
                raise OperationError(f"{part.ended()}{part.output.where}")
        self.revive()

    def revive(self) -> bool:
        """Start again what ended; return whether anything did.

        Raises OperationError where a part does not stay alive, InputError where it refused a file.
        """
        fallen = [part for part in self.parts if not part.is_running]
        for part in fallen:
            if not part.spec.needed:
                self._let_go(part)
                continue
            self._start_again(part)
        return bool(fallen)

    def _start_again(self, part: Part) -> None:
        ending = part.ended()
        try:
            part.start_again()
        except TrigpointError as reason:
            if not part.spec.optional:
                raise
            self._say(f"{reason}; it goes on without")
            self.parts.remove(part)
        else:
            self._say(f"{ending}; it is started again")

    def _let_go(self, part: Part) -> None:
        if part.has_failed():
            self._say(f"{part.ended()}; it goes on without")
        self.parts.remove(part)

    def stop(self, ranks: Sequence[int] | None = None) -> None:
        """Stop the parts of these ranks (None: all), rank by rank; kill what does not stop."""
        for rank in sorted({part.spec.rank for part in self.parts}):
            if ranks is None or rank in ranks:
                self._stop([part for part in self.parts if part.spec.rank == rank])

    def _stop(self, parts: list[Part]) -> None:
        running = [part for part in parts if part.is_running]
        for part in running:
            part.send(signal.SIGTERM)
        deadline_s = time.monotonic() + self._stop_s
        for part in running:
            if not part.wait(deadline_s):
                part.send(signal.SIGKILL)
                part.wait(time.monotonic() + STOP_S)
                self._say(f"{part.spec.name} did not stop in {self._stop_s:.0f} s and was killed")

    def _kill(self) -> None:
        for part in self.parts:
            if part.is_running:
                part.send(signal.SIGKILL)
        for part in self.parts:
            part.wait(time.monotonic() + STOP_S)


def _open(command: Sequence[str], log: BinaryIO) -> "subprocess.Popen[bytes]":
    try:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env=_environment(),
        )
    except OSError as reason:
        raise OperationError(f"{command[0]} cannot be started ({reason.strerror})") from None


def _environment() -> dict[str, str]:
    """One thread of linear algebra a process: more of them only fight for the same cores."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return threads | {"PYTHONUNBUFFERED": "1"} | dict(os.environ)
