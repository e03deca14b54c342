"""The maps of corrections in figures: for people as tables, for programs as JSON."""

import json
import math
from collections.abc import Sequence
from typing import Any

from trigpoint.base.terminal import table
from trigpoint.fusion.coverage.accuracy_map import BY_FAILURE_M, WITHIN_M, AccuracyMap, class_name
from trigpoint.fusion.coverage.floor import HEADINGS

from .work import Gain


def summary_text(maps: Sequence[AccuracyMap]) -> str:
    """Tables of the floor that is corrected, and of what each camera's failure costs."""
    return "\n\n".join(_text(each) for each in maps)


def _text(each: AccuracyMap) -> str:
    who = ", ".join(each.robots)
    head = (f"{who} is corrected", "m²", "also where one camera fails")
    rows = [
        (class_name(w), f"{each.area_m2(w):.1f}", f"{each.area_m2(w, failing=True):.1f}")
        for w in WITHIN_M
    ]
    rows.append(("not, where it is floor", f"{each.floor_m2 - each.area_m2(math.inf):.1f}", ""))
    names = [class_name(w) for w in BY_FAILURE_M]
    lost_head = ("camera", "sees m²", *(f"lost without it {name}" for name in names))
    lost = [(name, *(f"{area:.1f}" for area in areas)) for name, areas in each.failures_m2()]
    return f"{table(head, rows)}\n\n{table(lost_head, lost)}"


def gains_text(gains: Sequence[Gain], within_m: float) -> str:
    head = ("one more camera", *(f"+ m² {class_name(w)}" for w in WITHIN_M))
    head += (f"+ m² {class_name(within_m)} where one fails",)
    rows = [
        (
            gain.camera,
            *(f"{gain.area_m2(w):.1f}" for w in WITHIN_M),
            f"{gain.area_m2(within_m, failing=True):.1f}",
        )
        for gain in gains
    ]
    return table(head, rows)


def ranked(gains: Sequence[Gain], within_m: float) -> list[Gain]:
    """Those first that add most floor corrected to within so much; of equals, most that remains
    so where one camera fails."""

    def worth(gain: Gain) -> tuple[float, float]:
        return gain.area_m2(within_m), gain.area_m2(within_m, failing=True)

    return sorted(gains, key=worth, reverse=True)


def summary_json(maps: Sequence[AccuracyMap], gains: Sequence[Gain], within_m: float) -> str:
    """All of it; areas in m², bounds in m, and no bound as null."""
    floor = maps[0].floor
    found: dict[str, Any] = {
        "cell_m": floor.cell_m,
        "headings": HEADINGS,
        "maps": [_map(each) for each in maps],
        "candidates": [_gain(gain, within_m) for gain in gains],
    }
    return json.dumps(found, indent=1)


def _map(each: AccuracyMap) -> dict[str, Any]:
    return {
        "robots": list(each.robots),
        "floor_m2": round(each.floor_m2, 2),
        "corrected": [
            {
                "within_m": _bound(w),
                "area_m2": round(each.area_m2(w), 2),
                "where_one_fails_m2": round(each.area_m2(w, failing=True), 2),
            }
            for w in WITHIN_M
        ],
        "cameras": {
            name: {
                "sees_m2": round(each.seen_m2(i), 2),
                "lost": [
                    {"within_m": _bound(w), "area_m2": round(each.lost_m2(i, w), 2)}
                    for w in WITHIN_M
                ],
            }
            for i, name in enumerate(each.names)
        },
    }


def _gain(gain: Gain, within_m: float) -> dict[str, Any]:
    return {
        "camera": gain.camera,
        "gained": [{"within_m": _bound(w), "area_m2": round(gain.area_m2(w), 2)} for w in WITHIN_M],
        "where_one_fails": {
            "within_m": within_m,
            "area_m2": round(gain.area_m2(within_m, failing=True), 2),
        },
    }


def _bound(within_m: float) -> float | None:
    return within_m if math.isfinite(within_m) else None
