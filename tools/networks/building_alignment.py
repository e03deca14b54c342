"""Aligns a calibration's map with its building, writes the result and describes it."""

import math
from pathlib import Path

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.base.terminal import table
from trigpoint.fusion.estimators.results import Results
from trigpoint.map.building import Building, lay_network, save_building
from trigpoint.map.floor_plan import FloorPlan
from trigpoint.site.config import Site


class Alignment(Struct, frozen=True, eq=False):
    """`building`: None if the site file has no [map], or the map cannot be aligned; `problem`: the
    reason, "" if all is well."""

    building: Building | None = None
    problem: str = ""


def align(site: Site, plan: FloorPlan | None, results: Results, folder: Path) -> Alignment:
    """Align the map with the building by the site file, and write it beside the network."""
    network, joint, ways = results.network, results.covariance, results.trajectories
    try:
        building = lay_network(site, plan, network, joint, ways)
    except InputError as reason:
        return Alignment(problem=str(reason))
    if building is not None:
        save_building(folder, building, network, joint, ways)
    return Alignment(building)


RESIDUALS = ("point", "x cm", "y cm", "z cm", "chi²", "by chance", "")
"""What a point is off, surveyed minus map; and how often one is as large where nothing is wrong."""


def alignment_words(building: Building) -> str:
    """Where the map lies, and how well that is known."""
    x, y, z = building.frame_from_map.translation
    turn = math.degrees(float(building.frame_from_map.heading))
    words = f"The map in {building.frame}: ({x:.3f}, {y:.3f}, {z:.3f}) m, turned by {turn:.3f}°"
    if building.laying is None:
        return f"{words}, as the site file says"
    sigmas = np.sqrt(np.diagonal(building.covariance))
    place_cm = 100 * float(np.linalg.norm(sigmas[:3]))
    return f"{words}; sigma {place_cm:.2f} cm, {math.degrees(sigmas[5]):.3f}°"


def residual_rows(building: Building) -> list[tuple[str, ...]]:
    """Each surveyed point's row by `RESIDUALS`, those that are not located last."""
    rows = []
    for one in building.laying.residuals if building.laying is not None else ():
        offsets = [f"{100 * value:.2f}" for value in one.offset_m]
        said = "contradicts the others; left out" if one.is_outlier else ""
        cells = *offsets, *[""] * (3 - len(offsets)), f"{one.chi2:.1f}", f"{one.probability:.2g}"
        rows.append((one.name, *cells, said))
    return rows + [(name, *[""] * 5, "is not located; left out") for name in building.missing]


def alignment_text(building: Building) -> str:
    """For the terminal."""
    if building.laying is None:
        return alignment_words(building)
    colours = ["red" if one.is_outlier else "" for one in building.laying.residuals]
    colours += ["yellow"] * len(building.missing)
    shown = table(RESIDUALS, residual_rows(building), left=(0, 6), colours=colours)
    return f"{alignment_words(building)}\n{shown}"
