"""The estimators that `[fusion] estimator` in the site file chooses from, imported when chosen."""

import importlib

from trigpoint.base.errors import ConfigError
from trigpoint.fusion.model.assembly import estimates_faces
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.site.config import Site

from .interface import Estimator

_ROOMS = "trigpoint.fusion.estimators"
ESTIMATORS = {
    "smoother": f"{_ROOMS}.smoother.smoother:Smoother",
    "particle": f"{_ROOMS}.filters.particle_filter:particle_filter",
    "ekf": f"{_ROOMS}.filters.extended_kalman_filter:extended_kalman_filter",
}


def make_estimator(data: DataSet) -> Estimator:
    """The estimator that the site file names."""
    module, name = ESTIMATORS[data.site.fusion.estimator].split(":")
    return getattr(importlib.import_module(module), name)(data)


def check_estimator(site: Site) -> None:
    """Raise ConfigError where the site file asks for what its estimator does not estimate."""
    chosen = site.fusion.estimator
    if chosen == "smoother":
        return
    asked = []
    if estimates_faces(site.fusion):
        asked.append("the faces' places on the robot (fusion.target_translation, target_rotation)")
    for name, camera in site.cameras.items():
        if camera.estimates_intrinsics:
            asked.append(f"the intrinsics of camera {name}")
        if camera.time_offset_sigma > 0 and chosen == "particle":
            asked.append(f"the time offset of camera {name} (time_offset_sigma)")
    if asked:
        raise ConfigError(
            f"the estimator «{chosen}» does not estimate {asked[0]}; "
            'write estimator = "smoother", or leave that out'
        )
