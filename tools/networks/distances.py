"""The command `distances`: the network's distances between cameras, beside a tape measure's."""

import csv
import itertools
import json as json_text
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct

from trigpoint.base.errors import InputError, read_text
from trigpoint.base.terminal import table
from trigpoint.base.words import counted, nearest
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network, load_covariance, load_network

from .changes import changes, changes_json, changes_table, check_file

_HEAD = ("camera", "camera", "metres")
_MOST_TAPE_SIGMA_M = 1.0
_FAR_SIGMAS = 3.0


class Measured(Struct, frozen=True):
    """A tape measure's distance between two cameras, and its standard deviation; metres."""

    first: str
    second: str
    metres: float
    sigma_m: float


class Distances(Struct, frozen=True, eq=False):
    """Distances by the network (n,) between pairs, and their joint covariance (n, n); metres."""

    pairs: tuple[tuple[str, str], ...]
    metres: Array
    covariance: Array

    @property
    def sigmas_m(self) -> Array:
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def expected_error_m(self) -> float | None:
        """Mean error of these distances that their covariance lets one expect; None of none."""
        return expected_error(self.sigmas_m) if self.pairs else None


class Comparison(Struct, frozen=True, eq=False):
    """The network beside a tape measure: `difference_m` (n,) network minus tape, and its joint
    covariance (n, n), which holds both uncertainties."""

    measured: tuple[Measured, ...]
    network: Distances
    difference_m: Array
    covariance: Array

    @property
    def sigmas_m(self) -> Array:
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def mean_error_m(self) -> float:
        return float(np.mean(np.abs(self.difference_m)))

    @property
    def expected_error_m(self) -> float:
        """The mean error expected from the sigmas."""
        return expected_error(self.sigmas_m)

    @property
    def chi2_per_distance(self) -> float:
        """1 on average if both uncertainties are as stated."""
        solved = np.linalg.solve(self.covariance, self.difference_m)
        return float(self.difference_m @ solved) / len(self.difference_m)


def main(
    network: Annotated[Path, typer.Argument(help="A network.json, or the folder it is in.")],
    newer: Annotated[
        Path | None,
        typer.Argument(help="Or a later network.json: which cameras moved since the first."),
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option(help="A tape measure's distances: rows of camera,camera,metres[,sigma]."),
    ] = None,
    tape_sigma: Annotated[
        float, typer.Option(help="Standard deviation of a measured distance, m, if not in its row.")
    ] = 0.002,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead.")] = False,
) -> None:
    """The distances between cameras with their standard deviations, beside a tape measure's.

    The standard deviations come from the joint covariance, so what all cameras are off together
    does not count. Given two networks: how far each camera moved between them, and how surely.
    """
    if newer is not None:
        found = changes(load_network(network), load_network(check_file(newer)))
        typer.echo(changes_json(found) if json else changes_table(found))
        return
    if not 0 < tape_sigma <= _MOST_TAPE_SIGMA_M:
        raise InputError(
            f"--tape-sigma {tape_sigma:g}: must be above 0 and at most {_MOST_TAPE_SIGMA_M:g} m"
        )
    found = load_network(network)
    covariance = load_covariance(network, found)
    if measured is None:
        if len(found.located) < 2:
            raise InputError(f"{network}: fewer than two cameras are located; there is no distance")
        every = distances(found, covariance)
        typer.echo(_as_json(_rows(every)) if json else _table(every))
        return
    compared = compare(found, covariance, read_measured(measured, found, sigma_m=tape_sigma))
    typer.echo(_compared_json(compared) if json else _compared_table(compared))


def distances(
    network: Network, covariance: Array, pairs: Iterable[tuple[str, str]] | None = None
) -> Distances:
    """Of pairs of located cameras, or all of them; `covariance`: joint, (6n, 6n), in the order of
    `located`."""
    order = {name: i for i, name in enumerate(network.located)}
    chosen = tuple(itertools.combinations(order, 2) if pairs is None else pairs)
    places = np.array([_place(network, name) for name in order]).reshape(-1, 3)
    ends = np.array([(order[a], order[b]) for a, b in chosen], dtype=int).reshape(-1, 2)
    return Distances(chosen, *joint_distances(places, covariance, ends))


def joint_distances(places: Array, covariance: Array, ends: np.ndarray) -> tuple[Array, Array]:
    """Metres (m,) and their joint covariance (m, m), between pairs `ends` (m, 2), numbers, of
    places (n, 3) that are known as `covariance` (6n, 6n) of their poses says.

    A distance's derivative by the one place is the unit vector towards it, by the other its
    negative.
    """
    apart = places[ends[:, 0]] - places[ends[:, 1]]
    metres = np.linalg.norm(apart, axis=1)
    towards = apart / np.maximum(metres, 1e-9)[:, None]
    gradients = np.zeros((len(ends), len(places), 6))
    rows = np.arange(len(ends))
    gradients[rows, ends[:, 0], :3] = towards
    gradients[rows, ends[:, 1], :3] = -towards
    flat = gradients.reshape(len(ends), len(covariance))
    return metres, flat @ covariance @ flat.T


def expected_error(sigmas: Array) -> float:
    """The mean size of errors with these sigmas: E|x| of a normal x is σ √(2/π)."""
    return float(np.mean(sigmas) * math.sqrt(2 / math.pi))


