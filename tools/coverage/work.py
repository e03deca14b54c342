"""From a network or a session to the maps of corrections, and those with one more camera."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from trigpoint.base.errors import InputError
from trigpoint.fusion.coverage.accuracy_map import AccuracyMap, accuracy_map
from trigpoint.fusion.coverage.boards import Carried
from trigpoint.fusion.coverage.floor import DRIVEN_M, Floor, each_decimetre, floor_of
from trigpoint.fusion.coverage.known_network import KnownNetwork, carried_by, known_network
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network, load_covariance, load_network, load_tum
from trigpoint.site.config import Site, load_site
from trigpoint.site.option import site_here
from trigpoint.site.target import Target, load_target
from trigpoint.tools.calibrate.work import fed, task_of

from .candidates import Candidate

MOST_CELLS = 4_000_000
"""A floor of 200 m × 200 m; beyond it something is not where it should be."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What the maps are made from. `carried`: what robots carry; `driven` (n, 2): where they
    drove."""

    site: str
    network: KnownNetwork
    carried: tuple[Carried, ...]
    driven: Array


@dataclass(frozen=True, slots=True, eq=False)
class Gain:
    """What a candidate would add. `now`, `then`: the maps without and with it."""

    candidate: Candidate
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
        network = load_network(path)
        targets = {n: load_target(loaded.path(loaded.target_name(n))) for n in loaded.robots}
        driven = _driven_beside(path, network)
        return _known(
            path, loaded, targets, network, load_covariance(path, network), driven, robots
        )
    task = task_of(path, site=site)
    pipeline = fed(task.messages(), task.inputs, source=path)
    pipeline.finish()
    results, inputs = pipeline.results(), task.inputs
    driven = each_decimetre([poses.translation for _, poses in results.trajectories.values()])
    return _known(
        path, inputs.site, inputs.targets, results.network, results.covariance, driven, robots
    )


def _known(
    path: Path,
    site: Site,
    targets: Mapping[str, Target],
    network: Network,
    covariance: Array,
    driven: Array,
    robots: Sequence[str],
) -> Known:
    if not network.located:
        raise InputError(f"{path}: locates no camera, so no robot is corrected; calibrate first")
    for name in robots:
        site.robot(name)  # raises for one that is not there
    chosen = {name: site.robots[name] for name in (robots or site.robots)}
    if not chosen:
        raise InputError("the site file has no robot; add [robots.r1] with its target")
    carried = carried_by(chosen, targets, network)
    return Known(site.name, known_network(network, covariance), carried, driven)


def maps_of(
    known: Known,
    candidates: Sequence[Candidate],
    *,
    driven_only: bool,
    step: Callable[[int], None] = lambda _cells: None,
) -> tuple[tuple[AccuracyMap, ...], list[Gain]]:
    """The maps of each target; and what each candidate would add, in the order given."""
    network = known.network
    joined = network
    for candidate in candidates:
        joined = joined.with_camera(candidate.eye, candidate.covariance)
    floor = floor_of(joined, known.carried, known.driven, most_cells=MOST_CELLS)
    wanted = floor.near(known.driven, DRIVEN_M) if driven_only else None
    now = tuple(
        accuracy_map(network, each, floor, known.driven, wanted=wanted, step=step)
        for each in known.carried
    )
    gains = []
    for candidate in candidates:
        more = network.with_camera(candidate.eye, candidate.covariance)
        pairs = [
            _with_one_more(known, more, each, old, floor, wanted)
            for each, old in zip(known.carried, now, strict=True)
        ]
        gains.append(Gain(candidate, *(tuple(maps) for maps in zip(*pairs, strict=True))))
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
    near = network.eyes[-1].may_see(carried, floor.centres)
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


def _driven_beside(path: Path, network: Network) -> Array:
    """Where robots drove, by the trajectories beside a network."""
    folder = path if path.is_dir() else path.parent
    parts = []
    for robot in network.robots.values():
        file = folder / robot.trajectory if robot.trajectory is not None else None
        if file is not None and file.exists():
            parts.append(load_tum(file)[1].translation)
    return each_decimetre(parts)
