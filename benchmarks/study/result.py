"""What came of one session of the study, of whatever kind."""

from enum import StrEnum

from msgspec import Struct, field


class Outcome(StrEnum):
    """Whether there is a network; LATE: over the limit of processor time; STOPPED: from outside or
    by the clock, which says nothing of the session."""

    DONE = "done"
    LATE = "late"
    FAILED = "failed"
    STOPPED = "stopped"


class Verdict(StrEnum):
    """What a camera's place, or that it has none, is worth by the truth.

    WRONG: grossly elsewhere; MADE_UP: located, though never seen or left open by the data; MISSED:
    not located, though the data decide; LEFT_OPEN: not located, since they leave it open; UNKNOWN:
    not located, and nobody says whether it could have been.
    """

    RIGHT = "right"
    WRONG = "wrong"
    MADE_UP = "made up"
    MISSED = "undetermined"
    LEFT_OPEN = "rightly undetermined"
    UNKNOWN = "not located"


class Camera(Struct, frozen=True):
    """`is_moved`: it is said to hang elsewhere than earlier in the session.

    Of compositions: `pictures` with a good sighting of where it hung at last; `is_confirmed`: not
    resting on one sighting alone; `error_m`, `sigmas`: of its position where it is located;
    `among`: whether the true place is among the alternatives where such are named.
    """

    name: str
    verdict: Verdict
    is_moved: bool = False
    pictures: int = 0
    is_confirmed: bool = True
    error_m: float | None = None
    sigmas: float | None = None
    among: bool | None = None

    @property
    def is_located(self) -> bool:
        return self.verdict in (Verdict.RIGHT, Verdict.WRONG, Verdict.MADE_UP)


class Result(Struct, frozen=True):
    """One session. `session`: its situation or kind of composition; `seconds`: processor time;
    `honesty`: eᵀP⁻¹e/6n over the n located cameras with the estimator's own joint covariance P,
    None where none is; `why` it failed; `rejected`: observations set aside.

    Of situations: `efficiency`: the same with the bound; `distance`, `distance_bound`: mean error
    of the distances between cameras, metres, and what the bound expects of it, None with fewer than
    two located.

    Of compositions: `is_alike`, `is_mismatched`, `lifts`: as in the recipe; `lasts_s`: their
    length. Where a camera is wrong, `honesty` is None.
    """

    session: str
    seed: int
    seconds: float
    cameras: list[Camera] = field(default_factory=list)
    honesty: float | None = None
    estimator: str = "smoother"
    outcome: Outcome = Outcome.DONE
    why: str = ""
    rejected: int = 0
    efficiency: float | None = None
    distance: float | None = None
    distance_bound: float | None = None
    is_alike: bool = False
    is_mismatched: bool = False
    lifts: int = 0
    lasts_s: float = 0.0

    def those(self, *verdicts: Verdict) -> list[Camera]:
        """The cameras that are one of these."""
        return [camera for camera in self.cameras if camera.verdict in verdicts]

    @property
    def is_bad(self) -> bool:
        """Whether there is a false place, or no network."""
        is_done = self.outcome is Outcome.DONE
        return not is_done or bool(self.those(Verdict.WRONG, Verdict.MADE_UP))
