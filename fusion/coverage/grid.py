"""The map of corrections as an occupancy grid: one number a cell, for planners."""

from collections.abc import Sequence

import numpy as np

from trigpoint.contract.coverage import MOST_MM, NOT_CORRECTED, UNKNOWN

from .accuracy_map import AccuracyMap


def grid_values(maps: Sequence[AccuracyMap]) -> np.ndarray:
    """The values (n,) int8 of all cells, row by row from the lower left: whole millimetres of the
    error radius in the middle heading, MOST_MM for all that is larger; NOT_CORRECTED where a robot
    is not corrected, UNKNOWN where nothing says that the cell is floor. Of several targets, the
    one that is corrected worst."""
    errors = np.max([each.error_m for each in maps], axis=0)
    is_floor = np.any([each.is_floor for each in maps], axis=0)
    millimetres = np.floor(1000 * np.where(np.isfinite(errors), errors, 0.0))
    values = np.where(np.isfinite(errors), np.minimum(millimetres, MOST_MM), NOT_CORRECTED)
    return np.where(is_floor, values, UNKNOWN).astype(np.int8)
