"""The recorder on a bus."""

from pathlib import Path

import pytest
from support.builders import eventually

from trigpoint.base.errors import ConfigError, OperationError, TargetError
from trigpoint.bus.bus import Bus
from trigpoint.contract.topics import DIAGNOSTICS
from trigpoint.map.network import Network, Statistics, encode_network
from trigpoint.node.node import Node
from trigpoint.recorder.node import Recorder, session_path, site_files
from trigpoint.recorder.session.recording import open_recording
from trigpoint.site.config import Site, load_site
from trigpoint.testing.memory_bus import MemoryBroker

NETWORK = encode_network(Network("lab", "id", "smoother", {}, {}, Statistics(None, 0)))


def record(site: Site, path: Path, bus: Bus, sender: Bus, sent: list) -> Recorder:
    """Record what `sender` puts on the bus."""
    with (
        Recorder(site, path) as recorder,
        Node(bus, site=site.name, kind="recorder", name="main") as node,
    ):
        recorder.start(bus, node)
        keys = {one.key: one.topic for one in sent}
        publishers = {key: sender.publisher(topic, key) for key, topic in keys.items()}
        for one in sent:
            publishers[one.key].put(one.payload)
        assert eventually(lambda: sum(recorder.sink.counts.values()) >= len(sent))
        node.stop()
    return recorder


@pytest.mark.parametrize("pictures", ["true", "false"])
def test_the_files_bytes_are_the_buss_bytes(site_folder: Path, story: list, pictures: str) -> None:
    with (site_folder / "site.toml").open("a") as file:
        file.write(f"\n[recorder]\npictures = {pictures}\n")
    site = load_site(site_folder / "site.toml")
    kept = [one for one in story if pictures == "true" or one.topic.name != "image"]
    kept = [one for one in kept if one.topic is not DIAGNOSTICS]
    path = site_folder / "s.mcap"
    broker = MemoryBroker()
    with broker.session() as bus, broker.session() as sender:
        record(site, path, bus, sender, kept)
    read: dict[str, list[bytes]] = {}
    for sample in open_recording(path).samples():
        if sample.topic is not DIAGNOSTICS:
            read.setdefault(sample.key, []).append(sample.payload)
    assert read == {
        key: [one.payload for one in kept if one.key == key] for key in {o.key for o in kept}
    }


def test_the_last_network_is_attached_at_the_end(site_folder: Path, story: list) -> None:
    site, path = load_site(site_folder / "site.toml"), site_folder / "s.mcap"
    broker = MemoryBroker()
    with broker.session() as bus, broker.session() as fusion:
        fusion.serve("lab/fusion/network", lambda _: NETWORK)
        record(site, path, bus, fusion, story[:5])
    attachments = open_recording(path).attachments
    assert attachments["network.json"] == NETWORK
    assert attachments["site.toml"].decode() == site.text
    assert attachments["target.toml"] == (site_folder / "target.toml").read_bytes()


def test_a_network_that_is_none_is_not_attached(site_folder: Path, story: list) -> None:
    site, path = load_site(site_folder / "site.toml"), site_folder / "s.mcap"
    broker = MemoryBroker()
    with broker.session() as bus, broker.session() as fusion:
        fusion.serve("lab/fusion/network", lambda _: b"{}")
        record(site, path, bus, fusion, story[:5])
    assert "network.json" not in open_recording(path).attachments


def test_a_second_recorder_is_refused_and_leaves_no_file(site_folder: Path) -> None:
    site, path = load_site(site_folder / "site.toml"), site_folder / "s.mcap"
    broker = MemoryBroker()
    with broker.session() as bus, Node(bus, site="lab", kind="recorder", name="main") as first:
        with (
            pytest.raises(OperationError, match="already runs"),
            Recorder(site, path),
            Node(bus, site="lab", kind="recorder", name="main"),
        ):
            pass
        first.stop()
    assert not path.exists()


def test_a_missing_target_file_is_named_before_anything_is_written(site_folder: Path) -> None:
    (site_folder / "target.toml").unlink()
    site, path = load_site(site_folder / "site.toml"), site_folder / "s.mcap"
    with pytest.raises(TargetError, match=r"target\.toml: there is no such target file"):
        Recorder(site, path)
    assert not path.exists()


def test_intrinsics_files_are_attached(site_folder: Path) -> None:
    text = (site_folder / "site.toml").read_text()
    text = text.replace('source = "dir://c1"', 'source = "dir://c1"\nintrinsics = "c1.yaml"')
    (site_folder / "site.toml").write_text(text)
    site = load_site(site_folder / "site.toml")
    with pytest.raises(ConfigError, match=r"c1\.yaml"):
        site_files(site)
    (site_folder / "c1.yaml").write_text("image_width: 640\n")
    assert ("c1.yaml", b"image_width: 640\n", "application/yaml") in site_files(site)


def test_sessions_get_folders_of_their_own_and_free_names(site_folder: Path) -> None:
    site = load_site(site_folder / "site.toml")
    now_ns = 1_760_000_000_123_456_789
    own = session_path(site, None, now_ns=now_ns)
    assert own == site_folder / "sessions" / "lab_20251009T085320Z" / "session.mcap"
    out = site_folder / "out"
    assert session_path(site, out, now_ns=now_ns) == out / "session.mcap"
    out.mkdir()
    (out / "session.mcap").touch()
    assert session_path(site, out, now_ns=now_ns) == out / "session_2.mcap"
