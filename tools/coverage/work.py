"""From a network or a session to the maps of corrections, and those with one more camera."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.errors import InputError
from trigpoint.fusion.coverage.accuracy_map import AccuracyMap, accuracy_map
from trigpoint.fusion.coverage.floor import DRIVEN_M, Floor, each_decimetre, floor_of
from trigpoint.fusion.coverage.known_network import Carried, KnownNetwork, carried_by, known_network
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.reading.sight import Eye
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import load_covariance, load_network, load_tum
from trigpoint.site.config import load_site
from trigpoint.site.option import site_here
from trigpoint.site.target import load_target
from trigpoint.tools.calibrate.work import fed, task_of

MOST_CELLS = 4_000_000
"""A floor of 200 m × 200 m; beyond it something is not where it should be."""


class Known(Struct, frozen=True, eq=False):
    """What the maps are made from. `carried`: what robots carry; `driven` (n, 2): where they
    drove."""

    site: str
    network: KnownNetwork
    carried: tuple[Carried, ...]
    driven: Array


class Gain(Struct, frozen=True, eq=False):
    """What a candidate would add. `now`, `then`: the maps without and with it."""

    camera: str
    now: tuple[AccuracyMap, ...]
    then: tuple[AccuracyMap, ...]

    def area_m2(self, within_m: float, *, failing: bool = False) -> float:
        """How much floor more is corrected to within so much; of several targets, the least."""
        pairs = zip(self.now, self.then, strict=True)
        return min(
            b.area_m2(within_m, failing=failing) - a.area_m2(within_m, failing=failing)
            for a, b in pairs
        )


def known_of(path: Path, *, site: Path | None, robots: Sequence[str]) -> Known:
    """By a network with the site file beside it, or by a session, which is calibrated. Raises
    InputError in one line."""
    if path.suffix == ".json" or (path.is_dir() and (path / "network.json").exists()):
        loaded = load_site(_site_file(path, site))
        targets = {n: load_target(loaded.path(loaded.target_name(n))) for n in loaded.robots}
        results = _saved(path)
    else:
        task = task_of(path, site=site)
        pipeline = fed(task.messages(), task.inputs, source=path)
        pipeline.finish()
        loaded, targets, results = task.inputs.site, task.inputs.targets, pipeline.results()
    network = results.network
    if not network.located:
        raise InputError(f"{path}: locates no camera, so no robot is corrected; calibrate first")
    chosen = {name: loaded.robot(name) for name in (robots or loaded.robots)}
    if not chosen:
        raise InputError("the site file has no robot; add [robots.r1] with its target")
    carried = carried_by(chosen, targets, network)
    driven = each_decimetre([poses.translation for _, poses in results.trajectories.values()])
    return Known(loaded.name, known_network(network, results.covariance), carried, driven)


def maps_of(
    known: Known,
    candidates: Sequence[Eye],
    *,
    driven_only: bool,
    step: Callable[[int], None] = lambda _cells: None,
) -> tuple[tuple[AccuracyMap, ...], list[Gain]]:
    """The maps of each target; and what each candidate would add, in the order given. Each is taken
    to be located as well as the middle one of the network's cameras."""
    network = joined = known.network
    usual = network.usual_covariance
    for candidate in candidates:
        joined = joined.with_camera(candidate, usual)
    floor = floor_of(joined, known.carried, known.driven, most_cells=MOST_CELLS)
    wanted = floor.near(known.driven, DRIVEN_M) if driven_only else None
    now = tuple(
        accuracy_map(network, each, floor, known.driven, wanted=wanted, step=step)
        for each in known.carried
    )
    gains = []
    for candidate in candidates:
        more = network.with_camera(candidate, usual)
        pairs = [
            _with_one_more(known, more, each, old, floor, wanted)
            for each, old in zip(known.carried, now, strict=True)
        ]
        gains.append(Gain(candidate.name, *(tuple(maps) for maps in zip(*pairs, strict=True))))
    return now, gains


def _with_one_more(
    known: Known,
    network: KnownNetwork,
    carried: Carried,
    old: AccuracyMap,
    floor: Floor,
    wanted: np.ndarray | None,
) -> tuple[AccuracyMap, AccuracyMap]:
    """The old map and the new one on the cells that the last camera of a network may see: it
    changes nothing on the others."""
    near = network.eyes[-1].may_see(carried.faces, floor.centres)
    if wanted is not None:
        near &= wanted
    new = accuracy_map(network, carried, floor, known.driven, wanted=near)
    return replace(old, is_floor=near), new


def _site_file(network: Path, given: Path | None) -> Path:
    """The site file of a network: the one given, one beside it or a folder up, or that of here."""
    folder = network if network.is_dir() else network.parent
    beside = (folder / "site.toml", folder.parent / "site.toml")
    found = given or next((path for path in beside if path.exists()), None) or site_here()
    if found is None:
        raise InputError(
            f"{network}: a network does not say what robots carry; give the site file with --site"
        )
    return found


def _saved(path: Path) -> Results:
    """A network with what lies beside it: its covariance, and those trajectories that are there."""
    network, folder = load_network(path), path if path.is_dir() else path.parent
    trajectories = {
        name: load_tum(folder / robot.trajectory)
        for name, robot in network.robots.items()
        if robot.trajectory is not None and (folder / robot.trajectory).exists()
    }
    return Results(network, load_covariance(path, network), trajectories)
