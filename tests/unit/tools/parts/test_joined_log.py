"""One log of several processes."""

import io
import sys
import threading
import time

import pytest
from support.builders import eventually

from trigpoint.tools.parts import joined_log as module
from trigpoint.tools.parts.joined_log import JoinedLog
from trigpoint.tools.parts.supervisor import PartSpec, Supervisor


class Stopped(io.StringIO):
    """A terminal on which somebody pressed Ctrl-S, until `go`."""

    def __init__(self) -> None:
        super().__init__()
        self.go = threading.Event()

    def write(self, text: str) -> int:
        self.go.wait()
        return super().write(text)


def run_to_its_end(log: JoinedLog, *codes: tuple[str, str]) -> Supervisor:
    specs = [PartSpec(name, (sys.executable, "-c", code)) for name, code in codes]
    with Supervisor(specs, log.output, say=lambda line: log.say("up", line)) as supervisor:
        assert eventually(lambda: not any(part.is_running for part in supervisor.parts))
    return supervisor


def test_lines_of_all_parts_stand_behind_their_names() -> None:
    stream = io.StringIO()
    with JoinedLog(stream, width=8) as log:
        run_to_its_end(
            log,
            ("edge c1", "import sys; print('one'); sys.stderr.write('two\\n')"),
            ("fusion", "print('three')"),
        )
    lines = stream.getvalue().splitlines()
    assert sorted(lines) == ["edge c1  | one", "edge c1  | two", "fusion   | three"]


def test_last_words_of_a_part_that_ended_are_known_at_once() -> None:
    with JoinedLog(io.StringIO(), width=4) as log:
        supervisor = run_to_its_end(log, ("a", "import sys; sys.exit('trigpoint: no such port')"))
        assert supervisor.parts[0].ended() == "a ended with status 1: no such port"


def test_log_that_nobody_takes_holds_up_no_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_LINES", 100)
    stream = Stopped()
    with JoinedLog(stream, width=1) as log:
        began_s = time.monotonic()
        supervisor = run_to_its_end(log, ("a", "[print(i) for i in range(50_000)]"))
        assert time.monotonic() - began_s < 20
        # A busy machine takes longer for what is still in the pipe than closing waits.
        assert eventually(lambda: supervisor.parts[0].output.last_line() == "49999")
        stream.go.set()
    lines = stream.getvalue().splitlines()
    lost = [int(line[1:].split()[0]) for line in lines if line.startswith("(")]
    assert sum(lost) > 40_000
    assert sum(lost) + len(lines) - len(lost) == 50_000


def test_closing_a_log_that_nobody_takes_has_a_time_limit() -> None:
    stream = Stopped()
    began_s = time.monotonic()
    with JoinedLog(stream, width=1) as log:
        log.say("a", "never seen")
    assert time.monotonic() - began_s < 5
    stream.go.set()
