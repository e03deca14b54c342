"""The page's part on where the map lies in the building."""

import math
from html import escape

import numpy as np

from trigpoint.map.building import Building
from trigpoint.map.survey import Residual
from trigpoint.tools.pages.frame import note, row, scrolling, section, table
from trigpoint.tools.pages.svg import element

from .facts import CalibrationResults


def building_section(results: CalibrationResults) -> str:
    """Where the map lies, and what each surveyed point is off; "" where that was not asked for."""
    title = "The map in the building"
    if results.building_problem:
        return section(title, element("p", escape(results.building_problem)))
    if results.building is None:
        return ""
    told = note(_words(results.building))
    if results.building.laying is None:
        return section(title, told)
    return section(title, told, scrolling(_residuals(results.building), narrow=True))


def _words(building: Building) -> str:
    x, y, z = building.frame_from_map.translation
    turn = math.degrees(float(building.frame_from_map.heading))
    words = (
        f"The map's origin is at ({x:.3f}, {y:.3f}, {z:.3f}) m of «{building.frame}», turned by "
        f"{turn:.3f}°"
    )
    if building.laying is None:
        return f"{words}, as the site file says."
    sigmas = np.sqrt(np.diagonal(building.covariance))
    place_cm = 100 * float(np.linalg.norm(sigmas[:3]))
    return (
        f"{words}, with a sigma of {place_cm:.2f} cm and {math.degrees(sigmas[5]):.3f}°, by least "
        "squares over the surveyed points. A point's residual is surveyed minus map; by chance: "
        "how often one is as large where nothing is wrong. The network in the building's frame is "
        f"in the folder {building.frame}."
    )


def _residuals(building: Building) -> str:
    assert building.laying is not None
    head = ["point", "x cm", "y cm", "z cm", "chi²", "by<br>chance", ""]
    rows = [_row(one) for one in building.laying.residuals]
    rows += [
        element("tr", element("td", escape(name)), element("td", "is not located", colspan=6))
        for name in building.missing
    ]
    return table(head, rows)


def _row(one: Residual) -> str:
    offsets = [f"{100 * value:.2f}" for value in one.offset_m]
    cells = [escape(one.name), *offsets, *[""] * (3 - len(offsets))]
    cells += [f"{one.chi2:.1f}", f"{one.probability:.2g}"]
    cells.append("contradicts the others; left out" if one.is_outlier else "")
    return row(cells)
