"""Places for one more camera, by a file like the one of a simulated world.

```toml
[cameras.over_door]
position = [3.0, 1.2, 2.6]        # in the map, m
yaw = 90.0                        # where it looks, degrees from the map's x axis towards y,
pitch = 35.0                      # below the horizon,
roll = 0.0                        # and turned about its axis
like = "c1"                       # the lens and noise of a camera of the network; or
width = 1280
height = 720
horizontal_fov = 70.0             # degrees; or intrinsics = "lens.yaml"
```
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from trigpoint.base.errors import InputError
from trigpoint.base.words import nearest
from trigpoint.fusion.coverage.known_network import KnownNetwork
from trigpoint.fusion.reading.sight import Eye
from trigpoint.geometry import CameraModel, Pose
from trigpoint.site.camera_info import read_camera_info
from trigpoint.site.config.number_types import Count, Positive
from trigpoint.site.toml_file import load_toml
from trigpoint.tools.simulation.world import looking


class CandidateSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One place. `sigma` of a corner's coordinate, pixels: else the network's usual one."""

    position: tuple[float, float, float]
    yaw: float
    pitch: float
    roll: float = 0.0
    like: str | None = None
    width: Count | None = None
    height: Count | None = None
    horizontal_fov: Annotated[float, Meta(gt=0, lt=180)] | None = None
    intrinsics: str | None = None
    sigma: Positive | None = None

    def __post_init__(self) -> None:
        is_described = None not in (self.width, self.height, self.horizontal_fov)
        ways = (self.like is not None, self.intrinsics is not None, is_described)
        if sum(ways) != 1:
            raise ValueError(
                'a place needs one lens: like = "c1", or intrinsics = "lens.yaml", or width, '
                "height and horizontal_fov"
            )


class CandidatesFile(Struct, frozen=True, forbid_unknown_fields=True):
    cameras: dict[str, CandidateSpec]


def load_candidates(path: Path, network: KnownNetwork) -> list[Eye]:
    """The candidates of a file, in its order; raise InputError that names file, line and key."""
    file = load_toml(path, CandidatesFile, "candidates file", InputError)
    if not file.cameras:
        raise InputError(f"{path}: names no place; add a table like [cameras.over_door]")
    for name in file.cameras:
        if name in network.names:
            raise InputError(f"{path}: {name} is a camera of the network; give it another name")
    return [_candidate(path, name, spec, network) for name, spec in file.cameras.items()]


def _candidate(path: Path, name: str, spec: CandidateSpec, network: KnownNetwork) -> Eye:
    lens, sigma_px = _lens(path, name, spec, network)
    pose = Pose(looking(spec.yaw, spec.pitch, spec.roll), np.array(spec.position))
    return Eye(name, pose, lens, spec.sigma or sigma_px)


def _lens(
    path: Path, name: str, spec: CandidateSpec, network: KnownNetwork
) -> tuple[CameraModel, float]:
    if spec.like is not None:
        for eye in network.eyes:
            if eye.name == spec.like:
                return eye.lens, eye.sigma_px
        raise InputError(
            f"{path}: cameras.{name}.like: the network locates no camera «{spec.like}»"
            f"{nearest(spec.like, list(network.names))}"
        )
    if spec.intrinsics is not None:
        return read_camera_info(path.parent / spec.intrinsics), network.usual_sigma_px
    assert spec.width is not None  # the struct's check
    assert spec.height is not None
    assert spec.horizontal_fov is not None
    wide_rad = float(np.radians(spec.horizontal_fov))
    lens = CameraModel.from_field_of_view(spec.width, spec.height, wide_rad)
    return lens, network.usual_sigma_px
