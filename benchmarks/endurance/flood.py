"""Sends far too much as one of a site's cameras.

    python -m benchmarks.endurance.flood SITE CAMERA SECONDS

Half are pictures of 200 kB, half garbage on the camera's sightings, each as fast as it goes, for
so long: what a broken or a stolen camera can do within its rules.
"""

import sys
import time
from pathlib import Path

from trigpoint.contract.access import Kind
from trigpoint.contract.topics import IMAGE, SIGHTINGS
from trigpoint.site.config import load_site
from trigpoint.zenoh import open_bus

_PAUSE_S = 0.001


def main() -> None:
    path, camera, seconds = sys.argv[1:]
    site = load_site(Path(path))
    with open_bus(site, (Kind.CAMERA, camera)) as bus:
        pictures = bus.publisher(IMAGE, IMAGE.key(site.name, camera))
        garbage = bus.publisher(SIGHTINGS, SIGHTINGS.key(site.name, camera))
        end_s = time.monotonic() + float(seconds)
        while time.monotonic() < end_s:
            pictures.put(bytes(200_000))
            garbage.put(b"garbage")
            time.sleep(_PAUSE_S)


if __name__ == "__main__":
    main()
