"""The command `fusion`."""

import logging
import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.clock import SteadyClock
from trigpoint.base.errors import OperationError
from trigpoint.contract import cdr
from trigpoint.contract.access import Kind
from trigpoint.metrics.serving import metrics_served
from trigpoint.node.node import Node, stopped_by_signals
from trigpoint.site.config import Site, load_site
from trigpoint.site.option import SITE_FILE, MetricsAt, SiteFile
from trigpoint.zenoh import open_bus

from .inputs import load_fixed, load_inputs
from .live.memory import return_large_arrays
from .live.solver_messages import Solver
from .live.solver_process import START_S, SolverProcess
from .model.inputs import Inputs
from .node import KIND, NAME, FusionNode

_log = logging.getLogger(__name__)


def main(
    site: SiteFile = SITE_FILE,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of network.json and the checkpoint; «network» beside the site.",
            file_okay=False,
        ),
    ] = None,
    network: Annotated[
        Path | None, typer.Option(help="A network.json whose cameras are known beforehand.")
    ] = None,
    metrics: MetricsAt = "",
) -> None:
    """The live estimator: odometry and sightings in, the network and corrections out.

    Writes network.json when it stops and on demand. Killed and started again with the same --out it
    resumes its map. With [fusion] learn = false the network is fixed: corrections only.
    """
    loaded = load_site(site)
    inputs = load_inputs(loaded, network=network)
    folder = out if out is not None else loaded.path("network")
    fixed = load_fixed(inputs, network=network, folder=folder)
    clock = SteadyClock()
    cdr.warm_up()
    return_large_arrays()
    with open_bus(loaded, (Kind.FUSION, NAME)) as bus, ExitStack() as stack:
        node = Node(bus, site=loaded.name, kind=KIND, name=NAME, clock=clock)
        with metrics_served(loaded, metrics, [node]), stopped_by_signals(node):
            solver = solver_for(loaded, node)
            fusion = FusionNode(bus, node, inputs, folder, clock, solver=solver, fixed=fixed)
            stack.push(_finishing(fusion))
            fusion.start()
            node.wait()


def _finishing(fusion: FusionNode) -> Callable[[object, BaseException | None, object], None]:
    """The callback that ends fusion after its node; an earlier error takes precedence."""

    def finish(_kind: object, error: BaseException | None, _trace: object) -> None:
        try:
            fusion.finish()
        except OperationError as reason:
            if error is None:
                raise
            _log.error("%s", reason)

    return finish


def solver_for(site: Site, node: Node) -> Callable[[Inputs], Solver] | None:
    """The factory of the solver beside the corrections; None for estimators that need none."""
    if site.fusion.estimator != "smoother":
        return None

    last_s = math.nan

    def took(seconds: float) -> None:
        nonlocal last_s
        last_s = seconds
        node.health.observe("solving", seconds)

    def solver(inputs: Inputs) -> Solver:
        pulse = node.watchdog.pulse(f"{node.label} solves", within_s=START_S)
        return SolverProcess(inputs.data_set(), pulse, node.watchdog.forget, took)

    node.health.gauge("last_solving_s", lambda: last_s)

    return solver
