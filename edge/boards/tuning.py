"""What a place of a board and its evidence are judged by, each number with its reason; what X
corners and grids are is in the core (`native/src/boards`)."""

from dataclasses import dataclass
from math import log


@dataclass(frozen=True, slots=True)
class CheckerboardTuning:
    """All numbers of the search; pixels are those of the picture that is searched."""

    # Growth. Three by three corners predict those beside them both ways.
    least_seed: int = 9

    # Place. Of a board's corners, how many must be seen: of two halves only one is.
    least_share: float = 0.55
    # By how many corners a place must be better than the next best one. A corner is seen on a
    # board, or not seen elsewhere, nine times of ten: two of them are odds of 80.
    least_lead: int = 2
    # Of the line after the last that is seen of a board, how much may be missing though it is in
    # view.
    most_missing: float = 0.5
    # Corners nearer to the picture's edge than this are not found: the ring and the smoothing.
    margin_px: float = 4.0

    # Evidence. How often a step from square to square is there: on a board, some of which gleam or
    # are hidden; and elsewhere, where it must be one way round and a quarter of the contrast.
    on_board: float = 0.88
    by_chance: float = 0.3
    least_step: float = 0.25
    # Odds against clutter that a sighting needs: a picture offers some ten grids, of ten thousand
    # pictures none may show a board that is not there.
    least_nats: float = log(10 * 10_000)
    # Of a square, how far a corner is off against those beside it: on a board, whose paper is not
    # flat (of 500 real ones most are off by 0.002, one by 0.02), with what a pixel's grain adds,
    # pixels; and in clutter where it is not even, which it is or is not as often.
    even_share: float = 0.01
    grain_px: float = 0.05
    uneven_share: float = 0.1
    even_by_chance: float = 0.5
    # How far beyond the outermost corners the outermost squares are looked at, squares: some are
    # narrow or cut. How far beyond those a board that goes on is: less than the white around most
    # boards, and little where the picture ends there.
    outer_squares: float = 0.4
    end_squares: tuple[float, ...] = (1.25, 1.1)

    # The search. Of the corners that were seen last and are in view, how many must be seen again.
    least_again: float = 0.85
    # Of the places of its extent, how many a joined grid must fill; chance grids wander.
    least_filled: float = 0.4
    # Where a grid shows less of a board, what it predicts is looked for; what is left then is found
    # by its fit.
    least_grown: float = 0.8
    # Bounds on the work in clutter: grids tried, and of these made whole; the largest come first.
    most_grids: int = 16
    most_grown: int = 3
    # A grid of more corners than so many boards have is a floor or a wall.
    most_boards_joined: int = 4
    # Corners of a grid that all lie so near its fit need no lens.
    enough_px: float = 0.7

    @property
    def right_nats(self) -> float:
        """What a square that is as printed says for a board."""
        return log(self.on_board / self.by_chance)

    @property
    def wrong_nats(self) -> float:
        """What one that is not says; less than 0."""
        return log((1 - self.on_board) / (1 - self.by_chance))


TUNING = CheckerboardTuning()
