"""A session as Foxglove and RViz draw all of it: annotations over the pictures, a lens beside each
of them, every located camera on /tf_static, topics where these tools look for them."""

import json
from collections.abc import Iterator
from pathlib import Path

from trigpoint.base.errors import MessageError
from trigpoint.contract import cdr
from trigpoint.contract.messages import CameraInfo, Sightings, Transform, Transforms
from trigpoint.contract.topics import CAMERA_INFO, IMAGE, SIGHTINGS, TF_STATIC, node_of
from trigpoint.map.building import Building
from trigpoint.map.network import Network
from trigpoint.recorder.mcap.channels import quality_of_service
from trigpoint.recorder.mcap.chunk import Pending
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.session.recording import RecordedSample, Recording

from .annotations import ANNOTATIONS, annotations, prepare


def write_drawable(
    recording: Recording, network: Network | None, path: Path, building: Building | None = None
) -> dict[str, int]:
    """Write the session with what drawing tools want beside it; return the counts by key.

    `network`: its located cameras stand on tf_static from the start, also where the session was
    calibrated only afterwards; `building`: where the map lies in it, on tf_static too.
    """
    prepare()
    with McapWriter(path) as writer:
        drawn = _Drawn(writer)
        if network is not None:
            drawn.place(network, building, recording.start_ns)
        for name, data in recording.attachments.items():
            writer.attach(name, data, "", time_ns=recording.start_ns)
        for sample in recording.samples():
            drawn.add(sample)
    return writer.counts


class _Drawn:
    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._lenses: dict[str, CameraInfo] = {}
        self._annotated: dict[str, int] = {}

    def place(self, network: Network, building: Building | None, start_ns: int) -> None:
        transforms = []
        if building is not None:
            pose = building.frame_from_map
            transforms.append(Transform(start_ns, building.frame, "map", pose))
        for name in network.located:
            record = network.cameras[name].map_from_camera
            assert record is not None
            transforms.append(Transform(start_ns, "map", f"{name}/optical", record.pose))
        if transforms:
            self._writer.add(
                TF_STATIC,
                TF_STATIC.key(network.site),
                cdr.encode(Transforms(tuple(transforms))),
                log_ns=start_ns,
                published_ns=start_ns,
            )

    def add(self, sample: RecordedSample) -> None:
        if sample.topic is CAMERA_INFO:
            self._learn(sample)
        elif sample.topic is IMAGE:
            self._repeat_lens(sample)
        elif sample.topic is SIGHTINGS:
            self._annotate(sample)
        self._writer.add(
            sample.topic,
            sample.key,
            sample.payload,
            log_ns=sample.log_ns,
            published_ns=sample.published_ns,
            attachment=sample.attachment,
        )

    def _learn(self, sample: RecordedSample) -> None:
        message = _decoded(sample)
        if isinstance(message, CameraInfo):
            self._lenses[node_of(sample.key)] = message

    def _repeat_lens(self, sample: RecordedSample) -> None:
        """The lens with the picture's stamp, where the session does not have it beside each."""
        camera, lens = node_of(sample.key), self._lenses.get(node_of(sample.key))
        stamp_ns = _stamp_of(sample.payload)
        if lens is None or lens.stamp_ns == stamp_ns:
            return
        self._writer.add(
            CAMERA_INFO,
            CAMERA_INFO.key(sample.key.partition("/")[0], camera),
            cdr.encode(CameraInfo(stamp_ns, lens.frame_id, lens.camera)),
            log_ns=sample.log_ns,
            published_ns=sample.published_ns,
        )

    def _annotate(self, sample: RecordedSample) -> None:
        message = _decoded(sample)
        if not isinstance(message, Sightings):
            return
        key = sample.key.rpartition("/")[0] + "/annotations"
        channel = self._annotated.get(key)
        if channel is None:
            metadata = {
                "offered_qos_profiles": quality_of_service(SIGHTINGS),
                "topic_type_hash": cdr.type_hash(ANNOTATIONS),
            }
            text = cdr.definition(ANNOTATIONS).encode()
            channel = self._writer.define(key, ANNOTATIONS, "ros2msg", text, metadata)
            self._annotated[key] = channel
        row: Pending = sample.log_ns, sample.published_ns, channel, annotations(message)
        self._writer.append([row])


def _decoded(sample: RecordedSample) -> object:
    try:
        return cdr.decode(sample.topic.type_name, sample.payload)
    except MessageError:
        return None


