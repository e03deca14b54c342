"""The site that `up --simulate-robot` writes."""

from pathlib import Path

import pytest

from trigpoint.base.errors import InputError
from trigpoint.site.config import load_site
from trigpoint.tools.up.simulated import simulated_site


def test_the_labs_site_comes_with_its_robot(tmp_path: Path) -> None:
    made = simulated_site(tmp_path, None, ())
    site = load_site(made.site)
    assert list(site.cameras) == [f"c{number}" for number in range(1, 7)]
    assert list(site.robots) == [made.robot]
    link = made.firmware.command[made.firmware.command.index("--link") + 1]
    port = site.robot(made.robot).port
    assert port is not None
    assert site.path(port).absolute() == Path(link)
    epoch = made.firmware.command[made.firmware.command.index("--epoch-ns") + 1]
    assert all(f"epoch_ns={epoch}" in camera.source for camera in site.cameras.values())


def test_real_cameras_come_along_as_they_are(tmp_path: Path) -> None:
    real = tmp_path / "real"
    real.mkdir()
    (real / "site.toml").write_text(
        'site = "home"\ntarget = "target.toml"\n'
        '[cameras.c1]\nsource = "dir://pictures?loop=1"\nwidth = 800\nheight = 600\n'
        'intrinsics = "lens.yaml"\n'
        '[cameras.door]\nsource = "v4l2:///dev/video0"\nintrinsics = "estimate"\n'
        '[cameras.roof]\nsource = "v4l2:///dev/video9"\n'
    )
    own = load_site(real / "site.toml")
    site = load_site(simulated_site(tmp_path / "sim", own, ("c1", "door")).site)
    assert {"c1", "own_c1", "door"} <= site.cameras.keys()
    assert "roof" not in site.cameras
    assert site.camera("own_c1").source == f"dir://{real}/pictures?loop=1"
    assert site.camera("own_c1").width == 800
    assert site.camera("own_c1").intrinsics == str(real / "lens.yaml")
    assert site.camera("door") == own.camera("door")


def test_another_run_begins_without_the_map_of_the_last(tmp_path: Path) -> None:
    simulated_site(tmp_path, None, ())
    (tmp_path / "network").mkdir()
    (tmp_path / "network/checkpoint.bin").write_bytes(b"old")
    simulated_site(tmp_path, None, ())
    assert not (tmp_path / "network/checkpoint.bin").exists()


def test_real_sites_files_are_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text("mine")
    with pytest.raises(InputError, match="give --out DIR"):
        simulated_site(tmp_path, None, ())
    assert (tmp_path / "site.toml").read_text() == "mine"
