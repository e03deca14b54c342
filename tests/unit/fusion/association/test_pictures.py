"""How a picture is read whose camera is known, and what of it is wrong."""

import numpy as np
from msgspec.structs import replace
from support.fusion.drives import Session, observed

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.mode import Mode
from trigpoint.fusion.association.modes import ModeFinder
from trigpoint.fusion.association.noise import Noise, with_noise
from trigpoint.fusion.association.pictures import PictureReader
from trigpoint.fusion.association.visits import visits_of
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation
from trigpoint.geometry import Pose

SWAY = Noise(tilt=0.01, sway=0.01)


def of_two_faces(data: DataSet) -> tuple[Observation, Mode, Pose]:
    """A picture of two faces, how its visit is read, and where the robot then stood."""
    observations = [entry.observation for entry in data.entries]
    visit = visits_of(data, observations)[0]
    mode = ModeFinder(data, observations, Events()).modes_of(visit).modes[0]
    index = next(i for i in visit.chosen if len(observations[i].views) == 2)
    return observations[index], mode, mode.poses[index]


def test_faces_of_one_picture_that_contradict_each_other_are_not_both_right(
    charuco: Session,
) -> None:
    """Each may be there by itself, since the robot sways; but it stood there once."""
    data = with_noise(observed(charuco), {"r1": SWAY})
    good, mode, stood = of_two_faces(data)
    first, second = good.views
    off = replace(second, pixels=second.pixels + np.array([2.5, -2.0]))
    alone = replace(good, views=(off,))
    reader = PictureReader(data, "r1", mode.camera, Events())
    whole, single, both = reader.read(
        [good, alone, replace(good, views=(first, off))],
        Pose.stack([stood] * 3),
        np.zeros((3, 6, 6)),
    )
    assert all(reading is not None for reading in whole[0])
    assert single[0][0] is not None
    assert sum(reading is None for reading in both[0]) == 1


def test_faces_that_agree_where_odometry_does_not_lead_are_right_together(
    charuco: Session,
) -> None:
    """The robot slipped by two centimetres; of a single face that would be no evidence."""
    data = observed(charuco)
    whole, mode, stood = of_two_faces(data)
    reader = PictureReader(data, "r1", mode.camera, Events(), is_strict=True)
    slipped = Pose.stack([stood @ Pose.planar(0.02, 0.0, 0.0)] * 2)
    drift = np.tile(np.diag([3e-3, 3e-3, 1e-6, 1e-6, 1e-6, 3e-3]) ** 2, (2, 1, 1))
    both, single = reader.read([whole, replace(whole, views=whole.views[:1])], slipped, drift)
    assert all(reading is not None for reading in both[0])
    assert single[0] == (None,)


def test_robot_that_odometry_puts_beside_the_camera_is_not_seen_there(charuco: Session) -> None:
    """Where no lens shows it, a projection is of no meaning, however steep it is."""
    data = with_noise(observed(charuco), {"r1": SWAY})
    whole, mode, _ = of_two_faces(data)
    lens = replace(mode.camera.lens, distortion=(-0.05, 0.13, 0.003, 0.006, -0.385))
    camera = replace(mode.camera, lens=lens)
    heights = np.linspace(-0.5, 0.5, 200)
    beside = [Pose(np.eye(3), np.array([3.0, 1.0, z])) for z in heights]
    places = camera.map_from_camera @ Pose.stack(beside)
    drift = np.tile(np.diag([1e-4, 1e-4, 1e-12, 1e-12, 1e-12, 1e-4]), (len(heights), 1, 1))
    found = PictureReader(data, "r1", camera, Events()).read([whole] * len(heights), places, drift)
    assert [readings for readings, _ in found] == [(None, None)] * len(heights)