def _stamp_of(payload: bytes) -> int:
    """The stamp of a message that begins with a header: after CDR's four bytes."""
    seconds = int.from_bytes(payload[4:8], "little", signed=True)
    return seconds * 10**9 + int.from_bytes(payload[8:12], "little")


def foxglove_layout(site: str, cameras: list[str], robots: list[str]) -> str:
    """A Foxglove layout: the map large with frames, frusta, floors and robots, every camera's
    picture with its sightings, the diagnostics."""
    panels: dict[str, object] = {"3D!map": _map_panel(site, cameras, robots)}
    for camera in cameras:
        topic = f"/{site}/camera/{camera}"
        panels[f"Image!{camera}"] = {
            "imageMode": {
                "imageTopic": f"{topic}/image/compressed",
                "calibrationTopic": f"{topic}/camera_info",
                "annotations": {f"{topic}/annotations": {"visible": True}},
            },
            "foxglovePanelTitle": camera,
        }
    panels["DiagnosticSummary!all"] = {"topicToRender": f"/{site}/diagnostics"}
    pictures = _stacked([f"Image!{camera}" for camera in cameras])
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": {
            "direction": "row",
            "first": {
                "direction": "column",
                "first": "3D!map",
                "second": "DiagnosticSummary!all",
                "splitPercentage": 75,
            },
            "second": pictures,
            "splitPercentage": 60,
        },
    }
    return json.dumps(layout, indent=1)


def _map_panel(site: str, cameras: list[str], robots: list[str]) -> dict[str, object]:
    shown = ["tf", "tf_static"]
    shown += [f"camera/{camera}/camera_info" for camera in cameras]  # drawn as a frustum
    shown += ["coverage", *(f"coverage/{camera}" for camera in cameras)]
    shown += [f"robot/{robot}/{what}" for robot in robots for what in ("pose", "odom")]
    return {
        "followTf": "map",
        "scene": {"transforms": {"labelSize": 0.1, "axisScale": 0.4}},
        "topics": {f"/{site}/{path}": {"visible": True} for path in shown},
        "layers": {"grid": {"layerId": "foxglove.Grid", "frameId": "map", "size": 20}},
        "cameraState": {"distance": 20, "phi": 45, "thetaOffset": 45},
    }


def _stacked(names: list[str]) -> object:
    """Panels in a balanced tree of columns and rows."""
    if len(names) == 1:
        return names[0]
    half = (len(names) + 1) // 2
    direction = "column" if len(names) > 2 else "row"
    return {
        "direction": direction,
        "first": _stacked(names[:half]),
        "second": _stacked(names[half:]),
        "splitPercentage": 50,
    }


def rviz_configuration(site: str, cameras: list[str], robots: list[str]) -> str:
    """An RViz configuration with the frames, every camera's picture, poses and odometry."""
    return "".join(_rviz_lines(site, cameras, robots))


def _rviz_lines(site: str, cameras: list[str], robots: list[str]) -> Iterator[str]:
    yield (
        "Panels:\n  - Class: rviz_common/Displays\n    Name: Displays\n"
        "  - Class: rviz_common/Time\n    Name: Time\n"
        'Visualization Manager:\n  Class: ""\n  Global Options:\n    Fixed Frame: map\n'
        "    Frame Rate: 30\n  Displays:\n"
        "    - {Class: rviz_default_plugins/Grid, Name: Grid, Enabled: true, Value: true}\n"
        "    - {Class: rviz_default_plugins/TF, Name: TF, Enabled: true, Value: true, "
        "Marker Scale: 0.6}\n"
    )
    for robot in robots:
        for what, kind in (("odom", "Odometry"), ("pose", "PoseWithCovariance")):
            yield _rviz_display(kind, f"{robot} {what}", f"/{site}/robot/{robot}/{what}")
    for camera in cameras:
        yield _rviz_display("Camera", camera, f"/{site}/camera/{camera}/image")
    yield (
        "  Tools:\n    - Class: rviz_default_plugins/MoveCamera\n"
        "  Views:\n    Current:\n      Class: rviz_default_plugins/Orbit\n      Distance: 20\n"
        "      Pitch: 0.9\n      Yaw: 0.8\n"
    )


def _rviz_display(kind: str, name: str, topic: str) -> str:
    transport = "" if kind != "Camera" else "      Image Rendering: background and overlay\n"
    suffix = "/compressed" if kind == "Camera" else ""
    return (
        f"    - Class: rviz_default_plugins/{kind}\n      Name: {name}\n      Enabled: true\n"
        f"      Value: true\n{transport}      Topic:\n        Value: {topic}{suffix}\n"
        "        Reliability Policy: Best Effort\n"
    )
