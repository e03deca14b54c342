"""The files of a simulated site: site.toml, targets, intrinsics, and the truth beside them."""

from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlencode

import msgspec
import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.map.network import PoseRecord, encode_tum
from trigpoint.site.camera_info import write_camera_info
from trigpoint.site.config import BusConfig, OdometryNoise
from trigpoint.site.target import Target
from trigpoint.site.toml_file import said_of, toml_table
from trigpoint.tools.shapes.text import target_text

from .serial.speakers import WHEELS
from .world import World


def sim_url(world: World, camera: str, *, epoch_ns: int | None = None) -> str:
    """The source of a camera's pictures in this world, for site.toml."""
    options = {"world": world.name, "seed": str(world.seed)}
    if epoch_ns is not None:
        options["epoch_ns"] = str(epoch_ns)
    if world.target_choice is not None:
        options["target"] = world.target_choice
    return f"sim://{camera}?{urlencode(options, safe='/')}"


def write_site(
    world: World,
    directory: Path,
    *,
    epoch_ns: int | None = None,
    bus: BusConfig | None = None,
    recordings: str = "sessions",
    pictures: bool = False,
    protocol: str = "trigpoint",
    name: str | None = None,
    more_cameras: Mapping[str, Mapping[str, object]] | None = None,
) -> Path:
    """Write site.toml with its target files and every camera's intrinsics; return its path.

    `epoch_ns`: of a world that goes on in real time, when it begins; its robots are behind
    `robot_port`, and the truth lies beside; without such a time its robots are behind no port.
    `recordings`, `pictures`: the recorder's directory and choice; `name`: the site's, if not the
    world's; `more_cameras`: tables of cameras that the world lacks.
    """
    directory.mkdir(parents=True, exist_ok=True)
    targets = write_targets({name: world.target(name) for name in world.robots}, directory)
    lines = [f'site = "{name or world.site_name}"', ""]
    lines += _bus(bus) if bus is not None else []
    for eye, camera in world.cameras.items():
        write_camera_info(directory / f"{eye}.yaml", camera.model, eye)
        source = sim_url(world, eye, epoch_ns=epoch_ns)
        size = {"width": camera.model.width, "height": camera.model.height, "rate": camera.rate}
        lens: dict[str, object] = {"intrinsics": f"{eye}.yaml"}
        if camera.line_delay_s:
            lens["line_delay"] = camera.line_delay_s
        lines += toml_table(f"cameras.{eye}", {"source": source, **size, **lens})
    for eye, keys in (more_cameras or {}).items():
        lines += toml_table(f"cameras.{eye}", keys)
    for carrier, robot in world.robots.items():
        port = "loop://" if epoch_ns is None else f"./{robot_port(carrier)}"
        spoken = {"protocol": protocol} if protocol != "trigpoint" else {}
        lines += toml_table(
            f"robots.{carrier}", {"port": port, **spoken, "target": targets[carrier]}
        )
        if protocol in WHEELS:
            lines += toml_table(f"robots.{carrier}.wheels", said_of(WHEELS[protocol]))
        lines += toml_table(f"robots.{carrier}.odometry", noise_keys(robot.noise))
    lines += toml_table("recorder", {"directory": recordings, "pictures": pictures})
    path = directory / "site.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    if epoch_ns is not None:
        write_truth(world, directory, epoch_ns=epoch_ns)
    return path


def write_truth(world: World, directory: Path, *, epoch_ns: int) -> Path:
    """Write truth.json and each robot's true trajectory, one row an odometry message."""
    ways = {}
    for robot in world.robots:
        stamps_s = world.odometry(robot).stamps_s
        ways[robot] = stamps_ns(stamps_s, epoch_ns), world.map_from_base(robot, stamps_s)
    cameras = {name: camera.map_from_camera for name, camera in world.cameras.items()}
    return write_truth_of(cameras, ways, directory)


def write_truth_of(
    cameras: Mapping[str, Pose], ways: Mapping[str, tuple[np.ndarray, Pose]], directory: Path
) -> Path:
    """The same of map_from_camera, and of each robot's stamps (n,), ns, and map_from_base (n)."""
    directory.mkdir(parents=True, exist_ok=True)
    trajectories = {robot: f"{robot}_truth.tum" for robot in ways}
    for robot, way in ways.items():
        (directory / trajectories[robot]).write_bytes(encode_tum(*way))
    places = {name: PoseRecord.of(pose) for name, pose in cameras.items()}
    path = directory / "truth.json"
    truth = msgspec.json.encode({"cameras": places, "robots": trajectories})
    path.write_bytes(msgspec.json.format(truth, indent=1) + b"\n")
    return path


def robot_port(robot: str) -> str:
    """The name of the link, beside the site file, to a simulated robot's pseudo-terminal."""
    return f"{robot}.port"


def stamps_ns(stamps_s: np.ndarray, epoch_ns: int) -> np.ndarray:
    """World times (n,) as stamps, (n,) int64."""
    return np.array([epoch_ns + to_ns(float(t_s)) for t_s in stamps_s], dtype=np.int64)


def target_names(targets: Mapping[str, Target]) -> dict[str, str]:
    """Each robot's target file: one where all carry the same target, else one a robot."""
    alike = all(target == next(iter(targets.values())) for target in targets.values())
    return {robot: "target.toml" if alike else f"{robot}_target.toml" for robot in targets}


def write_targets(targets: Mapping[str, Target], directory: Path) -> dict[str, str]:
    """Write the target files; their names by robot."""
    names = target_names(targets)
    for robot, name in names.items():
        (directory / name).write_text(target_text(targets[robot]), encoding="utf-8")
    return names


def noise_keys(noise: OdometryNoise) -> dict[str, object]:
    """The values that matter: those of a planar robot, and what else is above 0."""
    values = msgspec.structs.asdict(noise)
    always = ("distance", "lateral", "heading_drive", "heading_turn")
    return {key: value for key, value in values.items() if key in always or value}


def _bus(bus: BusConfig) -> list[str]:
    values = msgspec.structs.asdict(bus)
    tls = values.pop("tls")
    return toml_table("bus", values) + (
        toml_table("bus.tls", msgspec.structs.asdict(tls)) if tls else []
    )
