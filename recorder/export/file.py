"""The command `export`: a session and its network in the formats of other tools."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct

from trigpoint.base.errors import InputError, MessageError, writing
from trigpoint.contract import cdr
from trigpoint.contract.messages import Odometry, PoseEstimate
from trigpoint.contract.topics import ODOMETRY, ROBOT_POSE, Topic, node_of
from trigpoint.geometry import Pose
from trigpoint.map.building import (
    Building,
    attached_plan,
    lay_network,
    load_plan,
    own_covariances,
)
from trigpoint.map.network import Network, decode_network, encode_tum
from trigpoint.recorder.session.recording import (
    NETWORK_ATTACHMENT,
    SITE_ATTACHMENT,
    Recording,
    open_recording,
)
from trigpoint.site.camera_info import write_camera_info
from trigpoint.site.config import Site, load_site, parse_site

from .formats import camchain, launch_file


class Source(Struct, frozen=True):
    """What is exported; the network only where there is one, and where its map lies in the building
    only where the site file says so. `given`: the site in place of the one that is attached."""

    recording: Recording
    network: Network | None
    building: Building | None = None
    given: Site | None = None

    @property
    def site(self) -> Site:
        """The site; raise InputError where there is none."""
        if self.given is not None:
            return self.given
        text, folder = self.recording.site_text, self.recording.folder
        return parse_site(text, directory=folder, file="attached site.toml")

    def need_network(self) -> Network:
        """The network; raise InputError where there is none."""
        if self.network is None:
            raise InputError(
                f"{self.recording.path}: no network is attached or lies beside it; "
                "run `trigpoint calibrate` first, or give --network"
            )
        return self.network


def main(
    session: Annotated[Path, typer.Argument(help="An .mcap file, or a folder with a session.")],
    out: Annotated[Path, typer.Option(help="The folder to write to.", file_okay=False)],
    formats: Annotated[
        list[str],
        typer.Option("--format", metavar="tum|kalibr|ros|launch|rrd|mcap", help="One of these."),
    ] = [],  # noqa: B006 - typer makes a list of it anew
    network: Annotated[
        Path | None,
        typer.Option(help="The network.json, if not the one attached to the session or beside it."),
    ] = None,
    site: Annotated[
        Path | None, typer.Option(help="The site file, if not the one in the session.")
    ] = None,
) -> None:
    """Write trajectories (TUM), Kalibr's camchain, ROS camera_info and launch files, a rerun file,
    and a recording that Foxglove and RViz draw whole, with their layouts.

    Without --format: everything that the session gives.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise InputError(f"--format {unknown[0]}: there is none such; give {', '.join(FORMATS)}")
    recording = open_recording(session)
    found = _network(recording, network)
    given = load_site(site) if site else None
    source = Source(recording, found, _building(recording, found, given), given)
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        for name in formats or FORMATS:
            if not formats and name in _OF_NETWORK and source.network is None:
                typer.echo(f"left out: {name}: there is no network; run `trigpoint calibrate`")
                continue
            for file in FORMATS[name](source, out):
                typer.echo(f"wrote {file}")


def _network(recording: Recording, given: Path | None) -> Network | None:
    folder = recording.folder
    if given is not None:
        path = given / NETWORK_ATTACHMENT if given.is_dir() else given
        if not path.is_file():
            raise InputError(f"{path}: there is no such network file; check the path")
        return decode_network(path.read_bytes(), source=str(path))
    for path in (folder / NETWORK_ATTACHMENT, folder / "calibration" / NETWORK_ATTACHMENT):
        if path.is_file():
            return decode_network(path.read_bytes(), source=str(path))
    data = recording.attachments.get(NETWORK_ATTACHMENT)
    return decode_network(data, source=f"{recording.path}: attached") if data else None


