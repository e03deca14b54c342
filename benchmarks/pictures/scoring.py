"""What a finder found, held against the truth."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from msgspec import Struct, field

from benchmarks.table import Row
from trigpoint.contract.messages import FaceSighting

from .views import TrueFace, View

# A found face belongs to a true one where half of its corners are nearer than this.
_NEAR_PX = 2.0


Finder = Callable[[np.ndarray], Sequence[FaceSighting]]
"""The faces in a picture; a detector's `detect` is one."""
UNSAID = 0.0
"""The sigma of who says none."""


def found_as(face: int, corners: np.ndarray, pixels: np.ndarray) -> FaceSighting:
    """What a finder found that says no sigma, a face or -1."""
    return FaceSighting("", face, corners, pixels, UNSAID)


class Score(Struct):
    """`whole`: faces that should be found; `found`: of these; `wrong`: found where none is.

    `errors`: the distance from the truth of each corner, pixels, by view, face and corner;
    `normalised`: the same in the sigmas that the finder says.
    """

    whole: int = 0
    found: int = 0
    wrong: int = 0
    errors: dict[tuple[int, int, int], float] = field(default_factory=dict)
    normalised: list[float] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Of the faces that should be found, how many were."""
        return self.found / self.whole if self.whole else 0.0

    def rms(self, among: Iterable[tuple[int, int, int]] | None = None) -> float:
        """Root mean square error of a coordinate over the corners (or some of them), pixels."""
        return _rms([self.errors[key] for key in (self.errors if among is None else among)])

    @property
    def normalised_rms(self) -> float:
        """The same of all corners in sigmas: 1 where they are true."""
        return _rms(self.normalised)


def score_of(views: list[View], answers: Sequence[Sequence[FaceSighting]]) -> Score:
    """The score over views of what was found in each."""
    score = Score()
    for number, (view, answer) in enumerate(zip(views, answers, strict=True)):
        seen = set()
        for found in answer:
            match = _match(found, view.faces)
            if match is None:
                score.wrong += 1
                continue
            true, corners, errors = match
            seen.add(true.face.id)
            keys = [(number, true.face.id, corner) for corner in corners.tolist()]
            score.errors.update(zip(keys, errors.tolist(), strict=True))
            if found.sigma != UNSAID:
                score.normalised += (errors / found.sigma).tolist()
        score.whole += view.whole
        score.found += sum(true.is_whole and true.face.id in seen for true in view.faces)
    return score


def score_rows(
    row: Callable[..., Row], what: str, ours: Score, other: Score, name: str
) -> list[Row]:
    """Our score beside another finder's; `row`: makes one of a benchmark's rows."""
    both = ours.errors.keys() & other.errors.keys()
    shares = (100 * ours.share, 100 * other.share)
    rows = [row(f"{what}, faces found", "%", *shares, name, more_is_better=True)]
    if ours.wrong or other.wrong:
        rows.append(row(f"{what}, found where none is", "faces", ours.wrong, other.wrong, name))
    error = (ours.rms(both), other.rms(both))
    return [*rows, row(f"{what}, corner error, found by both", "px", *error, name)]


def sigma_row(row: Callable[..., Row], what: str, ours: Score) -> Row:
    """Neither more nor less is better than the same."""
    what = f"{what}, corner error in its sigmas"
    return row(what, "1", ours.normalised_rms, 1.0, "a true sigma")


def _rms(distances: list[float]) -> float:
    """Root mean square of a coordinate of distances in the plane; 0 for none."""
    return float(np.sqrt(np.mean(np.square(distances)) / 2)) if distances else 0.0


def _match(
    found: FaceSighting, faces: tuple[TrueFace, ...]
) -> tuple[TrueFace, np.ndarray, np.ndarray] | None:
    """The true face, the corner ids in its order and the errors (n,); None where none is near."""
    readings = []
    for true in faces:
        if found.face not in (-1, true.face.id):
            continue
        orders = [found.corners.astype(int)]
        if found.face == -1 or true.face.reads_from_both_ends:  # a finder may count from its end
            orders.append(true.face.corner_count - 1 - orders[0])
        for corners in orders:
            errors = np.linalg.norm(found.pixels - true.pixels[corners], axis=1)
            readings.append((float(np.median(errors)), len(readings), true, corners, errors))
    if not readings:
        return None
    median, _, true, corners, errors = min(readings, key=lambda reading: reading[:2])
    return (true, corners, errors) if median < _NEAR_PX else None
