"""The command `calibrate`, as a user runs it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from support.commands import Cli
from support.fusion.drives import Session, lab_plan, make_session, offline, write_session

from trigpoint.cli import run
from trigpoint.contract.messages import Message, Odometry, Sightings
from trigpoint.map.network import decode_network, decode_tum, encode_network, load_network
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.calibrate.work import calibrated
from trigpoint.tools.sessions.inputs import session_inputs
from trigpoint.tools.shapes.text import target_text


@pytest.fixture(scope="module")
def expected(recorded: Path) -> bytes:
    """What the estimator makes of the session, without the command."""
    recording = open_recording(recorded)
    inputs = session_inputs(recording, site=None, network=None)
    return encode_network(calibrated(recording, inputs).network)


def test_session_gives_the_network_its_trajectories_and_a_table(
    recorded: Path, expected: bytes, tmp_path: Path, cli: Cli
) -> None:
    out = cli("calibrate", recorded, "--out", tmp_path).out
    assert (tmp_path / "network.json").read_bytes() == expected
    rows = [line.split() for line in out.splitlines() if line.startswith("c") and "located" in line]
    assert [row[0] for row in rows] == ["c1", "c2", "c3"]
    assert all(float(row[-1]) < 5 for row in rows)  # sigmas from the truth
    assert "mean error of the distances between cameras" in out
    assert f"written to {tmp_path}" in out
    with np.load(tmp_path / "covariance.npz") as archive:
        assert archive["covariance"].shape == (18, 18)
    stamps_ns, _ = decode_tum((tmp_path / "r1.tum").read_bytes())
    assert len(stamps_ns) == 441


def test_network_is_that_of_the_messages_themselves(drive: Session, expected: bytes) -> None:
    network, direct = decode_network(expected), offline(drive).network
    assert network.map_id == direct.map_id
    for name, record in direct.cameras.items():
        mine = network.cameras[name].map_from_camera
        assert mine is not None
        assert record.map_from_camera is not None
        # In between lie quaternions of 16 digits.
        apart = mine.pose.difference(record.map_from_camera.pose)
        np.testing.assert_allclose(apart, 0.0, atol=1e-6)


def test_results_lie_beside_the_session_where_nothing_else_is_said(
    drive: Session, tmp_path: Path, expected: bytes, cli: Cli
) -> None:
    folder = write_session(drive, tmp_path / "drive")
    (folder / "truth.json").unlink()
    said = cli("calibrate", folder / "session.mcap").out
    assert (folder / "calibration" / "network.json").read_bytes() == expected
    assert "error" not in said  # without the truth there is none to state


def test_json_is_the_network_file_and_nothing_else(
    recorded: Path, expected: bytes, tmp_path: Path, cli: Cli
) -> None:
    out = cli("calibrate", recorded, "--json", "--out", tmp_path).out
    assert out.encode() == expected
    assert json.loads(out)["format"] == "trigpoint-network/1"


def test_site_file_is_used_instead_of_the_attached_one(
    drive: Session, recorded: Path, tmp_path: Path
) -> None:
    site = drive.inputs.site.text.replace('site = "lab"', 'site = "hall"')
    site = site.replace("[cameras.c3]", "[cameras.c9]")
    (tmp_path / "site.toml").write_text(site)
    (tmp_path / "r1.toml").write_text(target_text(drive.inputs.targets["r1"]))
    out = tmp_path / "out"
    arguments = ["--site", str(tmp_path / "site.toml"), "--out", str(out)]
    assert run(["calibrate", str(recorded), *arguments]) == 0
    network = load_network(out)
    assert network.site == "hall"
    assert {n: c.status for n, c in network.cameras.items()} == {
        "c1": "located",
        "c2": "located",
        "c9": "unseen",
    }


def test_surveyed_cameras_lay_the_map_over_the_building(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    truth = json.loads((recorded / "truth.json").read_text())["cameras"]
    places = {name: pose["translation"] for name, pose in truth.items()}
    here = _mapped(recorded, tmp_path, {n: [x + 50, y - 20, z] for n, (x, y, z) in places.items()})
    said = cli("calibrate", recorded, "--site", here, "--out", tmp_path).out
    assert "The map in building: (50.0" in said
    record = json.loads((tmp_path / "alignment.json").read_text())
    assert record["frame_from_map"]["translation"] == pytest.approx([50, -20, 0], abs=0.1)
    aligned = load_network(tmp_path / "building")
    assert aligned.map == "building"
    assert "The map in the building" in (tmp_path / "report.html").read_text()

    wrong = _mapped(recorded, tmp_path, {n: [9 * x, y, z] for n, (x, y, z) in places.items()})
    words = ["calibrate", recorded, "--site", wrong, "--out", tmp_path / "again"]
    last = cli(*words, status=2).err.splitlines()[-1]
    assert "the surveyed points contradict the map" in last
    assert (tmp_path / "again" / "network.json").exists()


def _mapped(recorded: Path, folder: Path, places: dict[str, list[float]]) -> Path:
    """The session's site file with its cameras surveyed."""
    text = open_recording(recorded).site_text
    rows = [f"[map.points.{name}]\nposition = {place}" for name, place in places.items()]
    for name, data in open_recording(recorded).attachments.items():
        (folder / name).write_bytes(data)
    (folder / "mapped.toml").write_text("\n".join([text, *rows]))
    return folder / "mapped.toml"


