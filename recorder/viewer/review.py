"""A recorded session as a rerun file."""

import logging
from collections.abc import Collection
from contextlib import closing
from pathlib import Path

import rerun as rr

from trigpoint.base.errors import MessageError, OperationError
from trigpoint.base.terminal import Progress
from trigpoint.contract import cdr
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import CAMERA_POSE, IMAGE, TOPICS, Topic, node_of, topic_of
from trigpoint.map.building import attached_plan, load_plan
from trigpoint.map.network import decode_network
from trigpoint.recorder.session.recording import NETWORK_ATTACHMENT, Recording
from trigpoint.site.config import Site, parse_site
from trigpoint.site.target import Target, parse_target

from .blueprint import blueprint
from .columns import Columns, open_stream
from .overlay import Overlay, draw
from .scene import Scene

_LOG = logging.getLogger(__name__)


def write_rrd(
    recording: Recording,
    path: Path,
    overlays: Collection[Overlay] = (),
    *,
    given: Site | None = None,
) -> int:
    """Write what `view` would have shown, with the overlays; return how many messages are in it.
    `given`: the site in place of the one that is attached.

    Messages that do not decode are left out, counted and named. Raises RecordingError where the
    session has no site.toml, OperationError where the file cannot be written.
    """
    recording.check_is_session()
    site = given or attached_site(recording)
    plan = load_plan(given) if given else attached_plan(site, recording.attachments)
    stream = open_stream(site.name, recording.start_ns)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream.save(path)
    except (OSError, RuntimeError) as reason:
        raise OperationError(f"{path}: cannot be written ({reason}); give another file") from None
    targets = attached_targets(recording, site)
    columns = Columns(stream, keeps=lambda archetype: archetype is not rr.EncodedImage)
    scene = Scene(site, targets, columns, plan=plan)
    scene.announce()
    for overlay in overlays:
        draw(overlay, columns)
    _place_cameras(recording, scene)
    with closing(Progress("review", sum(recording.counts.values()))) as progress:
        shown, unsound = _show_all(recording, scene, columns, TOPICS, progress)
    _warn(recording, unsound, scene.strangers)
    scene.finish()
    columns.flush()
    stream.send_blueprint(blueprint(site, scene.extent, scene.span_ns))
    # Pictures come last: they are nearly all of the bytes, and a viewer that takes its time over
    # them shows the whole map and every plot meanwhile.
    pictures = Columns(stream, keeps=lambda archetype: archetype is rr.EncodedImage)
    scene = Scene(site, targets, pictures)
    _place_cameras(recording, scene)
    with closing(Progress("review: pictures")) as progress:
        _show_all(recording, scene, pictures, (IMAGE, CAMERA_POSE), progress)
    pictures.flush()
    stream.flush()
    stream.disconnect()
    return shown


def attached_site(recording: Recording) -> Site:
    """The session's site.toml."""
    folder = recording.folder
    return parse_site(recording.site_text, directory=folder, file=f"{recording.path}: site.toml")


def attached_targets(recording: Recording, site: Site) -> dict[str, Target]:
    """Each robot's target as far as its file is attached."""
    targets = {}
    for robot in site.robots:
        name = site.target_name(robot)
        if data := recording.attachments.get(name):
            text = data.decode(errors="replace")
            targets[robot] = parse_target(text, file=f"{recording.path}: {name}")
        else:
            _LOG.warning("%s: %s is not attached; %s has no faces", recording.path, name, robot)
    return targets


def _place_cameras(recording: Recording, scene: Scene) -> None:
    """Where no pose was recorded, show the located cameras of a network.json: attached, or beside.

    So a session that was calibrated afterwards shows its cameras.
    """
    if any(topic_of(key) is CAMERA_POSE for key in recording.counts):
        return
    beside = recording.folder / NETWORK_ATTACHMENT
    data = recording.attachments.get(NETWORK_ATTACHMENT)
    if data is None and beside.is_file():
        data = beside.read_bytes()
    if data is None:
        return
    network = decode_network(data, source=f"{recording.path}: {NETWORK_ATTACHMENT}")
    for name in network.located:
        record = network.cameras[name]
        if name in scene.cameras and record.map_from_camera is not None:
            pose, covariance = record.map_from_camera.pose, record.covariance_matrix
            estimate = PoseEstimate(recording.start_ns, "map", pose, covariance)
            scene.add(CAMERA_POSE, name, estimate)


def _show_all(
    recording: Recording,
    scene: Scene,
    columns: Columns,
    topics: Collection[Topic],
    progress: Progress,
) -> tuple[int, int]:
    """How many messages are shown, and how many do not decode."""
    shown, unsound = 0, 0
    for sample in recording.samples(topics):
        progress.step()
        try:
            message = cdr.decode(sample.topic.type_name, sample.payload)
            scene.add(sample.topic, node_of(sample.key), message, sample.log_ns)
        except MessageError as reason:
            if not unsound:
                _LOG.warning("%s: %s at %d: %s", recording.path, sample.key, sample.log_ns, reason)
            unsound += 1
            continue
        shown += 1
        if columns.is_full:
            columns.flush()
    return shown, unsound


def _warn(recording: Recording, unsound: int, strangers: int) -> None:
    if unsound:
        _LOG.warning("%s: %d messages do not decode; left out", recording.path, unsound)
    if strangers:
        why = "of cameras or robots that site.toml does not have; left out"
        _LOG.warning("%s: %d messages %s", recording.path, strangers, why)
    for key in recording.unknown_keys:
        _LOG.warning("%s: %s is not a key of the contract; left out", recording.path, key)
