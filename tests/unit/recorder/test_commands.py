"""Ring, remote commands, masked passwords, key filters, and the commands on files."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.builders import eventually, make_odometry
from support.commands import Cli

from trigpoint.bus.bus import Bus
from trigpoint.contract import cdr
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.contract.topics import CAMERA_INFO, DIAGNOSTICS, ODOMETRY, SIGHTINGS
from trigpoint.node.node import Node
from trigpoint.recorder.mcap.check import check
from trigpoint.recorder.mcap.rosbag_metadata import PartFacts, write_metadata
from trigpoint.recorder.node import Recorder, settings_of
from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.writing.attachments import without_passwords
from trigpoint.recorder.writing.ring import MovedCameras, Ring
from trigpoint.site.config import Site, load_site, parse_site
from trigpoint.testing.memory_bus import MemoryBroker

KEY = ODOMETRY.key("lab", "r1")
PAYLOAD = cdr.encode(make_odometry(1))
SECOND_NS = 10**9


def ask(bus: Bus, command: str) -> dict:
    (reply,) = bus.query(f"lab/recorder/{command}")
    assert not reply.error, reply.error
    return json.loads(reply.payload)


def refusal(bus: Bus, command: str) -> str:
    (reply,) = bus.query(f"lab/recorder/{command}")
    return reply.error


@contextmanager
def recording(folder: Path, path: Path, *, ring_s: float = 0.0) -> Iterator[Bus]:
    """A recorder at work, and the bus of somebody elsewhere on its site."""
    site, broker = load_site(folder / "site.toml"), MemoryBroker()
    with (
        broker.session() as bus,
        broker.session() as remote,
        Recorder(site, path, out=path.parent, ring_s=ring_s) as recorder,
        Node(bus, site="lab", kind="recorder", name="main") as node,
    ):
        recorder.start(bus, node)
        yield remote
        node.stop()


def test_a_recorder_is_stopped_started_and_split_from_elsewhere(site_folder: Path) -> None:
    path = site_folder / "out" / "session.mcap"
    with recording(site_folder, path) as remote:
        publisher = remote.publisher(ODOMETRY, KEY)
        publisher.put(PAYLOAD)
        assert eventually(lambda: ask(remote, "status")["messages"] >= 1)
        ask(remote, "split")
        assert eventually(lambda: ask(remote, "status")["part"] == 2)
        assert "already" in refusal(remote, "start")
        assert "--ring" in refusal(remote, "save")
        assert ask(remote, "stop")["state"] == "stopped"
        assert "nothing is being recorded" in refusal(remote, "split")
        publisher.put(PAYLOAD)
        status = ask(remote, "start")
        assert status["state"] == "recording"
        assert status["file"].endswith("session_2.mcap")
    assert KEY in open_recording(path).counts
    assert check(path.with_name("session_part2.mcap")).is_sound


def test_a_ring_is_saved_from_elsewhere_and_when_a_camera_moved(site_folder: Path) -> None:
    path = site_folder / "out" / "session.mcap"
    with recording(site_folder, path, ring_s=60) as remote:
        publisher = remote.publisher(ODOMETRY, KEY)
        publisher.put(PAYLOAD)
        assert eventually(lambda: ask(remote, "status")["depth"] >= 1)
        assert not path.exists()
        assert ask(remote, "save")["saved"] == str(path)
        assert open_recording(path).counts[KEY] == 1
        said = remote.publisher(DIAGNOSTICS, DIAGNOSTICS.key("lab"))
        for count in (0, 0, 1):
            said.put(cdr.encode(diagnostics(count)))
        moved = path.with_name("session_2.mcap")
        assert eventually(moved.exists)
    assert open_recording(moved).counts[DIAGNOSTICS.key("lab")] >= 3


def diagnostics(moved: int | str) -> Diagnostics:
    values = {"left_out.camera_moved.total": str(moved)} if moved else {}
    return Diagnostics(1, (DiagnosticStatus(0, "fusion/fusion", "", "m", values),))


def test_a_ring_is_saved_once_for_each_camera_that_fusion_says_was_moved() -> None:
    moved = MovedCameras()
    # What was counted before the recorder came, and a fusion that started again, are nothing new.
    found = [moved.are_more(diagnostics(count)) for count in (3, 3, 4, 4, 0, 1, "x")]
    assert found == [False, False, True, False, False, True, False]


def test_a_ring_forgets_what_is_old_but_for_the_last_values(tmp_path: Path) -> None:
    ring = Ring(10.0, capacity=1e6)
    info = CAMERA_INFO.key("lab", "c1")
    ring.write(CAMERA_INFO, info, b"lens", log_ns=0, published_ns=0)
    for second in range(30):
        ring.write(ODOMETRY, KEY, PAYLOAD, log_ns=second * SECOND_NS, published_ns=0)
    ring.save(tmp_path / "s.mcap", [], settings_of(parse_site(SITE, directory=Path())).compression)
    samples = list(open_recording(tmp_path / "s.mcap").samples())
    assert [s.key for s in samples if s.topic is CAMERA_INFO] == [info]
    times = [s.log_ns // SECOND_NS for s in samples if s.topic is ODOMETRY]
    assert times == list(range(19, 30))


SITE = """site = "lab"
target = "target.toml"
[cameras.c1]
source = "rtsp://admin:se/cr@et@10.0.0.5/stream?channel=1&password=hunter2"
[cameras.c2]
source = "v4l2:///dev/video0?exposure_ms=5"
[robots.r1]
port = "socket://bob:pw@10.0.0.6:4000"
"""


def test_passwords_do_not_get_into_a_recording() -> None:
    masked = without_passwords(SITE)
    for secret in ("se/cr", "et@", "hunter2", ":pw@"):
        assert secret not in masked
    site = parse_site(masked, directory=Path())
    assert site.camera("c1").source == "rtsp://admin:***@10.0.0.5/stream?channel=1&password=***"
    assert site.camera("c2").source == "v4l2:///dev/video0?exposure_ms=5"


def test_only_keys_that_match_the_filter_are_recorded(site_folder: Path, story: list) -> None:
    with (site_folder / "site.toml").open("a") as file:
        file.write('\n[recorder]\nkeys = ["camera/*/sightings"]\n')
    site: Site = load_site(site_folder / "site.toml")
    broker, path = MemoryBroker(), site_folder / "s.mcap"
    with (
        broker.session() as bus,
        broker.session() as sender,
        Recorder(site, path) as recorder,
        Node(bus, site="lab", kind="recorder", name="main") as node,
    ):
        recorder.start(bus, node)
        sent = [one for one in story if one.topic in (SIGHTINGS, ODOMETRY)][:20]
        for one in sent:
            sender.publisher(one.topic, one.key).put(one.payload)
        wanted = sum(one.topic is SIGHTINGS for one in sent)
        assert eventually(lambda: sum(recorder.sink.counts.values()) == wanted)
        node.stop()
    assert {sample.topic for sample in open_recording(path).samples()} == {SIGHTINGS}


def test_info_tells_rates_and_gaps(session_file: Path, cli: Cli) -> None:
    info = json.loads(cli("info", "--json", session_file).out)
    odometry = info["keys"][KEY]
    assert odometry["type"] == ODOMETRY.type_name
    assert odometry["rate_hz"] == pytest.approx(20.0)
    assert odometry["longest_gap_s"] == pytest.approx(0.05)
    assert odometry["sequence_breaks"] == 0
    assert KEY in cli("info", session_file).out


def test_check_says_of_an_empty_file_once_that_it_is_not_sound(tmp_path: Path, cli: Cli) -> None:
    empty = tmp_path / "empty.mcap"
    empty.touch()
    said = cli("check", empty, status=1)
    assert said.out == f"{empty}: error: the file is empty; nothing was recorded into it\n"
    assert said.err == "no message in it is whole; copy or record it anew\n"


def test_check_says_of_a_missing_part_once_that_it_is_not_sound(
    session_file: Path, tmp_path: Path, cli: Cli, caplog: pytest.LogCaptureFixture
) -> None:
    there, missing = tmp_path / "session.mcap", tmp_path / "session_part2.mcap"
    there.write_bytes(session_file.read_bytes())
    write_metadata(tmp_path, [PartFacts(part.name, (0, 1), {}) for part in (there, missing)])
    said = cli("check", tmp_path, status=1)
    lines = said.out.splitlines()
    assert lines[0] == f"{missing}: error: is listed in metadata.yaml, but not there; copy it too"
    assert lines[-1] == f"{there}: sound"
    assert missing.name not in said.err + caplog.text


def test_check_and_recover_as_commands(session_file: Path, tmp_path: Path, cli: Cli) -> None:
    assert "sound" in cli("check", session_file).out
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(session_file.read_bytes()[:-2000])
    cli("check", cut, status=1)
    cli("recover", cut)
    cli("check", tmp_path / "recovered")
