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


def alignment_text(building: Building) -> str:
    """Text: where the map lies, and the error of each surveyed point."""
    x, y, z = building.frame_from_map.translation
    turn = math.degrees(float(building.frame_from_map.heading))
    lines = [f"the map in {building.frame}: ({x:.3f}, {y:.3f}, {z:.3f}) m, turned by {turn:.3f}°"]
    if building.laying is None:
        return f"{lines[0]}, as the site file says"
    sigmas = np.sqrt(np.diagonal(building.covariance))
    lines[0] += (
        f"; sigma {100 * float(np.linalg.norm(sigmas[:3])):.2f} cm, {math.degrees(sigmas[5]):.3f}°"
    )
    residuals = building.laying.residuals
    rows = [
        (
            one.name,
            f"{100 * one.distance_m:.2f}",
            f"{one.chi2:.1f}",
            f"{one.probability:.2g}",
            "contradicts the others; left out" if one.is_outlier else "",
        )
        for one in residuals
    ]
    rows += [(name, "", "", "", "is not located; left out") for name in building.missing]
    colours = ["red" if one.is_outlier else "" for one in residuals]
    colours += ["yellow"] * len(building.missing)
    head = ("point", "off cm", "chi²", "by chance", "")
    return "\n".join([lines[0], table(head, rows, left=(0, 4), colours=colours)])
