"""Bags as people have them: of several parts, in SQLite, packed, unpacked by hand, with a part that
is missing."""

import json
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from support.builders import site_text
from support.commands import Cli
from support.pictures.boards import CHARUCO_TARGET
from support.pictures.recordings import SOUND, TOPIC, listed, write

from trigpoint.contract.cdr_ros import store
from trigpoint.contract.messages import PICTURE
from trigpoint.recorder.session.recording import open_recording


def parts(folder: Path, *, packed: bool) -> Path:
    """A bag of two parts, in an order that is not that of their names."""
    folder.mkdir()
    names = []
    for number, name in enumerate(("z.mcap", "a.mcap")):
        file = write(folder / name, [SOUND] * (number + 1), first_s=1000 + 10 * number)
        if packed:
            name = f"{name}.zstd"
            (folder / name).write_bytes(zstandard.compress(file.read_bytes()))
            file.unlink()
        names.append(name)
    return listed(folder, names)


@pytest.mark.parametrize("packed", [False, True])
def test_a_bag_of_parts_is_one_session_for_every_command(
    tmp_path: Path, target: Path, packed: bool, cli: Cli
) -> None:
    bag = parts(tmp_path / "bag", packed=packed)
    assert [part.path.name[:1] for part in open_recording(bag).parts] == ["z", "a"]
    info = json.loads(cli("info", bag, "--json").out)
    assert info["keys"][TOPIC[1:]]["messages"] == 3
    assert all(Path(file).parent == bag for file in info["files"])
    cli("check", bag)
    cli("recover", bag)
    assert open_recording(bag / "recovered").counts == {TOPIC[1:]: 3}
    assert cli("detect", bag, "--target", target).out.count("face 0") == 3


@pytest.mark.parametrize(
    ("plugin", "packing", "is_file"),
    [
        (StoragePlugin.SQLITE3, None, False),
        (StoragePlugin.SQLITE3, None, True),
        (StoragePlugin.SQLITE3, CompressionMode.FILE, False),
        (StoragePlugin.SQLITE3, CompressionMode.FILE, True),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE, False),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE, False),
    ],
)
def test_a_bag_in_sqlite_or_of_packed_messages_is_a_session_for_every_command(
    tmp_path: Path,
    target: Path,
    plugin: StoragePlugin,
    packing: CompressionMode | None,
    is_file: bool,
    cli: Cli,
) -> None:
    writer = BagWriter(tmp_path / "bag", version=9, storage_plugin=plugin)
    if packing is not None:
        writer.set_compression(packing, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(TOPIC, PICTURE, typestore=store())
        for number, payload in enumerate((SOUND, b"", SOUND)):
            writer.write(connection, number + 1, payload)
    bag = next(writer.path.glob("*.db3*")) if is_file else writer.path
    info = json.loads(cli("info", bag, "--json").out)
    assert info["keys"][TOPIC[1:]]["messages"] == 3
    assert info["files"] == [str(bag)]
    assert f"{bag}: warning: a message of {TOPIC}" in cli("check", bag, status=1).out
    cli("recover", bag)
    assert open_recording(writer.path / "recovered").counts == {TOPIC[1:]: 2}
    assert cli("detect", bag, "--target", target).out.count("face 0") == 2


@pytest.mark.parametrize(
    "words",
    [
        ["review", "--save", "a.rrd"],
        ["export", "--out", "out", "--format", "mcap"],
        ["calibrate", "--out", "out"],
    ],
)
def test_a_bag_of_no_session_is_named_as_one_with_what_takes_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    cli: Cli,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "site.toml").write_text(site_text(cameras=1))
    (tmp_path / "target.toml").write_text(CHARUCO_TARGET)
    command, *more = words
    bag = str(write(tmp_path / "bag.mcap", [SOUND]))
    assert f"none of its topics ({TOPIC}) is one of a session" in cli.refused(
        command, bag, "--site", "site.toml", *more
    )


def test_a_bag_of_ros_1_is_named_with_what_reads_it(tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0")
    assert "ROS 1 bag, which only detect" in cli.refused("info", tmp_path / "old.bag")


def test_a_part_that_was_unpacked_by_hand_is_found(tmp_path: Path) -> None:
    bag = parts(tmp_path / "bag", packed=True)
    write(bag / "a.mcap", [SOUND] * 2)
    (bag / "a.mcap.zstd").unlink()
    assert open_recording(bag).counts == {TOPIC[1:]: 3}


@pytest.mark.parametrize("frames", [2, 7])
def test_a_packed_file_that_breaks_off_says_so_and_what_is_whole_is_read(
    tmp_path: Path, cli: Cli, frames: int
) -> None:
    """It was packed as several frames, as pzstd does."""
    mcap = write(tmp_path / "whole.mcap", [SOUND] * 12, chunk_size=1).read_bytes()
    size = len(mcap) // frames + 1
    pieces = [mcap[start : start + size] for start in range(0, len(mcap), size)]
    packed = b"".join(map(zstandard.compress, pieces))
    path = tmp_path / "cut.mcap.zstd"
    path.write_bytes(packed)
    assert open_recording(path).counts == {TOPIC[1:]: 12}
    copy = tmp_path / "copy.mcap.zstd"
    copy.write_bytes(packed[:-5])
    assert f"{copy}: the packed file breaks off" in cli("info", copy).err
    copy = tmp_path / "nothing.mcap.zstd"
    copy.write_bytes(packed[:20])
    assert "the packed file breaks off at once; copy it again" in cli.refused("info", copy)


def test_a_file_of_packed_messages_is_refused_with_what_to_give(tmp_path: Path, cli: Cli) -> None:
    bag = parts(tmp_path / "bag", packed=False)
    file = bag / "metadata.yaml"
    file.write_text(
        file.read_text().replace('"compression_mode": ""', '"compression_mode": "MESSAGE"')
    )
    for command in ("info", "check", "recover"):
        assert "give its folder" in cli.refused(command, bag / "z.mcap")


@pytest.mark.parametrize("is_there", [True, False])
def test_a_part_in_which_there_is_nothing_is_named_and_the_others_are_read(
    tmp_path: Path, cli: Cli, is_there: bool
) -> None:
    """As a full disk leaves it, or who copied by hand."""
    bag = parts(tmp_path / "bag", packed=False)
    (bag / "a.mcap").unlink()
    if is_there:
        (bag / "a.mcap").touch()
    why = "the file is empty" if is_there else "is listed in metadata.yaml, but not there"
    said = cli("info", bag, "--json")
    assert f"a.mcap: {why}" in said.err
    assert json.loads(said.out)["keys"][TOPIC[1:]]["messages"] == 1
    assert f"a.mcap: error: {why}" in cli("check", bag, status=1).out
    cli("recover", bag)
    assert open_recording(bag / "recovered").counts == {TOPIC[1:]: 1}
    (bag / "z.mcap").write_bytes(b"")
    assert "z.mcap: the file is empty" in cli.refused("info", bag)
