"""The machine and the libraries of a run, as far as its numbers depend on them."""

import os
import platform
from importlib.metadata import version

from msgspec import Struct

LIBRARIES = ("eclipse-zenoh", "mcap", "numpy", "opencv-python-headless", "rosbags", "trigpoint")


class Machine(Struct, frozen=True):
    """`load`: processes that wanted to run over the last minute, when the run began."""

    cores: int
    load: float
    architecture: str
    python: str
    libraries: dict[str, str]

    @property
    def summary(self) -> str:
        """One line."""
        busy = "busy with other work" if self.load > 0.3 else "idle otherwise"
        return (
            f"{self.cores} cores, {self.architecture}, Python {self.python}; load {self.load:.1f} "
            f"at the start: {busy}"
        )


def machine() -> Machine:
    """This one, now."""
    return Machine(
        cores=len(os.sched_getaffinity(0)),
        load=os.getloadavg()[0],
        architecture=platform.machine(),
        python=platform.python_version(),
        libraries={name: version(name) for name in LIBRARIES},
    )
