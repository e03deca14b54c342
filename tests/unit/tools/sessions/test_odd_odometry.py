"""Sessions whose odometry or times are not as they should be: used where the meaning is plain, and
else said, with how many and what to do."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.commands import Cli, Said
from support.fusion.drives import Session
from support.fusion.foreign import Change, as_foreign

from trigpoint.contract import cdr
from trigpoint.contract.cdr_ros import store
from trigpoint.contract.messages import ODOMETRY, SIGHTINGS, Mended, Odometry
from trigpoint.geometry import Pose
from trigpoint.map.network import load_network
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.world import load_world


def calibrated(
    cli: Cli, recorded: Path, folder: Path, change: Change, kind: str = ODOMETRY, *, status: int = 0
) -> Said:
    """What `calibrate` says of the drive as a foreign bag whose messages were changed before."""
    words = as_foreign(recorded, folder, change, kind=kind)
    places = ("--site", folder / "site.toml", "--out", folder / "out")
    return cli("calibrate", *words, *places, status=status)


def stamp(message: Any, stamp_ns: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)


def shifted(by_ns: int) -> Change:
    def change(_number: int, message: Any) -> None:
        was = message.header.stamp
        stamp(message, was.sec * 10**9 + was.nanosec + by_ns)

    return change


def by_simulator(number: int, message: Any) -> None:
    stamp(message, (number + 1) * 20_000_000)


def at_once(_number: int, message: Any) -> None:
    stamp(message, 10**9)


def test_odometry_in_millimetres_is_asked_for_its_unit(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    def change(_number: int, message: Any) -> None:
        message.pose.pose.position.x *= 1000
        message.pose.pose.position.y *= 1000

    said = calibrated(cli, recorded, tmp_path, change, status=1)
    assert re.search(r"r1: \d+ of \d+ odometry messages .*are its lengths in metres", said.err)


def mirrored(_number: int, message: Any) -> None:
    message.pose.pose.position.y *= -1
    message.pose.pose.orientation.z *= -1


def y_alone_mirrored(_number: int, message: Any) -> None:
    message.pose.pose.position.y *= -1


def heading_alone_mirrored(_number: int, message: Any) -> None:
    message.pose.pose.orientation.z *= -1


def reversed_axes(_number: int, message: Any) -> None:
    message.pose.pose.position.x *= -1
    message.pose.pose.position.y *= -1


def in_feet(_number: int, message: Any) -> None:
    message.pose.pose.position.x /= 0.3048
    message.pose.pose.position.y /= 0.3048


def by_the_diameter(_number: int, message: Any) -> None:
    message.pose.pose.position.x *= 2
    message.pose.pose.position.y *= 2


def stuck(_number: int, message: Any) -> None:
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x, place.y, turn.x, turn.y, turn.z, turn.w = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (mirrored, "only if that is mirrored.*NED"),
        (y_alone_mirrored, "only if its y axis is to the right"),
        (heading_alone_mirrored, "only if its headings turn to the right"),
        (reversed_axes, "only if it drove backwards"),
        (in_feet, r"only if its lengths are told 3\.\d+ times too long \(feet"),
        (by_the_diameter, "only if its lengths are told .* times too long .diameters for radii"),
        (stuck, "does not move while cameras see it in several places"),
    ],
)
def test_odometry_that_pictures_contradict_is_said_in_place_of_what_then_seems_to_have_happened(
    recorded: Path, tmp_path: Path, cli: Cli, change: Change, words: str
) -> None:
    said = calibrated(cli, recorded, tmp_path, change, status=1)
    assert re.search(rf"robot r1: .*{words}", said.err)
    assert "put down elsewhere" not in said.err
    assert "was moved" not in said.err


def test_no_camera_is_located_by_odometry_that_they_contradict(tmp_path: Path, cli: Cli) -> None:
    write_session(load_world("loop", seed=1, target="charuco"), tmp_path)
    said = calibrated(cli, tmp_path, tmp_path, by_the_diameter, status=1)
    assert re.search("c1 is not determined: .* what cameras saw contradicts the odometry", said.out)
    assert re.search(
        r"robot r1: .* its lengths are told .* times too long .diameters for radii.*, or those in "
        "its target file are .* times too short for what was printed",
        said.err,
    )
    assert "feet" not in said.err
    assert "exchanged" not in said.err
    earlier = tmp_path / "out" / "network.json"
    assert load_network(earlier).located == []
    refused = cli.refused("calibrate", tmp_path, "--network", earlier)
    assert "what the calibration that wrote it said" in refused


@pytest.mark.parametrize(
    ("kind", "change", "remedy"),
    [
        (ODOMETRY, by_simulator, "the clock of the odometry counts from 0.*use_sim_time"),
        (SIGHTINGS, by_simulator, "the clock of the pictures counts from 0.*use_sim_time"),
        (ODOMETRY, at_once, "have its driver stamp every message anew"),
        (ODOMETRY, shifted(-4000 * 10**9), "s lie between them; synchronise the clocks"),
        (ODOMETRY, shifted(4000 * 10**9), "s lie between them; synchronise the clocks"),
        (ODOMETRY, shifted(-7200 * 10**9), "they begin 2 h apart, as where one is .* local time"),
        (ODOMETRY, shifted(19800 * 10**9), "they begin 5.5 h apart, .*; stamp both in UTC"),
    ],
)
def test_times_that_never_overlap_are_said_everywhere_with_the_remedy(
    recorded: Path,
    tmp_path: Path,
    cli: Cli,
    kind: str,
    change: Change,
    remedy: str,
) -> None:
    said = calibrated(cli, recorded, tmp_path, change, kind, status=1)
    assert re.search(r"c1\s+unseen", said.out)
    network = json.loads((tmp_path / "out" / "network.json").read_text())
    page = (tmp_path / "out" / "report.html").read_text()
    for text in (said.err, network["cameras"]["c1"]["undetermined"][0], page):
        assert re.search(rf"saw a target in \d+ pictures, .*never overlap.*{remedy}", text)
    assert "it never saw a robot" not in page


def test_a_stamp_of_zero_is_the_time_of_recording_and_said(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    def change(number: int, message: Any) -> None:
        if number >= 3:
            stamp(message, 0)

    said = calibrated(cli, recorded, tmp_path, change)
    assert re.search(r"r1: \d+ messages without a stamp", said.err)
    assert re.search(r"c1\s+located", said.out)


def test_stamps_of_zero_before_a_clock_that_counts_from_zero_are_left_out(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    """Nodes that wait for `/clock` stamp 0; at the time of recording they would hide the cause."""

    def change(number: int, message: Any) -> None:
        stamp(message, max(0, number - 3) * 20_000_000)

    said = calibrated(cli, recorded, tmp_path, change, status=1)
    assert "4 messages of r1: header.stamp is 0, and the others' clock counts from 0" in said.err
    assert re.search(r"is unseen: .*never overlap.*the clock of the odometry counts from", said.err)
    assert "without a stamp" not in said.err


@pytest.mark.parametrize(
    ("by_s", "words"), [(2.5, "2.5 s ahead of"), (-3.0, "3.0 s behind"), (0.4, "")]
)
def test_clocks_that_overlap_and_are_apart_are_told_by_the_times_of_recording(
    recorded: Path, tmp_path: Path, cli: Cli, by_s: float, words: str
) -> None:
    said = calibrated(cli, recorded, tmp_path, shifted(round(by_s * 1e9)), status=1 if words else 0)
    assert bool(load_network(tmp_path / "out").located) is not bool(words)
    assert ("c1, c2, c3 and odometry are stamped by two clocks" in said.out) is bool(words)
    assert ("by when both were recorded" in said.err) is bool(words)
    assert f"c1: the stamps of r1 are {words} those of c1" in said.err or not words
    assert bool(re.search(r"late, write time_offset_sigma = [01]\.\d for c1", said.err)) is bool(
        words
    )


def test_exchanged_frames_of_odometry_are_said(recorded: Path, tmp_path: Path, cli: Cli) -> None:
    def change(_number: int, message: Any) -> None:
        message.header.frame_id, message.child_frame_id = "base_link", "odom"

    said = calibrated(cli, recorded, tmp_path, change)
    assert "robot r1: its odometry says that it is the pose of odom in base_link" in said.err


def test_odometry_that_is_none_is_counted_and_the_status_is_1(
    recorded: Path, drive: Session, tmp_path: Path, cli: Cli
) -> None:
    def change(_number: int, message: Any) -> None:
        message.pose.pose.position.x = np.nan

    said = calibrated(cli, recorded, tmp_path, change, status=1)
    count = sum(isinstance(message, Odometry) for _, message in drive.messages)
    assert f"{count} messages of /r1/Odometry: a position holds a number that is not finite" in (
        said.err
    )


def test_sightings_of_which_none_can_be_read_are_the_reason_and_the_status_is_1(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    none = {"target": "", "face": 0, "corners": np.zeros(0, np.uint16)}
    face = store().types["trigpoint_msgs/msg/FaceSighting"]

    def change(_number: int, message: Any) -> None:
        message.faces = [face(**none, pixels=np.zeros(0, np.float32), sigma=np.nan)]

    said = calibrated(cli, recorded, tmp_path, change, SIGHTINGS, status=1).err
    assert re.search(r"c1.* is unseen: nothing of it could be read: \d+ messages of /c1/S", said)
    assert "nothing of it could be read" in (tmp_path / "out" / "report.html").read_text()


finite = st.floats(-1, 1)
no_number = st.sampled_from([np.nan, np.inf, -np.inf])


@settings(max_examples=50)
@given(
    length=st.floats(1e-3, 1e3),
    velocities=st.lists(finite | no_number, min_size=6, max_size=6),
    covariance=finite | st.just(np.nan),
)
def test_a_drawn_length_or_velocity_is_read_and_what_it_lacked_remembered(
    length: float, velocities: list[float], covariance: float
) -> None:
    sound = Odometry(5, "odom", "base", Pose.planar(1.0, 2.0, 0.7))
    found: Any = store().deserialize_cdr(cdr.encode(sound), ODOMETRY)
    turn, twist = found.pose.pose.orientation, found.twist.twist
    turn.x, turn.y, turn.z, turn.w = (length * q for q in (turn.x, turn.y, turn.z, turn.w))
    for axis, v, w in zip("xyz", velocities[:3], velocities[3:], strict=True):
        setattr(twist.linear, axis, v)
        setattr(twist.angular, axis, w)
    found.pose.covariance = found.twist.covariance = np.full(36, covariance)
    read = cdr.decode(ODOMETRY, bytes(store().serialize_cdr(found, ODOMETRY)))
    assert isinstance(read, Odometry)
    np.testing.assert_allclose(read.pose.rotation, sound.pose.rotation, atol=1e-9)
    known = [v if np.isfinite(v) else 0.0 for v in velocities]
    np.testing.assert_array_equal([*read.linear, *read.angular], known)
    assert (Mended.NO_TWIST in read.mended) == (not np.isfinite(velocities).all())
    assert (Mended.NOT_NORMALISED in read.mended) == (abs(length - 1) > 0.01)
