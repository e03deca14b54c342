"""One session of the study: drawn, worked out, judged.

`python -m benchmarks.study.work SESSION SEED ESTIMATOR LIMIT` is the process in which that is done:
it prints two results as JSON, what there is before the session is worked out, and what it came to;
SIGPROF ends it after so many seconds of processor time in between.
"""

import signal
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.recipe import KINDS
from benchmarks.compositions.session import Composition, composed_session
from benchmarks.timing import worked
from trigpoint.cli import run
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network, load_covariance, load_network

from .judge import Truth, judged, unlocated
from .result import Outcome, Result
from .session import StudySession, simulated_session, worked_out


class Job(Struct, frozen=True):
    """One session of a situation, or of a kind of composition."""

    session: str
    seed: int
    estimator: str = "smoother"

    def case(self) -> "Case":
        """The session as it is drawn."""
        if self.session in KINDS:
            return composition_case(composed_session(self.session, self.seed))
        return situation_case(simulated_session(self.session, self.seed, estimator=self.estimator))


Found = tuple[Network, Array] | str
"""A network with the joint covariance of its located cameras, or why there is none."""


class Case(Struct, frozen=True, eq=False):
    """A drawn session with its truth. `work` gives seconds of processor time and what was found;
    `blank`: the result before that."""

    blank: Result
    truth: Truth
    work: Callable[[], tuple[float, Found]]

    def result(self) -> Result:
        """Work it out and judge it."""
        seconds, found = self.work()
        blank = replace(self.blank, seconds=seconds)
        if isinstance(found, str):
            return unlocated(replace(blank, outcome=Outcome.FAILED, why=found), self.truth)
        return judged(blank, self.truth, *found)


def situation_case(session: StudySession) -> Case:
    """A situation's session is worked out in memory, and held against its bound."""

    def work() -> tuple[float, Found]:
        seconds, results = worked(lambda: worked_out(session).results())
        return seconds, (results.network, results.covariance)

    estimator = session.inputs.site.fusion.estimator
    blank = Result(session.name, session.seed, 0.0, estimator=estimator)
    places = session.simulated.cameras
    truth = Truth(places, bound=session.bound, left_open=session.left_open)
    return Case(blank, truth, work)


def composition_case(session: Composition) -> Case:
    """A composition is worked out from its files, as a user would."""

    def work() -> tuple[float, Found]:
        with TemporaryDirectory() as folder:
            directory = write_composition(session, Path(folder))
            seconds, (status, said) = worked(lambda: calibrated(directory))
            return seconds, found_in(directory / "calibration", status, said)

    recipe = session.recipe
    blank = Result(
        recipe.kind,
        recipe.seed,
        0.0,
        is_alike=recipe.is_alike,
        is_mismatched=recipe.is_mismatched,
        lifts=recipe.lifts,
        lasts_s=session.lasts_s,
    )
    return Case(blank, Truth(session.last_places(), session.pictures_at_last()), work)


def calibrated(directory: Path) -> tuple[int, str]:
    """`calibrate` over a composition's folder: its exit status, and what it said is wrong."""
    words = ["calibrate", str(directory / "session.mcap"), "--site", str(directory / "site.toml")]
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as said:
        status = run([*words, "--out", str(directory / "calibration")])
    return status, said.getvalue()


def found_in(out: Path, status: int, said: str) -> Found:
    """What `calibrate` left in its folder."""
    if status or not (out / "network.json").exists():
        return f"exit {status}: {last_line(said)}"[:160]
    network = load_network(out)
    return network, load_covariance(out, network)


def last_line(text: str) -> str:
    """Of what a program said."""
    return text.strip().rpartition("\n")[2]


def main() -> None:
    """Do the work."""
    name, seed, estimator, limit_s = sys.argv[1:]
    case = Job(name, int(seed), estimator).case()
    _tell(unlocated(case.blank, case.truth))
    signal.setitimer(signal.ITIMER_PROF, float(limit_s))
    _tell(case.result())


def _tell(result: Result) -> None:
    print(msgspec.json.encode(result).decode(), flush=True)


if __name__ == "__main__":
    main()
