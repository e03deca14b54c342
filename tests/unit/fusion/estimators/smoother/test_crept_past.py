"""Cameras creep in a past as long as it lasts, however often it is summarised or read again."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS
from support.fusion.small_problems import SECONDS, eyes, first_state, small_data

from trigpoint.base.clock import to_ns
from trigpoint.fusion.estimators.smoother.settled_past import settled_past
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.known_cameras import Creep, KnownCameras
from trigpoint.fusion.past_file import load_past, save_past
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever

# Between two cameras a millimetre and a milliradian are known, and hardly where the map is; in
# these seconds they creep as far as others do in weeks.
RELATIVE, MAP, CREPT = 1e-3, 0.1, 1e-3
NOTHING_SHOWN = 1e7  # so many times coarser are the corners


def shared_turn() -> Array:
    """The disturbances (12, 6) of both cameras by one of the map."""
    return np.vstack([lever(pose.translation) for pose in eyes().values()])


def before() -> Array:
    """The covariance (12, 12) of what is known at first."""
    return RELATIVE**2 * np.eye(12) + MAP**2 * shared_turn() @ shared_turn().T


def drive() -> DataSet:
    """Two creeping cameras, known beforehand, whose sightings tell nothing of where they are."""
    data, per_day = small_data(known=True, sightings=40), CREPT / (SECONDS / 86_400) ** 0.5
    cameras = {
        name: replace(camera, creep_translation=per_day, creep_rotation=per_day)
        for name, camera in data.site.cameras.items()
    }
    data.site = replace(data.site, cameras=cameras)
    creep, information = Creep.of_all(cameras), np.linalg.inv(before())
    data.known = KnownCameras(eyes(), information, EPOCH_NS, creep)
    for entry in data.entries:
        entry.observation = entry.observation.scattering(NOTHING_SHOWN)
    return data


def summarised(data: DataSet, until_s: float) -> None:
    """Forget what is older."""
    since_ns = dict.fromkeys(data.tracks, EPOCH_NS + to_ns(until_s))
    past = settled_past(data, first_state(data), since_ns)
    assert past is not None
    data.forget(past)


def assert_crept_once(known: KnownCameras) -> None:
    """Each camera by itself, from what was known at first until the newest sighting."""
    assert known.until_ns is not None
    elapsed_s = (known.until_ns - EPOCH_NS) / 1e9
    assert elapsed_s > 0.9 * SECONDS
    expected = before() + CREPT**2 * elapsed_s / SECONDS * np.eye(12)
    np.testing.assert_allclose(known.covariance[:12, :12], expected, atol=0.01 * CREPT**2)


@pytest.mark.parametrize("parts", [1, 2, 10])
def test_cameras_creep_as_far_in_many_parts_as_in_one(parts: int) -> None:
    data = drive()
    for number in range(parts):
        summarised(data, SECONDS * (number + 1) / parts)
    assert_crept_once(data.known)


def test_a_start_creeps_nothing_twice(tmp_path: Path) -> None:
    data = drive()
    for number in range(4):
        summarised(data, SECONDS * (number + 1) / 4)
        assert data.past is not None
        save_past(tmp_path / "past.bin", data.past, data.site)
        data.past = load_past(tmp_path / "past.bin", data.site, data.targets)
        assert data.past is not None
        data.known = data.past.known
    assert_crept_once(data.known_at_start)
