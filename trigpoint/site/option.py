"""Options of the commands that run a site. `--site`: else $TRIGPOINT_SITE, else ./site.toml."""

import os
from pathlib import Path
from typing import Annotated

import typer

VARIABLE = "TRIGPOINT_SITE"
SITE_FILE = Path("site.toml")

SiteFile = Annotated[Path, typer.Option(help="The site file.", envvar=VARIABLE)]
"""To be used with the default `SITE_FILE`."""

MetricsAt = Annotated[
    str,
    typer.Option(
        "--metrics",
        metavar="HOST:PORT",
        envvar="TRIGPOINT_METRICS",
        help="Where to serve Prometheus's /metrics, instead of [metrics] listen in the site file; "
        "port 0: one that is free. «off»: nowhere.",
    ),
]


def site_here() -> Path | None:
    """The site file where none is given, for commands that can do without; None where none is."""
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named)
    return SITE_FILE if SITE_FILE.exists() else None
