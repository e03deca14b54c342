import os
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.builders import eventually

from trigpoint.base.errors import InputError, OperationError
from trigpoint.tools.parts import supervisor as module
from trigpoint.tools.parts.output import LogFile
from trigpoint.tools.parts.supervisor import PartSpec, Supervisor

SLEEPS = "import time; time.sleep(60)"
FAILS = "import sys; print('starting'); sys.exit('the port is on fire')"
STUBBORN = "import signal, time; signal.signal(15, signal.SIG_IGN); print('up'); time.sleep(60)"
NOTES_ITS_END = """
import signal, sys, time
def end(*_):
    time.sleep({delay})
    open({path!r}, "a").write({name!r} + " ")
    sys.exit(0)
signal.signal(15, end)
print("up")
time.sleep(60)
"""


def spec(name: str, code: str, rank: int = 0, *, needed: bool = True) -> PartSpec:
    return PartSpec(name, (sys.executable, "-c", code), rank, needed)


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def supervise(tmp_path: Path, said: list[str]) -> Callable[..., Supervisor]:
    def output(part: str) -> LogFile:
        return LogFile.of(part, tmp_path)

    return lambda *specs: Supervisor(specs, output, say=said.append)


def ended(supervisor: Supervisor) -> bool:
    return not any(part.is_running for part in supervisor.parts)


def test_killed_part_is_started_again_said_and_counted(supervise, said):
    with supervise(spec("a", SLEEPS), spec("b", SLEEPS)) as supervisor:
        first, other = supervisor.parts
        number = first.number
        first.send(signal.SIGKILL)
        assert eventually(lambda: not first.is_running)
        assert supervisor.revive()
        assert first.is_running
        assert first.number != number
        assert other.is_running
        assert supervisor.restarts == {"a": 1}
        assert not supervisor.revive()
    assert said == ["a was ended by SIGKILL; it is started again"]


def test_part_that_fails_while_the_system_comes_up_is_named_with_its_last_words(supervise):
    supervisor = supervise(spec("robot r1", FAILS))
    with supervisor:
        assert eventually(lambda: ended(supervisor))
        with pytest.raises(OperationError, match="robot r1 ended with status 1: the port is on"):
            supervisor.expect_all()


def test_part_that_does_not_stay_alive_is_given_up(supervise):
    with supervise(spec("a", FAILS)) as supervisor:
        for _ in range(5):
            assert eventually(lambda: ended(supervisor))
            supervisor.revive()
        assert eventually(lambda: ended(supervisor))
        with pytest.raises(OperationError, match="on fire, 6 times"):
            supervisor.revive()


def test_window_that_was_closed_is_not_opened_again(supervise, said):
    with supervise(spec("viewer", "pass", needed=False), spec("a", SLEEPS)) as supervisor:
        viewer = supervisor.parts[0]
        assert eventually(lambda: not viewer.is_running)
        supervisor.revive()
        assert [part.spec.name for part in supervisor.parts] == ["a"]
    assert said == []


def test_window_that_cannot_be_opened_is_said_and_nothing_else_stops(supervise, said):
    with supervise(spec("viewer", FAILS, needed=False), spec("a", SLEEPS)) as supervisor:
        assert eventually(lambda: not supervisor.parts[0].is_running)
        supervisor.expect_all()
        assert [part.spec.name for part in supervisor.parts] == ["a"]
    assert said == ["viewer ended with status 1: the port is on fire; it goes on without"]


def test_parts_stop_in_the_order_of_their_ranks(supervise, tmp_path):
    notes = tmp_path / "notes.txt"

    def noting(name: str, rank: int, delay: float) -> PartSpec:
        return spec(name, NOTES_ITS_END.format(path=str(notes), name=name, delay=delay), rank)

    parts = (noting("last", 3, 0.0), noting("first", 1, 0.3), noting("second", 2, 0.1))
    with supervise(*parts) as supervisor:
        for part in supervisor.parts:
            assert eventually(lambda part=part: part.output.last_line() == "up")
        supervisor.stop([1])
        assert notes.read_text().split() == ["first"]
        assert [part.is_running for part in supervisor.parts] == [True, False, True]
    assert notes.read_text().split() == ["first", "second", "last"]
    assert ended(supervisor)


