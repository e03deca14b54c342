"""What a search for checkerboards is bounded by, each number with its reason; what X corners,
grids, a place and its evidence are judged by is in the core (`native/src/boards`)."""

from msgspec import Struct


class CheckerboardTuning(Struct, frozen=True):
    """All numbers of the search; pixels are those of the picture that is searched."""

    # Place. Of a board's corners, how many must be seen: of two halves only one is.
    least_share: float = 0.55

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


TUNING = CheckerboardTuning()
