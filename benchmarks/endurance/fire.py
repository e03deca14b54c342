"""`python -m benchmarks.endurance.fire`: ten minutes of a site under fire."""

import socket
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer
from support.site.faulty_run import assert_site_stays_undisturbed


def main(
    seconds: Annotated[float, typer.Option(help="How long it drives.")] = 600.0,
    seed: Annotated[int, typer.Option(help="Draws the moments.")] = 1,
) -> None:
    """Fusion and the recorder under floods, malformed messages, wrong clocks, doubles, a stopped
    subscriber, a kill and a damaged checkpoint; the network must be the undisturbed one's."""
    began_s = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with tempfile.TemporaryDirectory(prefix="trigpoint-fire-") as folder:
        assert_site_stays_undisturbed(Path(folder), port, seconds=seconds, seed=seed)
    print(f"under fire for {seconds:.0f} s: held ({time.monotonic() - began_s:.0f} s in all)")


if __name__ == "__main__":
    typer.run(main)
