import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.builders import largest_file

from trigpoint.base.errors import InputError, OperationError
from trigpoint.site.config import load_site
from trigpoint.site.target import load_target
from trigpoint.tools.demo.folder import MARKER, DemoFolder, DemoRecord
from trigpoint.tools.networks.truth import load_truth
from trigpoint.tools.simulation.world import load_world

RECORD = DemoRecord(world="lab", seed=2, target="charuco", seconds=20.0, epoch_ns=10**18)


@pytest.fixture
def folder(tmp_path: Path) -> DemoFolder:
    return DemoFolder(tmp_path / "demo")


def prepare(folder: DemoFolder, record: DemoRecord = RECORD) -> None:
    folder.claim()
    world = load_world(record.world, seed=record.seed, target=record.target)
    folder.prepare(world, record, "tcp/127.0.0.1:5555")


def test_site_has_the_worlds_cameras_and_the_meeting_point(folder):
    prepare(folder)
    site = load_site(folder.site)
    assert site.bus.connect == ("tcp/127.0.0.1:5555",)
    assert not site.bus.scouting
    assert "epoch_ns=1000000000000000000" in site.cameras["c1"].source
    assert "seed=2" in site.cameras["c6"].source
    port = site.robot("r1").port
    assert port is not None
    assert site.path(port) == folder.path / "r1.port"
    assert site.recorder.pictures


def test_truth_target_and_lenses_lie_beside_the_site(folder):
    prepare(folder)
    assert set(load_truth(folder.truth).cameras) == {f"c{i}" for i in range(1, 7)}
    assert load_target(folder.path / "target.toml").faces
    assert (folder.path / "c1.yaml").exists()


def test_record_is_read_as_it_was_written(folder):
    folder.claim()
    folder.write(RECORD)
    assert folder.read() == RECORD


def test_earlier_demos_files_are_replaced_and_others_kept(folder):
    prepare(folder)
    for name in ("session.mcap", "session_2.mcap", "checkpoint.bin", "log/fusion.log"):
        (folder.path / name).write_text("old")
    (folder.path / "notes.txt").write_text("mine")
    folder.claim()
    left = {str(p.relative_to(folder.path)) for p in folder.path.rglob("*") if p.is_file()}
    assert left == {"notes.txt"}


def test_folder_with_other_files_is_left_alone(folder):
    folder.path.mkdir()
    (folder.path / "site.toml").write_text('site = "mine"')
    with pytest.raises(InputError, match="give another --out"):
        folder.claim()
    assert (folder.path / "site.toml").read_text() == 'site = "mine"'


def test_folder_of_a_running_demo_is_refused(folder):
    prepare(folder)
    code = "import time; print('up', flush=True); time.sleep(60)"
    command = (sys.executable, "-c", code, str(folder.site.resolve()))
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"up\n"
            record = DemoRecord("lab", 2, "charuco", 20.0, 10**18, {"fusion": process.pid})
            folder.write(record)
            with pytest.raises(OperationError, match=f"fusion \\(process {process.pid}\\)"):
                folder.claim()
        finally:
            process.kill()
    folder.claim()
    assert not folder.site.exists()


def test_process_that_has_got_an_old_number_does_not_matter(folder):
    prepare(folder)
    folder.write(DemoRecord("lab", 2, "charuco", 20.0, 10**18, {"fusion": os.getppid()}))
    folder.claim()
    assert not folder.site.exists()


def test_file_that_is_no_record_is_named(folder):
    folder.path.mkdir()
    (folder.path / MARKER).write_text("{}")
    with pytest.raises(InputError, match=MARKER):
        folder.claim()


def test_file_in_place_of_the_folder_is_refused(tmp_path, cli):
    (tmp_path / "file").write_text("")
    assert "is a file" in cli.refused("demo", "--out", tmp_path / "file")


def test_full_disk_is_told_and_the_record_of_before_stays(folder):
    prepare(folder)
    with largest_file(10), pytest.raises(OperationError, match="cannot be written"):
        folder.write(RECORD)
    assert folder.read() == RECORD


def test_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OperationError, match="cannot be made"):
        DemoFolder(tmp_path / "file" / "demo").claim()


def test_recordings_are_in_the_order_in_which_they_were_begun(folder):
    folder.path.mkdir()
    for name in ("session_10.mcap", "session_2.mcap", "session.mcap"):
        (folder.path / name).write_text("")
    names = [path.name for path in folder.sessions]
    assert names == ["session.mcap", "session_2.mcap", "session_10.mcap"]