def test_known_network_is_the_prior(recorded: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert run(["calibrate", str(recorded), "--out", str(first)]) == 0
    arguments = ["--network", str(first / "network.json"), "--out", str(second)]
    assert run(["calibrate", str(recorded), *arguments]) == 0
    before, after = load_network(first), load_network(second)
    assert after.located == before.located
    for name in after.located:
        assert after.cameras[name].position_sigma < before.cameras[name].position_sigma + 2e-4


def test_known_camera_that_saw_nothing_has_no_rms(
    recorded: Path, drive: Session, tmp_path: Path, cli: Cli
) -> None:
    """A traceback ended it."""
    first = tmp_path / "first"
    cli("calibrate", recorded, "--out", first)
    messages = tuple(
        (node, message)
        for node, message in drive.messages
        if node != "c1" or not isinstance(message, Sightings)
    )
    blind = write_session(replace(drive, messages=messages), tmp_path / "blind")
    said = cli("calibrate", blind, "--network", first / "network.json")
    assert re.search(r"c1 +located .* 0 +0 +–", said.out)


def test_what_contradicts_the_session_is_status_1_beside_a_known_camera_that_saw_nothing(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    """Which stays where it was known: since one is located, nothing said that the rest are not."""
    first = tmp_path / "first"
    cli("calibrate", recorded, "--out", first)
    plan = lab_plan(picture_rate=1.0)
    longer = {"r1": replace(plan.robots["r1"], scales=(0.15, 0.0))}
    session = make_session(replace(plan, robots=longer))
    seen = [(n, m) for n, m in session.messages if n != "c1" or not isinstance(m, Sightings)]
    blind = write_session(replace(session, messages=tuple(seen)), tmp_path / "blind")
    said = cli("calibrate", blind, "--network", first / "network.json", status=1)
    assert load_network(blind / "calibration").located == ["c1"]
    assert "do not use these cameras: what cameras saw contradicts the odometry of r1" in said.err


def test_site_that_learns_nothing_is_refused(
    recorded: Path, drive: Session, tmp_path: Path, cli: Cli
) -> None:
    (tmp_path / "r1.toml").write_text(target_text(drive.inputs.targets["r1"]))
    site = tmp_path / "site.toml"
    site.write_text(drive.inputs.site.text + "\n[fusion]\nlearn = false\n")
    said = cli.refused("calibrate", recorded, "--site", site)
    assert "learn = false: the site's network is fixed, and calibrate works one out" in said


def test_network_without_its_covariance_is_refused(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    assert run(["calibrate", str(recorded), "--out", str(tmp_path)]) == 0
    (tmp_path / "covariance.npz").unlink()
    line = cli.refused("calibrate", recorded, "--network", tmp_path / "network.json")
    assert "keep covariance.npz beside network.json" in line


def test_missing_session_is_named(tmp_path: Path, cli: Cli) -> None:
    assert "there is no such session" in cli.refused("calibrate", tmp_path / "none.mcap")
    assert "no .mcap file in this folder" in cli.refused("calibrate", tmp_path)


def test_place_that_cannot_be_written_is_told_before_the_work(
    recorded: Path, tmp_path: Path, cli: Cli, monkeypatch
) -> None:
    monkeypatch.setattr(
        "trigpoint.tools.calibrate.command.fed", lambda *_, **__: pytest.fail("too late")
    )
    taken = tmp_path / "taken"
    taken.touch()
    assert "is a file" in cli.refused("calibrate", recorded, "--out", taken)
    line = cli("calibrate", recorded, "--out", taken / "below", status=1).err
    assert "taken/below: cannot be written" in line
    assert line.count("\n") == 1


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 another kind of file"])
def test_foreign_or_empty_file_is_named(tmp_path: Path, content: bytes, cli: Cli) -> None:
    path = tmp_path / "session.mcap"
    path.write_bytes(content)
    assert str(path) in cli.refused("calibrate", path)


def test_truncated_session_is_used_as_far_as_it_goes(
    drive: Session, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = (recorded / "session.mcap").read_bytes()
    path = tmp_path / "session.mcap"
    path.write_bytes(data[: len(data) * 9 // 10])
    site = tmp_path / "site.toml"
    site.write_text(drive.inputs.site.text)
    (tmp_path / "r1.toml").write_text(target_text(drive.inputs.targets["r1"]))
    status = run(["calibrate", str(path), "--site", str(site), "--out", str(tmp_path / "out")])
    captured = capsys.readouterr()
    # One chunk of so short a drive: it is either read or said to hold nothing.
    if status == 0:
        assert load_network(tmp_path / "out").cameras["c1"].status == "located"
    else:
        assert status == 2
        assert "before its first message was complete" in captured.err


def only(session: Session, kind: type) -> Session:
    messages = tuple((n, m) for n, m in session.messages if isinstance(m, kind))
    return replace(session, messages=messages)


def test_session_without_odometry_is_refused(drive: Session, tmp_path: Path, cli: Cli) -> None:
    folder = write_session(only(drive, Sightings), tmp_path)
    assert "no odometry of a robot is in it; record a drive" in cli.refused("calibrate", folder)


def test_session_of_a_robot_that_the_site_file_lacks_is_refused(
    drive: Session, tmp_path: Path, cli: Cli
) -> None:
    named = tuple(
        ("cart" if isinstance(message, Odometry) else node, message)
        for node, message in drive.messages
    )
    folder = write_session(replace(drive, messages=named), tmp_path)
    assert "it is of robot cart, and the site file has only r1; use the same names" in cli.refused(
        "calibrate", folder
    )


def test_session_without_sightings_has_unseen_cameras(
    drive: Session, tmp_path: Path, cli: Cli
) -> None:
    folder = write_session(only(drive, Odometry), tmp_path)
    assert cli("calibrate", folder).out.count("unseen") == 3


@pytest.mark.parametrize("estimator", ["magic", "EKF"])
def test_estimator_that_is_not_there_is_refused(
    recorded: Path, estimator: str, tmp_path: Path, cli: Cli
) -> None:
    captured = cli("calibrate", recorded, "--estimator", estimator, "--out", tmp_path, status=2)
    assert captured.out == ""
    assert estimator in captured.err
    assert not (tmp_path / "network.json").exists()


def _strange(node: str, message: Message) -> Message:
    """The pictures of c3 of another size, the sightings of c2 of a target that nobody carries."""
    if node == "c3" and isinstance(message, Sightings):
        return replace(message, width=1280)
    if node == "c2" and isinstance(message, Sightings):
        faces = tuple(replace(face, target="other") for face in message.faces)
        return replace(message, faces=faces)
    return message


def test_what_was_left_out_is_said(drive: Session, tmp_path: Path, cli: Cli) -> None:
    strange = tuple((n, _strange(n, m)) for n, m in drive.messages)
    folder = write_session(replace(drive, messages=strange), tmp_path)
    captured = cli("calibrate", folder)
    assert "wrong size" in captured.err
    assert "note: camera c3 sends pictures of 1280 × 480" in captured.err
    assert "«other» that no robot" in captured.err
    assert "c3      unseen" in captured.out
