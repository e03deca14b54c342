"""Which visits tell what a whole session needs to know."""

import pytest
from msgspec.structs import replace
from support.fusion.drives import make_session, observed, standing_plan

from trigpoint.base.clock import to_seconds
from trigpoint.fusion.association.visits import Visit, telling_of_lenses, visits_of


def visit(camera: str, first: int, count: int) -> Visit:
    indices = tuple(range(first, first + count))
    return Visit(camera, "r1", indices, indices, first, first + count)


def test_the_longest_visit_tells_a_camera_s_lens() -> None:
    visits = [visit("c1", 0, 4), visit("c2", 4, 5), visit("c1", 9, 6), visit("c1", 15, 3)]
    assert telling_of_lenses(visits, {"c1", "c2"}) == [visits[2], visits[1]]


def test_two_pictures_tell_no_lens_and_no_lens_is_asked_that_is_known() -> None:
    visits = [visit("c1", 0, 2), visit("c2", 2, 5)]
    assert telling_of_lenses(visits, {"c1"}) == []


@pytest.mark.parametrize(("hidden_s", "visits"), [(17.0, 1), (22.0, 2)])
def test_a_robot_that_was_out_of_sight_for_long_may_have_been_carried(
    hidden_s: float, visits: int
) -> None:
    """Even by a camera that has taken only two pictures, and though odometry says it stood."""
    data = observed(make_session(replace(standing_plan(), seconds=30.0)))
    seen = [each.observation for each in data.entries if each.observation.camera == "c1"]
    near = [abs(to_seconds(o.stamp_ns - seen[0].stamp_ns) - hidden_s) for o in seen]
    last = min(range(len(seen)), key=near.__getitem__)
    assert len(visits_of(data, [seen[0], seen[last]])) == visits
