"""What the search for checkerboards is tuned by, each number with its reason."""

from dataclasses import dataclass
from math import cos, log, radians


@dataclass(frozen=True, slots=True)
class CheckerboardTuning:
    """All numbers of the search; pixels are those of the picture that is searched."""

    # X corners. Smoothed by a pixel, a ring of 2.5 still fits squares of 5.
    smoothing_px: float = 1.0
    ring_radius_px: float = 2.5
    ring_samples: int = 16
    # Bounds on the work in a picture that is all corners; the strongest stay.
    most_candidates: int = 2500
    most_saddles: int = 800
    # A corner of contrast C smoothed by s has sqrt(-det H) = C / (π s²); 2 is a contrast of about
    # 15 grey levels in a sharp picture, five times the noise of a bad camera.
    least_strength: float = 2.0
    least_ring_amplitude: float = 5.0
    # Of a ring's power: an X has nearly all in its even harmonics, most of that in the second.
    most_odd_power: float = 0.25
    least_second_harmonic: float = 0.35
    # Curvature across a thin line against that along it; a square seen at 80 degrees has 0.03.
    least_curvature_ratio: float = 0.02

    # Links. Next corners are among the nearest 14 also where squares are seen aslant as 1 : 3.
    nearest: int = 14
    # Where squares are small, the next ones bend a corner's edges by up to 30 degrees.
    least_cosine: float = cos(radians(40.0))
    # Fewer are chance.
    least_corners: int = 4
    # Of a step against the opposite one: perspective shrinks a slanted board's by a quarter.
    longest_ratio: float = 2.2
    # Of a step, how much the next one and those beside it may differ.
    most_changed: float = 0.5

    # Growth. Three by three corners predict those beside them both ways.
    least_seed: int = 9
    most_rounds: int = 8
    # How often a grid's wild corners are dropped, the wildest first.
    most_drops: int = 4
    # A corner may lie this far from where those about it have it, of the distance to the next: a
    # slanted board's squares shrink by a quarter from one to the next, and each prediction is off
    # by half of that.
    most_off: float = 0.3
    # A predicted corner may be this much weaker than one that nothing predicted.
    tolerance: float = 1.7

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
