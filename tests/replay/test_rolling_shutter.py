"""A drive before cameras with rolling shutters, from pictures drawn row by row to the network."""

import msgspec
import numpy as np
import pytest
from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.edge.tracker import TargetTracker
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.map.network import PoseRecord
from trigpoint.site.config import Site, load_site
from trigpoint.tools.networks.truth import NetworkError, TruthFile, network_error
from trigpoint.tools.simulation.drawing.rendering import CameraRenderer
from trigpoint.tools.simulation.site_files import write_site
from trigpoint.tools.simulation.world import World, load_world

EPOCH_NS = 1_700_000_000_000_000_000
LINE_DELAY_S = 60e-6  # 480 rows in 29 ms: a webcam's at 30 Hz
# One way, past each camera once: to and fro would take back what a shutter adds. The odometry is
# good, so that the cameras are known to a millimetre.
WORLD = f"""
site = "hall"
hold_first = 0.6
hold_last = 0.2

[cameras.c1]
position = [0.2, -1.7, 1.5]
yaw = 90.0
pitch = 20.0
rate = 2.0
line_delay = {LINE_DELAY_S}

[cameras.c2]
position = [3.1, 1.0, 1.5]
yaw = 180.0
pitch = 20.0
rate = 2.0
phase = 0.1
line_delay = {LINE_DELAY_S}

[robots.r1]
waypoints = [[-1.2, 0.0], [1.2, 0.0], [1.2, 2.0]]
odometry = {{ distance = 0.001, lateral = 0.0005, heading_drive = 0.001, heading_turn = 0.0015 }}
"""


class Drive(Struct, frozen=True):
    """A world, its site file, and what came in, in order of time."""

    world: World
    site: Site
    messages: list[tuple[str, Odometry | Sightings]]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """Every picture is drawn and searched."""
    folder = tmp_path_factory.mktemp("rolling")
    (folder / "hall.toml").write_text(WORLD, encoding="utf-8")
    world = load_world(str(folder / "hall.toml"), seed=3)
    messages: list[tuple[str, Odometry | Sightings]] = []
    for camera in world.cameras:
        messages += [(camera, message) for message in _sightings(world, camera)]
    log = world.odometry("r1")
    for index, t_s in enumerate(log.stamps_s.tolist()):
        stamp_ns = EPOCH_NS + to_ns(t_s)
        messages.append(("r1", Odometry(stamp_ns, "r1/odom", "r1/base", log.poses[index])))
    messages.sort(key=lambda item: item[1].stamp_ns)
    return Drive(world, load_site(write_site(world, folder)), messages)


def _sightings(world: World, camera: str) -> list[Sightings]:
    eye, renderer = world.cameras[camera], CameraRenderer(world, camera)
    tracker, found = TargetTracker([world.target("r1")]), []
    for index, t_s in enumerate(eye.picture_times(world.duration_s).tolist()):
        stamp_ns = EPOCH_NS + to_ns(t_s)
        faces = tracker.detect(renderer.picture(index), stamp_ns)
        size = (eye.model.width, eye.model.height)
        found.append(Sightings(stamp_ns, f"{camera}/optical", *size, faces))
    return found


def errors(drive: Drive, site: Site) -> NetworkError:
    """The cameras against the truth, as a site file has them worked out."""
    lenses = {name: camera.model for name, camera in drive.world.cameras.items()}
    pipeline = Pipeline(Inputs(site, {"r1": drive.world.target("r1")}, lenses), is_live=False)
    for node, message in drive.messages:
        pipeline.push(node, message)
    pipeline.finish()
    results = pipeline.results()
    truth = {n: PoseRecord.of(c.map_from_camera) for n, c in drive.world.cameras.items()}
    return network_error(results.network, results.covariance, TruthFile(truth, {}))


def ignoring(site: Site) -> Site:
    """The same site as if every row were exposed at once."""
    cameras = {n: msgspec.structs.replace(c, line_delay=0.0) for n, c in site.cameras.items()}
    return msgspec.structs.replace(site, cameras=cameras)


def test_corners_are_found_where_their_rows_saw_them(drive: Drive) -> None:
    errors_px, rows, sigmas = [], [], []
    for camera, message in drive.messages:
        if isinstance(message, Sightings):
            t_s = (message.stamp_ns - EPOCH_NS) / 1e9
            seen = {view.face.id: view for view in drive.world.seen(camera, "r1", t_s)}
            for face in message.faces:
                known = np.isin(face.corners, seen[face.face].corners)
                at = np.searchsorted(seen[face.face].corners, face.corners[known])
                errors_px.append(face.pixels[known] - seen[face.face].pixels[at])
                rows.append(seen[face.face].pixels[at, 1])
                sigmas.append(np.full(len(at), face.sigma))
    error, row, sigma = np.concatenate(errors_px), np.concatenate(rows), np.concatenate(sigmas)
    assert len(error) > 500
    assert np.all(np.abs(error.mean(axis=0)) < 0.005)
    assert np.sqrt(np.mean((error / sigma[:, None]) ** 2)) < 1.1
    # What a shutter shifts grows from row to row; here 1 px over the whole picture or more.
    slopes = np.polyfit(row, error, 1)[0] * drive.world.cameras["c1"].model.height
    assert np.all(np.abs(slopes) < 0.02)


def is_true(found: NetworkError, site: Site) -> bool:
    """Whether every camera is known, and their errors are what their covariance says."""
    if found.nees is None or set(found.cameras) != set(site.cameras):
        return False
    # More than all but one in fifty of 12 degrees of freedom have.
    return found.nees < 2.0 and all(camera.sigmas < 3.5 for camera in found.cameras.values())


def test_the_network_is_as_true_as_it_says(drive: Drive) -> None:
    assert is_true(errors(drive, drive.site), drive.site)


def test_whoever_ignores_the_shutter_has_a_camera_wrong_or_none(drive: Drive) -> None:
    assert not is_true(errors(drive, ignoring(drive.site)), drive.site)
