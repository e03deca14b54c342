from pathlib import Path

from trigpoint.cli import COMMANDS
from trigpoint.tools.demo.folder import DemoFolder, DemoRecord
from trigpoint.tools.demo.run import parts_of, tokens_of, viewer_of
from trigpoint.tools.parts.specs import AGENTS, BRIDGES, FIRMWARE, FUSION, RECORDER, shares
from trigpoint.tools.simulation.world import load_world

RECORD = DemoRecord(world="lab", seed=2, target="charuco", seconds=20.0, epoch_ns=10**18)


def test_every_part_is_a_command_that_a_user_has(tmp_path: Path):
    world, folder = load_world("lab", seed=2), DemoFolder(tmp_path)
    specs = [*parts_of(world, folder, RECORD), viewer_of(folder)]
    for spec in specs:
        module = spec.command[spec.command.index("-m") + 1]
        if module == "trigpoint":
            assert spec.command[spec.command.index("-m") + 2] in COMMANDS
        else:
            assert spec.rank == FIRMWARE


def test_every_camera_has_an_agent():
    world = load_world("lab", seed=2)
    specs = parts_of(world, DemoFolder(Path("out")), RECORD)
    words = [word for spec in specs if spec.name.startswith("edge") for word in spec.command]
    assert [words.count(camera) for camera in world.cameras] == [1] * 6
    assert {f"lab/alive/edge/{camera}" for camera in world.cameras} <= tokens_of(world)


def test_cameras_are_dealt_out_so_that_neighbours_are_apart():
    assert shares(["c1", "c2", "c3", "c4", "c5"], 2) == [["c1", "c3", "c5"], ["c2", "c4"]]
    assert shares(["c1"], 2) == [["c1"]]


def test_agents_stop_first_and_fusion_after_the_recorder(tmp_path: Path):
    assert AGENTS < BRIDGES < FIRMWARE < RECORDER < FUSION
    specs = parts_of(load_world("lab", seed=2), DemoFolder(tmp_path), RECORD)
    names = [spec.name for spec in sorted(specs, key=lambda spec: spec.rank)]
    assert names == [
        "edge c1 c3 c5", "edge c2 c4 c6", "robot r1", "firmware r1", "recorder", "fusion",
    ]  # fmt: skip
