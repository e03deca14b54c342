"""Reads the files that a pipeline needs: targets, intrinsics, an earlier network."""

from pathlib import Path

from trigpoint.base.errors import InputError
from trigpoint.geometry import CameraModel
from trigpoint.map.network import load_covariance, load_network
from trigpoint.site.camera_info import read_camera_info
from trigpoint.site.config import Site
from trigpoint.site.target import Target, load_target

from .checkpoint import CHECKPOINT, has_map
from .estimators.registry import check_estimator
from .fixed.network import FixedNetwork
from .model.inputs import Inputs
from .model.known_cameras import Creep, KnownCameras, known_cameras


def load_inputs(site: Site, *, network: Path | None = None) -> Inputs:
    """Everything that the site file names; raise InputError with one clear line."""
    targets = {name: load_target(site.path(site.target_name(name))) for name in site.robots}
    return make_inputs(site, targets, load_lenses(site), network=network)


def make_inputs(
    site: Site,
    targets: dict[str, Target],
    lenses: dict[str, CameraModel],
    *,
    network: Path | None = None,
) -> Inputs:
    """Inputs from targets and lenses that are loaded already."""
    check_estimator(site)
    _ = site.first_robot  # refuses a site without one, before anything is opened
    if network is None:
        return Inputs(site, targets, lenses)
    known, records = load_known(network, site), load_network(network).cameras
    in_network = {n: lens.camera for n in known.poses if (lens := records[n].intrinsics)}
    return Inputs(site, targets, in_network | lenses, known)


def load_lenses(site: Site) -> dict[str, CameraModel]:
    """The lenses that files give; raise InputError where a file does not fit its camera."""
    lenses = {}
    for name, camera in site.cameras.items():
        if camera.intrinsics is None or camera.estimates_intrinsics:
            continue
        path = site.path(camera.intrinsics)
        lens = read_camera_info(path)
        if (lens.width, lens.height) != (camera.width, camera.height):
            raise InputError(
                f"{path}: intrinsics for {lens.width} × {lens.height}, but camera {name} is set to "
                f"{camera.width} × {camera.height}; give it the right file or size"
            )
        lenses[name] = lens
    return lenses


def load_known(path: Path, site: Site) -> KnownCameras:
    """The cameras of an earlier network that this site has too; raise InputError for none."""
    network = load_network(path)
    if network.map != "map":
        raise InputError(f"{path}: is in the frame «{network.map}»; give the one in the map")
    joint = load_covariance(path, network)
    known = known_cameras(network, joint, site.cameras, creep=Creep.of_all(site.cameras))
    if not known.poses:
        raise InputError(
            f"{path}: locates none of this site's cameras; check the names, and what the "
            "calibration that wrote it said"
        )
    return known


def load_fixed(inputs: Inputs, *, network: Path | None, folder: Path) -> FixedNetwork | None:
    """The network that is held from the beginning, where the site learns nothing; None where it
    does, or where the map in the folder of a checkpoint is to be held.

    Raises InputError where there is neither.
    """
    site = inputs.site
    if site.fusion.learn:
        return None
    if network is not None:
        document = load_network(network)
        return FixedNetwork(document, load_covariance(network, document), inputs.known)
    if not has_map(folder):
        raise InputError(
            "[fusion] learn = false, but there is no network to hold fixed: give "
            f"--network network.json, or the --out of a map that was learnt ({folder} has no "
            f"{CHECKPOINT}), or write learn = true"
        )
    return None
