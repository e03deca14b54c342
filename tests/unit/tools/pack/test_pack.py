"""`trigpoint pack` as a user runs it, and its archive as it is installed."""

import os
import shutil
import stat
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest
from support.commands import Cli
from support.site.secured import SecuredSite

from trigpoint import __version__
from trigpoint.cli import run
from trigpoint.contract.access import Kind
from trigpoint.security.credentials import node_credentials
from trigpoint.site.config import load_site, parse_site
from trigpoint.tools.pack.contents import FILES_AT
from trigpoint.tools.pack.machine import site_that_connects, this_machine
from trigpoint.tools.shapes.text import target_text
from trigpoint.tools.simulation.sight.targets import target_of

SERVER = "tls/192.168.1.10:7447"
FILE = """
site = "lab"
target = "targets/star.toml"

[bus]
listen = [
  "tls/0.0.0.0:7447",  # all
]
[bus.tls]

[cameras.c1]
source = "v4l2:///dev/video0"
[robots.r1]
port = "/dev/ttyUSB0"
protocol = "mavlink"
[robots.r1.mavlink]
key = "mavlink.key"
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A secured site with all its nodes' keys, as the authority's machine has it, and a wheel that
    needs nothing."""
    SecuredSite(tmp_path, 7447)
    (tmp_path / "targets").mkdir()
    (tmp_path / "targets/star.toml").write_text(target_text(target_of("charuco")))
    (tmp_path / "mavlink.key").write_text("ab" * 32)
    (tmp_path / "site.toml").write_text(FILE)
    (tmp_path / "constraints.txt").write_text("numpy==2.4.6\n")
    (tmp_path / "dist").mkdir()
    make_wheel(tmp_path / "dist" / wheel_name(this_machine()))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def wheel_name(machine: str) -> str:
    return f"trigpoint-{__version__}-py3-none-manylinux_2_28_{machine}.whl"


