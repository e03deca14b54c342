"""Moments that are solved for between sightings that lie far apart."""

import numpy as np
from support.builders import make_site

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.assembly import filled
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry import Pose


def test_years_between_two_steps_are_one_moment_and_seconds_in_which_it_drove_are_each_one() -> (
    None
):
    """As odometry has them whose stamps are not in seconds."""
    track = OdometryTrack(make_site().robots["r1"].odometry, planar=True)
    years_s = 3e9
    times_s = [*np.arange(0.0, 10.0, 0.5), *(years_s + np.arange(0.0, 10.0, 0.5))]
    for number, time_s in enumerate(times_s):
        track.add(to_ns(time_s), Pose(np.eye(3), np.array([0.1 * number, 0.0, 0.0])))
    found_s = filled(track.stamps_ns[[0, -1]], track) / 1e9
    early, late = found_s[found_s < 11], found_s[found_s > years_s - 1]
    assert 9 <= len(early) <= 21
    assert 9 <= len(late) <= 21
    assert len(found_s) - len(early) - len(late) <= 1
