"""The folder that `simulate` writes."""

import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from support.commands import Cli

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import OperationError
from trigpoint.contract import cdr
from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.map.network import decode_tum
from trigpoint.recorder.session.recording import open_recording
from trigpoint.site.camera_info import read_camera_info
from trigpoint.site.config import BusConfig, TlsConfig, load_site, parse_site
from trigpoint.site.target import load_target, parse_target
from trigpoint.tools.simulation.serial.speakers import WHEELS
from trigpoint.tools.simulation.session import EPOCH_NS, write_session
from trigpoint.tools.simulation.site_files import write_site
from trigpoint.tools.simulation.world import World, load_world


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("loop", seed=7)


@pytest.fixture(scope="module")
def folder(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("session")
    write_session(world, directory)
    return directory


def test_the_sites_files_load_and_say_what_the_world_is(world: World, folder: Path) -> None:
    site = load_site(folder / "site.toml")
    assert site.name == "lab"
    assert list(site.cameras) == list(world.cameras)
    assert site.robot("r1").odometry == world.robots["r1"].noise
    assert load_target(site.path(site.target_name("r1"))) == world.target("r1")
    for name, camera in site.cameras.items():
        assert camera.intrinsics is not None
        model = read_camera_info(site.path(camera.intrinsics))
        assert np.allclose(model.parameters, world.cameras[name].model.parameters)
        assert camera.source == f"sim://{name}?world=loop&seed=7"


def test_the_session_holds_every_message_and_attachment(world: World, folder: Path) -> None:
    recording = open_recording(folder / "session.mcap")
    counts, attachments = recording.counts, recording.attachments
    assert counts["lab/robot/r1/odom"] == len(world.odometry("r1").stamps_s)
    for name, camera in world.cameras.items():
        assert counts[f"lab/camera/{name}/camera_info"] == 1
        assert counts[f"lab/camera/{name}/sightings"] == int(world.duration_s * camera.rate) + 1
    parse_site(attachments["site.toml"].decode(), directory=folder)
    assert parse_target(attachments["target.toml"].decode()) == world.target("r1")


def test_messages_carry_the_worlds_odometry_and_sightings(world: World, folder: Path) -> None:
    odometry, sightings = [], []
    for sample in open_recording(folder).samples():
        message = cdr.decode(sample.topic.type_name, sample.payload)
        if isinstance(message, Odometry):
            odometry.append(message)
        elif isinstance(message, Sightings):
            sightings.append(message)
    log = world.odometry("r1")
    assert [m.stamp_ns for m in odometry] == [EPOCH_NS + to_ns(float(t)) for t in log.stamps_s]
    assert np.allclose([m.pose.translation for m in odometry], log.poses.translation)
    found = [m for m in sightings if m.faces]
    assert {m.frame_id for m in found} == {f"{name}/optical" for name in world.cameras}
    one = next(m for m in found if m.frame_id == "c3/optical")
    again = world.sightings("c3", (one.stamp_ns - EPOCH_NS) / 1e9)
    assert np.array_equal(one.faces[0].pixels, again[0].pixels)


def test_the_truth_is_beside_it(world: World, folder: Path) -> None:
    truth = json.loads((folder / "truth.json").read_text())
    for name, camera in world.cameras.items():
        assert np.allclose(
            truth["cameras"][name]["translation"], camera.map_from_camera.translation
        )
        assert np.allclose(truth["cameras"][name]["quaternion"], camera.map_from_camera.quaternion)
    stamps_ns, poses = decode_tum((folder / truth["robots"]["r1"]).read_bytes())
    log = world.odometry("r1")
    assert len(stamps_ns) == len(log.stamps_s)
    assert stamps_ns[-1] == EPOCH_NS + to_ns(float(log.stamps_s[-1]))
    assert np.allclose(poses.translation, world.map_from_base("r1", log.stamps_s).translation)
    assert np.allclose(poses[0].difference(log.poses[0]), 0, atol=1e-8)


def test_a_seed_always_gives_the_same_bytes_and_another_one_others(
    folder: Path, tmp_path: Path
) -> None:
    write_session(load_world("loop", seed=7), tmp_path / "same")
    write_session(load_world("loop", seed=8), tmp_path / "other")
    for path in folder.iterdir():
        assert (tmp_path / "same" / path.name).read_bytes() == path.read_bytes(), path.name
    session = (tmp_path / "other" / "session.mcap").read_bytes()
    assert session != (folder / "session.mcap").read_bytes()


def test_a_session_is_never_overwritten(world: World, folder: Path) -> None:
    before = (folder / "session.mcap").read_bytes()
    with pytest.raises(OperationError, match="is there already"):
        write_session(world, folder)
    assert (folder / "session.mcap").read_bytes() == before


@pytest.mark.parametrize("tls", [None, TlsConfig("keys")])
def test_bus_of_a_live_site_is_read_as_it_was_given(tmp_path: Path, tls: TlsConfig | None) -> None:
    bus = BusConfig(connect=("tcp/127.0.0.1:7447",), tls=tls)
    path = write_site(load_world("lab", seed=1), tmp_path, bus=bus)
    assert load_site(path).bus == bus


def test_a_live_site_names_its_sources_ports_and_bus(tmp_path: Path) -> None:
    world = load_world("lab", seed=1, target="checkerboard")
    path = write_site(
        world,
        tmp_path,
        epoch_ns=5,
        bus=BusConfig(connect=("tcp/127.0.0.1:7447",)),
        recordings="here",
        pictures=True,
    )
    site = load_site(path)
    assert site.bus.connect == ("tcp/127.0.0.1:7447",)
    assert site.camera("c2").source == "sim://c2?world=lab&seed=1&epoch_ns=5&target=checkerboard"
    assert site.robot("r1").port == "./r1.port"
    assert (site.recorder.directory, site.recorder.pictures) == ("here", True)
    assert load_target(tmp_path / "target.toml").faces[0].pattern == "checkerboard"


def test_a_site_of_rolling_shutters_says_so(tmp_path: Path) -> None:
    world = load_world("lab", seed=1)
    world.cameras["c2"] = replace(world.cameras["c2"], line_delay_s=-30e-6)
    site = load_site(write_site(world, tmp_path))
    assert [site.camera(name).line_delay for name in ("c1", "c2")] == [0.0, -30e-6]


def test_the_command_writes_a_folder_and_says_so(tmp_path: Path, cli: Cli) -> None:
    assert (
        "3404 odometry messages"
        in cli("simulate", "loop", "--out", tmp_path / "x", "--seed", "2").out
    )
    assert (tmp_path / "x" / "session.mcap").exists()
    cli("simulate", "loop", "--out", tmp_path / "x", status=1)
    assert "no world «moon»" in cli.refused("simulate", "moon", "--out", tmp_path / "y")
    assert not (tmp_path / "y").exists()


@pytest.mark.parametrize("protocol", sorted(WHEELS))
def test_site_of_a_robot_with_wheels_is_read(world: World, tmp_path: Path, protocol: str) -> None:
    site = load_site(write_site(world, tmp_path, protocol=protocol))
    assert site.robot("r1").wheels == WHEELS[protocol]
