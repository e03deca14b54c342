"""Trigpoint surveys the cameras of a building by driving a robot past them.

`import trigpoint as tp`: what `__all__` names is public, and docs/python.md has an example of each;
all other modules may change with every version.
"""

__version__ = "0.1.0"

CONTRACT = 1
"""Version of the bus and file contract; nodes announce it and report peers with another one."""

TYPE_CHECKING = False  # as typing's, which takes as long to import as all of this
if TYPE_CHECKING:
    from trigpoint.api.calibration import Calibration, calibrate
    from trigpoint.api.networks import (
        Alternative,
        Camera,
        EarlierPose,
        Network,
        Robot,
        Trajectory,
        read_network,
        read_trajectory,
    )
    from trigpoint.api.pictures import Lens, detect, detect_all, intrinsics, read_target
    from trigpoint.api.sessions import Session, open_session, write_session
    from trigpoint.base.errors import InputError, MissingExtraError, OperationError, TrigpointError
    from trigpoint.contract.messages import FaceSighting, Sightings
    from trigpoint.fusion.estimators.residuals import CameraResiduals
    from trigpoint.geometry.camera import CameraModel
    from trigpoint.geometry.pose import Pose
    from trigpoint.site.target import Target
    from trigpoint.tools.networks.distances import Distances
    from trigpoint.tools.networks.truth import CameraError, NetworkError

    from .api import plugins

__all__ = [
    "CONTRACT",
    "Alternative",
    "Calibration",
    "Camera",
    "CameraError",
    "CameraModel",
    "CameraResiduals",
    "Distances",
    "EarlierPose",
    "FaceSighting",
    "InputError",
    "Lens",
    "MissingExtraError",
    "Network",
    "NetworkError",
    "OperationError",
    "Pose",
    "Robot",
    "Session",
    "Sightings",
    "Target",
    "Trajectory",
    "TrigpointError",
    "__version__",
    "calibrate",
    "detect",
    "detect_all",
    "intrinsics",
    "open_session",
    "plugins",
    "read_network",
    "read_target",
    "read_trajectory",
    "write_session",
]

_PLACES = {
    "api.calibration": "Calibration calibrate",
    "api.networks": "Alternative Camera EarlierPose Network Robot Trajectory read_network"
    " read_trajectory",
    "api.pictures": "Lens detect detect_all intrinsics read_target",
    "api.plugins": "plugins",
    "api.sessions": "Session open_session write_session",
    "base.errors": "InputError MissingExtraError OperationError TrigpointError",
    "contract.messages": "FaceSighting Sightings",
    "fusion.estimators.residuals": "CameraResiduals",
    "geometry.camera": "CameraModel",
    "geometry.pose": "Pose",
    "site.target": "Target",
    "tools.networks.distances": "Distances",
    "tools.networks.truth": "CameraError NetworkError",
}
"""Module -> its public names, imported when they are first asked for: commands start fast, and no
machine needs what its part does not use."""


def __getattr__(name: str) -> object:
    for place, names in _PLACES.items():
        if name in names.split():
            import importlib  # not needed by whoever wants a part alone

            load = importlib.import_module(f"{__name__}.api").load
            globals()[name] = found = load(f"{__name__}.{place}", name)
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