def _building(recording: Recording, network: Network | None, given: Site | None) -> Building | None:
    """Where the map lies, by the cameras' own covariances; what hinders that is said."""
    if network is None or (given is None and SITE_ATTACHMENT not in recording.attachments):
        return None
    try:
        site = Source(recording, network, given=given).site
        plan = load_plan(given) if given else attached_plan(site, recording.attachments)
        tracks = _tracks(recording, ROBOT_POSE).items() if site.map and site.map.points else ()
        ways = {robot: (np.array(stamps), Pose.stack(poses)) for robot, (stamps, poses) in tracks}
        return lay_network(site, plan, network, own_covariances(network), ways)
    except InputError as reason:
        typer.echo(f"left out: the map's place in the building: {reason}", err=True)
        return None


def _tum(source: Source, out: Path) -> list[Path]:
    """Odometry as it came, and the corrected poses, of every robot."""
    written = []
    for topic, what in ((ODOMETRY, "odometry"), (ROBOT_POSE, "corrected")):
        for robot, (stamps_ns, poses) in _tracks(source.recording, topic).items():
            file = out / f"{robot}_{what}.tum"
            file.write_bytes(encode_tum(np.array(stamps_ns), Pose.stack(poses)))
            written.append(file)
    if not written:
        raise InputError(f"{source.recording.path}: no robot's odometry or pose is in it")
    return written


def _tracks(recording: Recording, topic: Topic) -> dict[str, tuple[list[int], list[Pose]]]:
    tracks: dict[str, tuple[list[int], list[Pose]]] = {}
    for sample in recording.samples([topic]):
        try:
            message = cdr.decode(topic.type_name, sample.payload)
        except MessageError:
            continue
        if isinstance(message, (Odometry, PoseEstimate)):
            stamps_ns, poses = tracks.setdefault(node_of(sample.key), ([], []))
            stamps_ns.append(message.stamp_ns)
            poses.append(message.pose)
    return tracks


def _kalibr(source: Source, out: Path) -> list[Path]:
    text, left_out = camchain(source.need_network())
    for reason in left_out:
        typer.echo(f"left out: camchain: {reason}", err=True)
    if not text:
        return []
    file = out / "camchain.yaml"
    file.write_text(text, encoding="utf-8")
    return [file]


def _ros(source: Source, out: Path) -> list[Path]:
    written = []
    for name, record in source.need_network().cameras.items():
        if record.intrinsics is not None:
            file = out / f"{name}.yaml"
            write_camera_info(file, record.intrinsics.camera, name)
            written.append(file)
    return written


def _launch(source: Source, out: Path) -> list[Path]:
    file = out / "cameras.launch.py"
    file.write_text(launch_file(source.need_network(), source.building), encoding="utf-8")
    return [file]


def _rrd(source: Source, out: Path) -> list[Path]:
    from trigpoint.recorder.viewer.review import write_rrd  # rerun takes half a second to import

    file = out / f"{source.recording.name}.rrd"
    write_rrd(source.recording, file, given=source.given)
    return [file]


def _mcap(source: Source, out: Path) -> list[Path]:
    from .drawable import foxglove_layout, rviz_configuration, write_drawable

    recording, site = source.recording, source.site
    recording.check_is_session()
    file = out / "drawable.mcap"
    file.unlink(missing_ok=True)
    write_drawable(recording, source.network, file, source.building)
    layout, rviz = out / "foxglove_layout.json", out / "trigpoint.rviz"
    layout.write_text(
        foxglove_layout(site.name, list(site.cameras), list(site.robots)), encoding="utf-8"
    )
    rviz.write_text(
        rviz_configuration(site.name, list(site.cameras), list(site.robots)), encoding="utf-8"
    )
    return [file, layout, rviz]


FORMATS: dict[str, Callable[[Source, Path], list[Path]]] = {
    "tum": _tum,
    "kalibr": _kalibr,
    "ros": _ros,
    "launch": _launch,
    "rrd": _rrd,
    "mcap": _mcap,
}
_OF_NETWORK = ("kalibr", "ros", "launch")
