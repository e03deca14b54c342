"""Writes the maps of corrections: for planners, for geographic programs, and as a table."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from trigpoint.base.errors import OperationError, writing
from trigpoint.contract.coverage import UNKNOWN
from trigpoint.fusion.coverage.accuracy_map import (
    NOBODY,
    WITHIN_M,
    AccuracyMap,
    class_name,
    grid_values,
)
from trigpoint.fusion.coverage.floor import Floor

from .outlines import outlines

NAME = "coverage"
_CSV = (
    "robots,x,y,error_m,best_heading_m,worst_heading_m,cameras,worst_camera,without_worst_camera_m"
)


def write_maps(folder: Path, maps: Sequence[AccuracyMap], site: str) -> list[Path]:
    """Write coverage.png with coverage.yaml, coverage.geojson and coverage.csv; raises
    OperationError if that fails."""
    floor = maps[0].floor
    files = {
        f"{NAME}.png": _picture(floor, grid_values(maps)),
        f"{NAME}.yaml": _map_server(floor).encode(),
        f"{NAME}.geojson": json.dumps(_collection(maps, site), indent=1).encode() + b"\n",
        f"{NAME}.csv": _table(maps).encode(),
    }
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            (folder / name).write_bytes(data)
    return [folder / name for name in files]


def _picture(floor: Floor, values: np.ndarray) -> bytes:
    """A PNG by map_server's «scale»: white is 0, black is 100, and unknown is transparent."""
    shade = 255 - np.round(2.55 * np.maximum(values, 0)).astype(np.uint8)
    alpha = np.where(values == UNKNOWN, 0, 255).astype(np.uint8)
    pixels = np.stack([shade, shade, shade, alpha], axis=-1).reshape(floor.rows, floor.columns, 4)
    is_done, data = cv2.imencode(".png", pixels[::-1])
    if not is_done:
        raise OperationError(f"{NAME}.png could not be encoded")
    return data.tobytes()


def _map_server(floor: Floor) -> str:
    x, y = floor.origin
    return (
        f"image: {NAME}.png\n"
        "mode: scale\n"
        f"resolution: {floor.cell_m:g}\n"
        f"origin: [{x:.3f}, {y:.3f}, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 1.0\n"
        "free_thresh: 0.0\n"
    )


def _collection(maps: Sequence[AccuracyMap], site: str) -> dict[str, Any]:
    """GeoJSON. Its coordinates are metres in the map, as `frame` says, and no degrees."""
    features = []
    for each in maps:
        for number, name in enumerate(each.names):
            said = {"camera": name, "lost_m2": round(each.lost_m2(number, np.inf), 2)}
            features.append(_feature(each, each.sees[number], said))
        for within_m in WITHIN_M:
            cells = np.isfinite(each.error_m) & (each.error_m <= within_m)
            said = {"corrected": class_name(within_m)}
            features.append(_feature(each, cells, said))
    return {"type": "FeatureCollection", "site": site, "frame": "map", "features": features}


def _feature(each: AccuracyMap, cells: np.ndarray, said: dict[str, Any]) -> dict[str, Any]:
    floor = each.floor
    cells = cells & each.is_floor
    area_m2 = round(floor.area_m2 * int(cells.sum()), 2)
    polygons = [
        [np.round(floor.origin + ring * floor.cell_m, 4).tolist() for ring in polygon]
        for polygon in outlines(cells.reshape(floor.rows, floor.columns))
    ]
    return {
        "type": "Feature",
        "properties": {"robots": list(each.robots), **said, "area_m2": area_m2},
        "geometry": {"type": "MultiPolygon", "coordinates": polygons},
    }


def _table(maps: Sequence[AccuracyMap]) -> str:
    """One row a cell that is floor, and target; an empty field where nothing corrects."""
    lines = [_CSV]
    for each in maps:
        centres = each.floor.centres
        worst, cameras = each.worst_camera, each.usual_cameras
        numbers = (each.error_m, each.best_m, each.worst_m, each.without_worst_m)
        for cell in np.flatnonzero(each.is_floor).tolist():
            error, best, bad, without = (_metres(column[cell]) for column in numbers)
            x, y = centres[cell]
            name = each.names[worst[cell]] if worst[cell] != NOBODY else ""
            lines.append(
                f"{' '.join(each.robots)},{x:.3f},{y:.3f},{error},{best},{bad},{cameras[cell]},"
                f"{name},{without}"
            )
    return "\n".join(lines) + "\n"


def _metres(value: float) -> str:
    return f"{value:.5f}" if np.isfinite(value) else ""