def make_wheel(path: Path, word: str = "ran") -> None:
    """A wheel of a program that says what it was called with."""
    tag = path.stem.partition("-py3")[2]
    info = f"trigpoint-{__version__}.dist-info"
    files = {
        "trigpoint/__init__.py": "",
        "trigpoint/__main__.py": f"import sys; print('{word}', *sys.argv[1:])\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: trigpoint\nVersion: {__version__}\n"
        + "".join(f"Provides-Extra: {extra}\n" for extra in ("edge", "streams", "robot", "secure")),
        f"{info}/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3{tag}\n",
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
        record = "".join(f"{name},,\n" for name in (*files, f"{info}/RECORD"))
        archive.writestr(f"{info}/RECORD", record)


def packed(*words: str) -> Path:
    """The archive of a node, unpacked beside it."""
    kind, name = words[:2]
    assert run(["pack", *words]) == 0
    archive = Path("packs") / f"lab-{kind}-{name}.tar.gz"
    with tarfile.open(archive) as tar:
        tar.extractall("there", filter="tar")
    return Path("there") / f"lab-{kind}-{name}"


def names(place: Path) -> set[str]:
    return {str(path.relative_to(place)) for path in place.rglob("*") if path.is_file()}


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_camera_gets_its_own_key_and_no_other(folder: Path) -> None:
    place = packed("camera", "c1", "--connect", SERVER)
    assert names(place) == {
        "install.sh", "constraints.txt", "trigpoint.conf", "trigpoint-edge@.service",
        wheel_name(this_machine()), "site/site.toml", "site/targets/star.toml",
        "site/secure/trust.pem", "site/secure/camera-c1.key", "site/secure/camera-c1.pem",
    }  # fmt: skip
    assert mode(place / "site/secure/camera-c1.key") == 0o600
    assert mode(place / "site/secure") == 0o700
    assert mode(Path("packs/lab-camera-c1.tar.gz")) == 0o600
    site = load_site(place / "site/site.toml")
    assert (site.bus.connect, site.bus.listen) == ((SERVER,), ())
    node_credentials(site, Kind.CAMERA, "c1")


@pytest.mark.parametrize("source", ["v4l2:///dev/video0", "rtsp://10.0.0.5/a", "file:///clip.mp4"])
def test_pyav_goes_where_streams_are_read(folder: Path, source: str) -> None:
    (folder / "site.toml").write_text(FILE.replace("v4l2:///dev/video0", source))
    script = (packed("camera", "c1", "--connect", SERVER) / "install.sh").read_text()
    assert ("[edge,secure]" if "v4l2" in source else "[edge,streams,secure]") in script


def test_robot_gets_what_corrections_are_checked_by_and_its_signing_key(folder: Path) -> None:
    place = packed("robot", "r1", "--connect", SERVER)
    assert {"site/secure/corrections.pem", "site/secure/robot-r1.key"} <= names(place)
    assert mode(place / "site/mavlink.key") == 0o600
    assert "[robot,mavlink,secure]" in (place / "install.sh").read_text()


def test_server_gets_the_routers_key_by_which_it_lets_others_in(folder: Path) -> None:
    keys = {name for name in names(packed("fusion", "fusion")) if name.endswith(".key")}
    assert keys == {"site/secure/fusion-fusion.key", "site/secure/router-hall.key"}


def test_same_input_gives_the_same_bytes(folder: Path) -> None:
    archive = Path("packs/lab-camera-c1.tar.gz")
    packed("camera", "c1", "--connect", SERVER)
    first = archive.read_bytes()
    os.utime("site.toml", (0, 0))
    packed("camera", "c1", "--connect", SERVER)
    assert archive.read_bytes() == first


def test_unit_runs_what_the_script_installs(folder: Path) -> None:
    place = packed("camera", "c1", "--connect", SERVER)
    unit = (place / "trigpoint-edge@.service").read_text()
    assert (
        'ExecStart="/opt/trigpoint/bin/python" -m trigpoint edge --camera %i '
        f'--site "{FILES_AT}/site.toml"' in unit
    )
    assert "User=trigpoint\n" in unit
    script = (place / "install.sh").read_text()
    assert "systemctl restart trigpoint-edge@c1" in script
    assert f'"{FILES_AT}"' not in script  # it goes by $files, which DESTDIR moves
    router = packed("router", "hall") / "trigpoint-router.service"
    assert " router --name hall --site " in router.read_text()


@pytest.mark.parametrize("shell", ["sh", "dash", "bash"])
def test_script_is_one_that_every_shell_reads(folder: Path, shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    script = packed("camera", "c1", "--connect", SERVER) / "install.sh"
    assert subprocess.run([shell, "-n", script], timeout=60).returncode == 0
    assert len(script.read_text().splitlines()) < 60  # read in a minute
    assert mode(script) == 0o755


def installed(place: Path, root: Path) -> "subprocess.CompletedProcess[str]":
    """The script run without root, from another folder; pip finds all that it needs here."""
    offline = {"PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1", "DESTDIR": str(root)}
    return subprocess.run(
        ["sh", place.absolute() / "install.sh"],
        env=os.environ | offline,
        cwd="/",
        capture_output=True,
        text=True,
        timeout=240,
    )


def said_by(root: Path) -> str:
    """What the program says that was installed there."""
    words = [root / "opt/trigpoint/bin/python", "-P", "-m", "trigpoint", "edge"]
    environment = {"PATH": os.environ["PATH"]}
    return subprocess.run(words, capture_output=True, text=True, timeout=60, env=environment).stdout


def test_archive_installs_into_a_folder_without_root(folder: Path, tmp_path: Path) -> None:
    place, root = packed("camera", "c1", "--connect", SERVER), tmp_path / "a root"
    result = installed(place, root)
    assert result.returncode == 0, result.stderr
    site = load_site(root / "var/lib/trigpoint/site.toml")
    node_credentials(site, Kind.CAMERA, "c1")  # with modes that are let through
    assert mode(root / "var/lib/trigpoint") == 0o700
    assert (root / "etc/systemd/system/trigpoint-edge@.service").is_file()
    assert said_by(root) == "ran edge\n"
    make_wheel(folder / "dist" / wheel_name(this_machine()), "runs")  # of the same version
    again = installed(packed("camera", "c1", "--connect", SERVER), root)
    assert again.returncode == 0, again.stderr
    assert said_by(root) == "runs edge\n"


def test_archive_of_another_machine_is_not_installed(folder: Path, tmp_path: Path) -> None:
    make_wheel(folder / "dist" / wheel_name("riscv64"))
    place = packed("camera", "c1", "--connect", SERVER, "--machine", "riscv64")
    result = installed(place, tmp_path / "root")
    assert result.returncode == 1
    assert "this archive is for riscv64" in result.stderr
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["camera", "c9"], "no camera «c9»"),
        (["fusion", "main"], "write fusion fusion"),
        (["camera", "c1"], "--connect tls/ADDRESS:7447"),
        (["camera", "c1", "--connect", "tls"], "--connect: «tls» is no endpoint"),
        (["camera", "c1", "--connect", "tcp/10.0.0.1:7447"], "in the clear"),
        (["camera", "c1", "--connect", SERVER, "--machine", "mips"], "`make wheels`"),
        (["camera", "c1", "--connect", SERVER, "--wheel", "x.whl"], "--wheel x.whl is no wheel"),
        (["camera", "c1", "--connect", SERVER, "--constraints", "x"], "give --constraints FILE"),
        (["recorder", "main", "--site", "x.toml"], "no such site file"),
    ],
)
def test_what_cannot_be_packed_is_one_clear_line(
    folder: Path, cli: Cli, words: list[str], message: str
) -> None:
    assert message in cli.refused("pack", *words)
    assert not Path("packs").exists()


def test_missing_key_says_how_it_is_made(folder: Path, cli: Cli) -> None:
    Path("secure/camera-c1.key").unlink()
    said = cli.refused("pack", "camera", "c1", "--connect", SERVER)
    assert "trigpoint secure node camera c1" in said


def test_file_beyond_the_sites_folder_is_refused(folder: Path, cli: Cli) -> None:
    shutil.copy("targets/star.toml", folder.parent / "star.toml")
    Path("site.toml").write_text(FILE.replace("targets/star.toml", "../star.toml"))
    said = cli.refused("pack", "camera", "c1", "--connect", SERVER)
    assert "../star.toml lies outside of the site file's folder" in said


@pytest.mark.parametrize(
    "bus",
    [
        "",
        '[bus]\nlisten = ["tcp/0.0.0.0:7447"]\ninsecure = true\n',
        "[bus]  # mine\nconnect = [\"tcp/[fe80::1]:7447\", 'tcp/10.0.0.2:1'] # old\n"
        "insecure = true\n[recorder]\npictures = true\n",
    ],
)
def test_other_end_of_the_bus_replaces_what_was_there(bus: str) -> None:
    text = f'site = "lab"\n{bus}[cameras.c1]\nsource = "v4l2:///dev/video0"\n'
    site = parse_site(text, directory=Path())
    made = site_that_connects(site, "tcp/10.0.0.9:7447")
    assert (made.bus.connect, made.bus.listen) == (("tcp/10.0.0.9:7447",), ())
    assert (made.cameras, made.recorder, made.bus.insecure) == (
        site.cameras, site.recorder, site.bus.insecure,
    )  # fmt: skip
