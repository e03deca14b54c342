"""The processes of a selection."""

import os
from pathlib import Path

from trigpoint.metrics.serving import OFF
from trigpoint.site.config import Site
from trigpoint.tools.parts.specs import (
    FUSION,
    PAGE,
    RECORDER,
    agent,
    bridge,
    shares,
    trigpoint,
)
from trigpoint.tools.parts.supervisor import PartSpec

from .selection import Selection


def parts_of(site: Site, file: Path, selection: Selection) -> list[PartSpec]:
    """One process a part, the slow ones to start first; cameras share one a core."""
    name = str(file)
    specs = []
    if selection.has_recorder:
        specs.append(PartSpec("recorder", trigpoint("record", "--site", name), RECORDER))
    if selection.has_fusion:
        specs.append(PartSpec("fusion", trigpoint("fusion", "--site", name), FUSION))
    specs += [agent(some, name) for some in shares(selection.cameras, os.cpu_count() or 1)]
    specs += [bridge(robot, name) for robot in selection.robots]
    specs = _with_metrics(site, specs)
    if selection.has_board:
        specs.append(PartSpec("board", trigpoint("board", "--site", name), PAGE, optional=True))
    return specs


def _with_metrics(site: Site, specs: list[PartSpec]) -> list[PartSpec]:
    """Where the site file has a port for metrics, each part one of its own: that and the next."""
    if site.metrics.listen is None:
        return specs
    host, _, port = site.metrics.listen.rpartition(":")
    ports = [int(port) + number if int(port) else 0 for number in range(len(specs))]
    return [
        PartSpec(
            spec.name,
            (*spec.command, "--metrics", f"{host}:{port}" if port < 2**16 else OFF),
            spec.rank,
        )
        for spec, port in zip(specs, ports, strict=True)
    ]
