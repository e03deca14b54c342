"""Which lens a camera announces."""

import logging

from trigpoint.camera_info import read_camera_info
from trigpoint.config import Site
from trigpoint.errors import ConfigError
from trigpoint.geometry import CameraModel

_log = logging.getLogger(__name__)


def calibrated_lens(site: Site, camera: str) -> CameraModel | None:
    """The lens in the file that the site names, None where it names none; raises InputError."""
    config = site.camera(camera)
    if config.intrinsics is None or config.estimates_intrinsics:
        return None
    return read_camera_info(site.path(config.intrinsics))


def announced_lens(
    site: Site, camera: str, calibrated: CameraModel | None, own: CameraModel | None
) -> CameraModel:
    """The calibrated lens, else the source's own, else the nominal one, which is warned of.

    The nominal one is a start to estimate from; taken as known it spoils every result.
    """
    if (known := calibrated or own) is not None:
        return known
    config = site.camera(camera)
    if not config.estimates_intrinsics:
        _log.warning(
            "camera %s has no intrinsics: a plain lens of %.0f degrees is announced; "
            'give intrinsics = "FILE.yaml", or "estimate"',
            camera,
            config.horizontal_fov,
        )
    return config.nominal()


def check_size(camera: str, lens: CameraModel, shape: tuple[int, ...]) -> None:
    """Raise ConfigError where the lens is for pictures of another size; `shape`: rows, columns."""
    height, width = shape[:2]
    if (width, height) != (lens.width, lens.height):
        raise ConfigError(
            f"camera {camera}: its pictures are {width} × {height}, but its intrinsics are for "
            f"{lens.width} × {lens.height}; correct width and height, or the intrinsics file"
        )
