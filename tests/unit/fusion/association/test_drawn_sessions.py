"""Drawn sessions that once came out wrong or not at all, worked out as `calibrate` does."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.session import composed_session
from trigpoint.recorder.recording import open_recording
from trigpoint.tools.calibrate import worked_out
from trigpoint.tools.session_inputs import session_inputs


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        # Either of two sightings that contradict each other may be wrong.
        pytest.param("mismatch", 7, id="contradiction"),
        # What a visit saw before and after a gap says how the robot came across it.
        pytest.param("composition", 110, id="lift beside a visit that goes on"),
        # A lift of a robot that rises, sinks and leans: three cameras were 0.2 to 2.4 m off.
        pytest.param("space", 12, id="robot in space"),
    ],
)
def test_every_camera_is_where_it_says(kind: str, seed: int, tmp_path: Path) -> None:
    session = composed_session(kind, seed)
    recording = open_recording(write_composition(session, tmp_path))
    pipeline = worked_out(recording, session_inputs(recording, site=None, network=None))
    cameras = pipeline.cameras()
    for name, place in session.last_places().items():
        assert name in cameras
        camera = cameras[name]
        error = camera.map_from_camera.difference(place)
        assert error @ np.linalg.solve(camera.covariance, error) < 6 * 2**2, name
