"""Which visits tell what a whole session needs to know."""

from trigpoint.fusion.association.visits import Visit, telling_of_lenses


def visit(camera: str, first: int, count: int) -> Visit:
    indices = tuple(range(first, first + count))
    return Visit(camera, "r1", indices, indices, first, first + count)


def test_the_longest_visit_tells_a_camera_s_lens() -> None:
    visits = [visit("c1", 0, 4), visit("c2", 4, 5), visit("c1", 9, 6), visit("c1", 15, 3)]
    assert telling_of_lenses(visits, {"c1", "c2"}) == [visits[2], visits[1]]


def test_two_pictures_tell_no_lens_and_no_lens_is_asked_that_is_known() -> None:
    visits = [visit("c1", 0, 2), visit("c2", 2, 5)]
    assert telling_of_lenses(visits, {"c1"}) == []