def compare(network: Network, covariance: Array, measured: Iterable[Measured]) -> Comparison:
    """Compare the network with measured distances between located cameras."""
    rows = tuple(measured)
    mine = distances(network, covariance, ((row.first, row.second) for row in rows))
    tape = np.diag([row.sigma_m**2 for row in rows])
    difference = mine.metres - [row.metres for row in rows]
    return Comparison(rows, mine, difference, mine.covariance + tape)


def read_measured(path: Path, network: Network, *, sigma_m: float) -> list[Measured]:
    """Read rows of camera,camera,metres[,sigma]; a header row of these words, empty rows and rows
    that begin with # are skipped. Raises an InputError that names file and line."""
    text = read_text(path, "file of distances", InputError)
    found = []
    for number, fields in enumerate(csv.reader(text.splitlines(), skipinitialspace=True), start=1):
        cells = [field.strip() for field in fields]
        if not any(cells) or cells[0].startswith("#") or _is_head(number, cells):
            continue
        try:
            found.append(_measured(cells, network, sigma_m))
        except ValueError as reason:
            raise InputError(f"{path}:{number}: {reason}") from None
    if not found:
        raise InputError(f"{path}: no distance is in it; write rows of camera,camera,metres")
    return found


def _is_head(number: int, cells: list[str]) -> bool:
    return number == 1 and tuple(cell.lower() for cell in cells[:3]) == _HEAD


def _measured(cells: list[str], network: Network, sigma_m: float) -> Measured:
    if len(cells) not in (3, 4):
        raise ValueError(
            f"a row has camera,camera,metres and perhaps sigma, but here are {len(cells)} fields; "
            "separate them by commas and write decimals with a point"
        )
    first, second = (_located(name, network) for name in cells[:2])
    if first == second:
        raise ValueError(f"the distance of camera {first} from itself; name two cameras")
    metres = _number(cells[2], "distance")
    sigma = _number(cells[3], "sigma") if len(cells) == 4 else sigma_m
    if sigma >= _MOST_TAPE_SIGMA_M:
        raise ValueError(
            f"a sigma of {sigma:g} m; write decimals with a point, and the sigma in metres"
        )
    return Measured(first, second, metres, sigma)


def _located(name: str, network: Network) -> str:
    if name not in network.cameras:
        raise ValueError(f"the network has no camera «{name}»{nearest(name, network.cameras)}")
    if name not in network.located:
        status = network.cameras[name].status
        raise ValueError(f"camera {name} is {status} and has no place; leave the row out")
    return name


def _number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"the {what} «{text}» is not a number; write metres, as 3.412") from None
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"the {what} «{text}» must be above 0; write metres, as 3.412")
    return value


def _place(network: Network, name: str) -> Array:
    record = network.cameras[name].map_from_camera
    assert record is not None  # it is located
    return np.array(record.translation)


def _table(found: Distances) -> str:
    rows = [
        (*pair, f"{metres:.4f}", f"{100 * sigma:.2f}")
        for pair, metres, sigma in zip(found.pairs, found.metres, found.sigmas_m, strict=True)
    ]
    return table(("from", "to", "network m", "sigma cm"), rows, left=(0, 1))


def _compared_table(found: Comparison) -> str:
    head = ("from", "to", "measured m", "network m", "difference cm", "sigma cm", "in sigmas")
    in_sigmas = found.difference_m / found.sigmas_m
    rows = [
        (
            row.first,
            row.second,
            f"{row.metres:.4f}",
            f"{found.network.metres[i]:.4f}",
            f"{100 * found.difference_m[i]:+.2f}",
            f"{100 * found.sigmas_m[i]:.2f}",
            f"{in_sigmas[i]:+.1f}",
        )
        for i, row in enumerate(found.measured)
    ]
    colours = ["red" if abs(value) > _FAR_SIGMAS else "" for value in in_sigmas]
    count = len(found.measured)
    return "\n".join(
        [
            table(head, rows, left=(0, 1), colours=colours),
            f"mean error of {counted(count, 'distance')}: {100 * found.mean_error_m:.2f} cm; "
            f"expected by the sigmas: {100 * found.expected_error_m:.2f} cm",
            f"chi² per distance, by the joint covariance: {found.chi2_per_distance:.2f}",
        ]
    )


def _rows(found: Distances) -> dict[str, object]:
    rows = zip(found.pairs, found.metres.tolist(), found.sigmas_m.tolist(), strict=True)
    return {
        "distances": [
            {"from": a, "to": b, "network": metres, "network_sigma": sigma}
            for (a, b), metres, sigma in rows
        ]
    }


def _compared_json(found: Comparison) -> str:
    rows = [
        {
            "from": row.first,
            "to": row.second,
            "measured": row.metres,
            "measured_sigma": row.sigma_m,
            "network": float(found.network.metres[i]),
            "network_sigma": float(found.network.sigmas_m[i]),
            "difference": float(found.difference_m[i]),
            "sigma": float(found.sigmas_m[i]),
        }
        for i, row in enumerate(found.measured)
    ]
    summary = {
        "mean_error": found.mean_error_m,
        "expected_error": found.expected_error_m,
        "chi2_per_distance": found.chi2_per_distance,
    }
    return _as_json({"distances": rows, **summary})


def _as_json(value: dict[str, object]) -> str:
    return json_text.dumps(value, indent=1)