def test_part_that_does_not_stop_is_killed_and_said(supervise, said, monkeypatch):
    monkeypatch.setattr(module, "STOP_S", 0.3)
    with supervise(spec("a", STUBBORN)) as supervisor:
        assert eventually(lambda: supervisor.parts[0].output.last_line() == "up")
    assert ended(supervisor)
    assert "a did not stop" in said[0]


def test_no_process_is_left_where_the_work_is_interrupted(supervise):
    supervisor = supervise(spec("a", SLEEPS), spec("b", SLEEPS))
    with pytest.raises(KeyboardInterrupt), supervisor:
        raise KeyboardInterrupt
    assert ended(supervisor)


def test_second_interrupt_kills_what_is_slow_to_stop(supervise, monkeypatch):
    supervisor = supervise(spec("a", STUBBORN))

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with ExitStack() as stack:
        stack.enter_context(pytest.raises(KeyboardInterrupt))
        stack.enter_context(supervisor)
        assert eventually(lambda: supervisor.parts[0].output.last_line() == "up")
        monkeypatch.setattr(supervisor, "_stop", interrupted)
    assert ended(supervisor)


def test_no_process_is_left_where_one_cannot_be_started(supervise):
    supervisor = supervise(spec("a", SLEEPS), PartSpec("b", ("/no/such/program",)))
    with pytest.raises(OperationError, match="/no/such/program cannot be started"), supervisor:
        pass
    assert eventually(lambda: not supervisor.parts[0].is_running)


def test_ctrl_c_in_the_terminal_does_not_reach_the_parts(supervise):
    with supervise(spec("a", SLEEPS)) as supervisor:
        assert os.getpgid(supervisor.parts[0].number) != os.getpgid(0)


def test_last_line_skips_empty_ones(tmp_path):
    log = LogFile.of("edge c1", tmp_path)
    assert log.last_line() == ""
    with log.attach() as file:
        file.write(b"one\ntwo\n\n  \n")
    assert log.last_line() == "two"
    with log.attach() as file:
        file.write(b"x" * 10_000 + b"\nthe end")
    assert log.last_line() == "the end"
    assert log.where == f" (see {tmp_path}/edge_c1.log)"


def test_part_that_refuses_a_file_is_not_started_again(supervise):
    code = "import sys; print('site.toml:3: no such key'); sys.exit(2)"
    with supervise(spec("edge c1", code)) as supervisor:
        assert eventually(lambda: ended(supervisor))
        with pytest.raises(InputError, match=r"edge c1 ended with status 2: site\.toml:3: no such"):
            supervisor.revive()


def test_ends_far_apart_are_not_counted_together(supervise, monkeypatch):
    monkeypatch.setattr(module, "_STEADY_S", 0.0)
    with supervise(spec("a", FAILS)) as supervisor:
        for count in range(1, 9):
            assert eventually(lambda: ended(supervisor))
            supervisor.revive()
            assert supervisor.restarts == {"a": count}


def test_optional_part_that_does_not_stay_alive_ends_nothing_else(supervise, said):
    page = PartSpec("board", (sys.executable, "-c", FAILS), optional=True)
    with supervise(page, spec("a", SLEEPS)) as supervisor:
        assert eventually(lambda: supervisor.revive() and len(supervisor.parts) == 1)
        assert supervisor.parts[0].is_running
    assert len(said) == 6
    assert said[-1].startswith("board ended with status 1: the port is on fire, 6 times")
    assert said[-1].endswith("it goes on without")


def test_parts_use_one_thread_of_linear_algebra_each(supervise):
    code = "import os, time; print(os.environ['OPENBLAS_NUM_THREADS']); time.sleep(60)"
    with supervise(spec("a", code)) as supervisor:
        assert eventually(lambda: supervisor.parts[0].output.last_line() != "")
        assert supervisor.parts[0].output.last_line() == "1"
