"""From the files of a run to its results."""

import json
from itertools import islice
from pathlib import Path

import numpy as np

from trigpoint.base.clock import NANOSECONDS
from trigpoint.base.errors import InputError, read_text
from trigpoint.contract.topics import CORRECTED, ODOMETRY, ROBOT_POSE, topic_of
from trigpoint.geometry import Pose
from trigpoint.map.network import Network, PoseRecord, load_covariance, load_network, load_tum
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.networks.bound import session_bound
from trigpoint.tools.networks.truth import NetworkError, TruthFile, load_truth, network_error
from trigpoint.tools.report.demo.results import (
    CameraResult,
    DemoResults,
    KeyCount,
    RobotResult,
    Track,
)
from trigpoint.tools.sessions.inputs import session_inputs
from trigpoint.tools.simulation.world import World, load_world

from .folder import DemoFolder, DemoRecord
from .tracks import Tracks
from .watch import totals

_ENOUGH_PICTURES = 5
"""A camera that had the target before it in so many pictures can be located from them."""

_Counts = dict[str, dict[str, int]]


def load_results(folder: DemoFolder) -> DemoResults:
    """Hold what a run left in its folder against the truth.

    Raises InputError or RecordingError where a file is missing or wrong.
    """
    record = folder.read()
    world = load_world(record.world, seed=record.seed, target=record.target)
    truth = load_truth(folder.truth)
    network = load_network(folder.path)
    covariance = load_covariance(folder.path, network)
    error = network_error(network, covariance, truth)
    tracks = Tracks(folder.sessions, epoch_ns=record.epoch_ns)
    return DemoResults(
        world=record.world,
        seed=record.seed,
        target=record.target,
        seconds=record.seconds,
        network=network,
        covariance=covariance,
        error=error,
        cameras=_cameras(world, record, network, truth, error),
        robots=tuple(_robot(folder, record, truth, tracks, name) for name in truth.robots),
        keys=_keys(record.counts, tracks.counts),
        latencies_s=tracks.latencies_s,
        series=tracks.uncertainty(network.cameras),
        walls=np.array([[wall.start, wall.end] for wall in world.walls]),
        restarts=record.restarts,
        rejected={
            node: numbers["rejected"]
            for node, numbers in record.counts.items()
            if numbers.get("rejected")
        },
        is_whole=record.seconds == world.duration_s,
        bound_m=_bound_m(folder) if error.distance is not None else None,
    )


def came_by(world: World, camera: str, seconds: float) -> bool:
    """Whether a robot showed a camera its target in enough pictures before a world time."""
    times_s = world.camera(camera).picture_times(seconds).tolist()
    met = (t_s for t_s in times_s if world.sightings(camera, t_s))
    return len(list(islice(met, _ENOUGH_PICTURES))) == _ENOUGH_PICTURES


def _cameras(
    world: World, record: DemoRecord, network: Network, truth: TruthFile, error: NetworkError
) -> tuple[CameraResult, ...]:
    results = []
    for name, camera in network.cameras.items():
        agent = record.counts.get(f"edge/{name}", {})
        results.append(
            CameraResult(
                name=name,
                truth=truth.cameras[name].pose,
                record=camera,
                came_by=camera.status == "located" or came_by(world, name, record.seconds),
                error=error.cameras.get(name),
                pictures=agent.get("pictures"),
                skipped=agent.get("pictures.lost", 0) if agent else None,
                given_up=agent.get("given_up.lost", 0),
            )
        )
    return tuple(results)


def _robot(
    folder: DemoFolder, record: DemoRecord, truth: TruthFile, tracks: Tracks, name: str
) -> RobotResult:
    odometry = tracks.track(ODOMETRY, name)
    end_s = odometry.t_s[-1] if len(odometry.t_s) else record.seconds
    believed = _believed(folder.journal(name), record.epoch_ns)
    return RobotResult(
        name=name,
        truth=_tum(folder.path / truth.robots[name], record.epoch_ns).until(end_s),
        odometry=odometry,
        live=tracks.track(ROBOT_POSE, name),
        believed=(believed if len(believed.t_s) else tracks.track(CORRECTED, name)).until(end_s),
        smoothed=_tum(folder.path / f"{name}.tum", record.epoch_ns),
        suggestion=tracks.suggestion(name),
    )


def _tum(path: Path, epoch_ns: int) -> Track:
    """A trajectory file; an empty track where there is none."""
    if not path.exists():
        return Track.of(np.zeros(0), Pose.planar(np.zeros(0), np.zeros(0), np.zeros(0)))
    stamps_ns, poses = load_tum(path)
    return Track.of((stamps_ns - epoch_ns) / NANOSECONDS, poses)


def _believed(path: Path, epoch_ns: int) -> Track:
    """What the robot itself believed from its first correction on, by its firmware's journal; no
    row where it cannot be told where it is, which its bridge knows then."""
    stamps_ns, poses = [], []
    for line in read_text(path, "robot's journal", InputError).splitlines():
        note = json.loads(line)
        if note["kind"] == "belief" and note["map_from_base"] is not None:
            stamps_ns.append(note["stamp_ns"])
            poses.append(PoseRecord(**note["map_from_base"]).pose)
    times_s = np.array([(stamp - epoch_ns) / NANOSECONDS for stamp in stamps_ns])
    return Track.of(times_s, Pose.stack(poses) if poses else Pose.planar(*np.zeros((3, 0))))


def _bound_m(folder: DemoFolder) -> float | None:
    """The least mean distance error that one can expect of the session; None where its recorder
    was started again, so that no file has all of it."""
    if len(folder.sessions) != 1:
        return None
    recording = open_recording(folder.session)
    inputs = session_inputs(recording, site=None, network=None)
    return session_bound(recording, inputs, folder.path).mean_distance_error


def _keys(counts: _Counts, recorded: dict[str, int]) -> tuple[KeyCount, ...]:
    """A row for every key on which anything was sent, received or recorded."""
    sent, received = totals(counts, "sent"), totals(counts, "received")
    taken = totals(counts, "recorded")
    found = []
    for key in sorted({*sent, *received, *recorded}):
        topic = topic_of(key)
        if topic is None:
            continue
        senders = sent.get(key)
        found.append(
            KeyCount(
                path=key.partition("/")[2],
                is_reliable=topic.delivery.is_reliable,
                sent=sum(senders.values()) if senders else None,
                received=received.get(key) or taken.get(key, {}),
                recorded=recorded.get(key, 0),
            )
        )
    return tuple(found)
