"""Drawn sessions that once came out wrong or not at all, worked out as `calibrate` does."""

from pathlib import Path

import numpy as np

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.session import composed_session
from trigpoint.recorder.recording import open_recording
from trigpoint.tools.calibrate import worked_out
from trigpoint.tools.session_inputs import session_inputs


def test_either_of_two_sightings_that_contradict_each_other_may_be_wrong(tmp_path: Path) -> None:
    session = composed_session("mismatch", 7)
    recording = open_recording(write_composition(session, tmp_path))
    pipeline = worked_out(recording, session_inputs(recording, site=None, network=None))
    cameras = pipeline.cameras()
    for name, place in session.last_places().items():
        assert name in cameras
        camera = cameras[name]
        error = camera.map_from_camera.difference(place)
        assert error @ np.linalg.solve(camera.covariance, error) < 6 * 2**2, name
