"""What a drawn session's files say agrees with its truth, and nothing but the seed decides."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.recipe import KINDS, Recipe, Route, drawn, unknown_to_the_site
from benchmarks.compositions.session import Composition, composed_session, session_of
from trigpoint.contract import cdr
from trigpoint.contract.messages import CameraInfo, Message, Odometry, Sightings
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import wrap
from trigpoint.map.network import decode_tum
from trigpoint.site.config import load_site
from trigpoint.site.target import load_target

# A tenth of a degree of freedom's root over some hundred corners.
_TOLERANCE = 0.1


def _messages(folder: Path) -> Iterator[tuple[str, Message]]:
    with (folder / "session.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            yield channel.topic.split("/")[3], cdr.decode(schema.name, message.data)


def _truth(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "truth.json").read_text())


def _pose(said: dict[str, list[float]]) -> Pose:
    return Pose.from_quaternion(said["translation"], said["quaternion"])


def _errors(session: Composition, folder: Path) -> list[np.ndarray]:
    """Of each good sighting: how far its corners lie from where the truth brings them, in sigmas;
    from the files, and what each sighting shows."""
    write_composition(session, folder)
    folder = folder / session.name
    truth, target = _truth(folder), load_target(folder / "target.toml")
    stamps, poses = decode_tum((folder / truth["robots"]["r1"]).read_bytes())
    lenses: dict[str, CameraModel] = {}
    late_s = {camera.name: camera.time_offset_s for camera in session.cameras}
    said = {n: [face for p in each for face in p.faces] for n, each in session.pictures.items()}
    errors = []
    for node, message in _messages(folder):
        if isinstance(message, CameraInfo):
            lenses[node] = message.camera
        if not isinstance(message, Sightings):
            continue
        true_ns = message.stamp_ns - round(late_s[node] * 1e9)
        base = poses[int(np.searchsorted(stamps, true_ns))]
        for sighting in message.faces:
            shows = said[node].pop(0)
            if not shows.is_good.all():
                continue
            face = target.face(shows.face)
            points = base @ (face.base_from_face @ face.corners[sighting.corners])
            pixels = sighting.pixels[:: -1 if shows.is_turned else 1]
            camera_from_map = _pose(truth["cameras"][node]).inverse()
            expected = lenses[node].project(camera_from_map @ points)
            errors.append((pixels - expected) / sighting.sigma)
    return errors


@pytest.mark.parametrize("pattern", ["checkerboard", "charuco", "aprilgrid", "checkerboards"])
def test_sightings_lie_where_the_truth_brings_them(pattern: str, tmp_path: Path) -> None:
    recipe = Recipe("loop-alike", 3, pattern=pattern, displaced_share=0.2, lens="fisheye")
    errors = _errors(session_of(recipe), tmp_path)
    assert len(errors) >= 6
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) == pytest.approx(1, abs=_TOLERANCE)


def test_pictures_off_the_odometry_beat_agree_after_their_time_offset(tmp_path: Path) -> None:
    recipe = Recipe("a drive", 1, route=Route.DANCE, cameras=3, time_offset_s=0.05)
    session = session_of(recipe)
    assert all(abs(camera.time_offset_s) > 1e-4 for camera in session.cameras)
    errors = np.concatenate(_errors(session, tmp_path))
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1, abs=_TOLERANCE)


def test_the_truth_scatters_about_the_odometry_as_the_contract_says(tmp_path: Path) -> None:
    recipe = Recipe("a dance", 5, route=Route.DANCE, scale=0.02, noise=2.0)
    session = session_of(recipe)
    folder = write_composition(session, tmp_path)
    odometry = load_site(folder / "site.toml").robots["r1"].odometry
    poses = [message.pose for _, message in _messages(folder) if isinstance(message, Odometry)]
    reported = Pose.stack(poses)
    _, truth = decode_tum((folder / "r1_truth.tum").read_bytes())
    said, true = reported[:-1].inverse() @ reported[1:], truth[:-1].inverse() @ truth[1:]
    scale = 1 + session.carriers[0].ride.scale_errors
    length = np.hypot(*said.translation[:, :2].T)
    turn = np.abs(said.heading)
    off = true.translation[:, 0] - scale[0] * said.translation[:, 0]
    assert np.std(off[length > 0.01] / np.sqrt(length[length > 0.01])) == pytest.approx(
        odometry.distance, rel=0.1
    )
    off = wrap(true.heading - scale[1] * said.heading)[turn > 0.01]
    sigma = np.hypot(
        odometry.heading_drive * np.sqrt(length), odometry.heading_turn * np.sqrt(turn)
    )
    assert np.std(off / sigma[turn > 0.01]) == pytest.approx(1, abs=_TOLERANCE)


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_writes_what_the_site_file_can_be_read_of(kind: str, tmp_path: Path) -> None:
    folder = write_composition(composed_session(kind, 7), tmp_path)
    site = load_site(folder / "site.toml")
    truth = _truth(folder)
    assert folder.name == f"{kind}-7"
    assert set(truth["cameras"]) <= set(site.cameras)
    assert set(truth["robots"]) == set(site.robots)
    for robot in site.robots:
        load_target(site.path(site.target_name(robot)))
    nodes = {node for node, _ in _messages(folder)}
    assert nodes == set(site.cameras) | set(site.robots)


def test_the_seed_alone_decides() -> None:
    def said(seed: int) -> list[tuple[int, str, bytes]]:
        session = composed_session("everything", seed)
        return [(at_ns, node, cdr.encode(one)) for at_ns, node, one in session.messages()]

    first = said(4)
    assert said(4) == first
    assert said(5) != first


def test_a_camera_met_again_is_met_close_by_with_another_heading() -> None:
    session = composed_session("loop-alike", 2)
    ride = session.carriers[0].ride
    stops = ride.at(np.array(ride.stops_s[1:-1]))
    again = stops[6]
    first = stops[0]
    gap = np.hypot(*(again.translation - first.translation)[:2])
    assert 0.05 < gap < 0.2
    assert abs(wrap(again.heading - first.heading)) > np.radians(45)


def test_a_lifted_robot_is_elsewhere_and_its_odometry_does_not_notice() -> None:
    session = session_of(Recipe("a lift", 3, route=Route.DANCE, lifts=1))
    ride = session.carriers[0].ride
    [lift_s] = ride.lifts_s
    before, after = (ride.at(np.array([t_s]))[0] for t_s in (lift_s - 0.01, lift_s + 0.01))
    assert np.hypot(*(after.translation - before.translation)[:2]) > 0.3
    index = round(lift_s / 0.01)
    reported = ride.odom_from_base[index - 1 : index + 2].translation
    assert np.ptp(reported, axis=0).max() < 1e-9


@pytest.mark.parametrize("moves", [0, 1])
def test_a_lift_that_no_picture_could_tell_does_not_happen(moves: int) -> None:
    """Nor one that shows by a camera alone that was moved meanwhile."""
    lifted = 0
    for seed in range(6):
        session = session_of(Recipe("loop", seed, cameras=4, lifts=1, moves=moves))
        for lift_s in session.carriers[0].ride.lifts_s:
            lifted += 1
            assert any(
                min(t_s) < lift_s < max(t_s)
                and not any(min(t_s) < move.at_s < max(t_s) for move in camera.moves)
                for camera in session.cameras
                if (t_s := [picture.t_s for picture in session.pictures[camera.name]])
            )
    assert lifted >= 2


def test_a_moved_camera_is_seen_before_and_after_and_ends_where_it_was_last_seen() -> None:
    session = session_of(Recipe("a move", 2, route=Route.DANCE, moves=1))
    [camera] = [camera for camera in session.cameras if camera.moves]
    [move] = camera.moves
    times_s = [picture.t_s for picture in session.pictures[camera.name]]
    assert min(times_s) < move.at_s
    last = camera.pose_at(max(times_s))
    assert np.allclose(session.last_places()[camera.name].translation, last.translation)


def test_a_mismatch_is_the_same_session_with_what_the_site_file_does_not_know() -> None:
    plain = drawn("composition", 8)
    odd = unknown_to_the_site(plain)
    assert not plain.is_mismatched
    assert odd.is_mismatched
    assert (odd.route, odd.cameras, odd.is_alike) == (plain.route, plain.cameras, plain.is_alike)


def test_a_site_file_says_only_what_it_knows(tmp_path: Path) -> None:
    recipe = Recipe("odd", 1, cameras=2, stated=2.0, noise=1.0)
    session = session_of(recipe)
    errors = np.concatenate(_errors(session, tmp_path))
    said = tomllib.loads((tmp_path / session.name / "site.toml").read_text())
    assert said["robots"]["r1"]["odometry"]["distance"] == pytest.approx(0.006)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.5, abs=_TOLERANCE)
