"""The Cramér-Rao bound of a recorded session whose truth is known."""

from pathlib import Path

import numpy as np

from trigpoint.base.errors import InputError
from trigpoint.contract.messages import CameraInfo, Odometry, Sightings
from trigpoint.fusion.intake.message_intake import Intake
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.inputs import Inputs
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.model.readings import Readings
from trigpoint.map.network import load_tum
from trigpoint.recorder.session.recording import Recording
from trigpoint.tools.sessions.messages import messages_of
from trigpoint.tools.simulation.motion.odometry import poses_at

from .cramer_rao import Bound, Oracle, cramer_rao
from .truth import load_truth


def session_bound(recording: Recording, inputs: Inputs, folder: Path) -> Bound:
    """The bound of a session by its odometry, its sightings with their stated noise, and the truth
    in `folder` (truth.json and the trajectories that it names).

    Raises InputError where the truth is not there or nothing was sighted.
    """
    truth = load_truth(folder / "truth.json")
    data = DataSet(inputs.site, inputs.targets, dict(inputs.lenses), inputs.known)
    intake = Intake(data)
    for node, message in messages_of(recording).in_order:
        if isinstance(message, CameraInfo):
            data.lenses.setdefault(node, message.camera)
        elif isinstance(message, Readings) and node in data.tracks:
            data.tracks[node].add_run(message)
        elif isinstance(message, Odometry) and node in data.tracks:
            data.tracks[node].add(message.stamp_ns, message.pose)
        elif isinstance(message, Sightings) and node in data.lenses:
            intake.add(node, message, data.lenses[node])
    places = []
    for robot, track in data.tracks.items():
        if robot not in truth.robots or not len(track):
            continue
        stamps_ns, poses = load_tum(folder / truth.robots[robot])
        observations = intake.ready(robot, track.first_ns, track.last_ns)
        where = poses_at(stamps_ns, poses, np.array([o.stamp_ns for o in observations]))
        places += [(observation, where[i]) for i, observation in enumerate(observations)]
    if not places:
        raise InputError(f"{recording.path}: no sighting whose truth is known")
    cameras = {
        name: CameraState(record.pose, data.lenses[name])
        for name, record in truth.cameras.items()
        if name in data.lenses
    }
    return cramer_rao(data, Oracle(cameras, places))
