"""What is advised next, by the views that are kept."""

import numpy as np
import pytest
from support.pictures.boards import CAMERA, charuco, placed, true_pixels
from support.pictures.lens_views import PINHOLE, SIZE, board_views

from trigpoint.edge.lens.calibration_views import View
from trigpoint.site.config import CameraConfig
from trigpoint.tools.look.guidance import Guide, Kind, Need, coverage, needs, next_need

CONFIG = CameraConfig("dir://pictures")


def view_of(name: str, **pose: float) -> View:
    seen = placed(charuco(), **pose)
    return View(name, charuco().corners, true_pixels(seen), 0.1)


def met(views: list[View]) -> set[str]:
    return {need.name for need in needs(views, CAMERA) if need.is_met}


def guide_with(views: list[View]) -> Guide:
    guide = Guide(CONFIG)
    guide.look(views, SIZE, None)
    return guide


TURNS = [{"yaw_deg": 35.0}, {"yaw_deg": -35.0}, {"tilt_deg": 35.0}, {"tilt_deg": -35.0}]


@pytest.mark.parametrize(("pose", "axis"), [*zip(TURNS, (0, 0, 1, 1), strict=True)])
def test_a_tilt_is_that_of_the_edge_that_is_nearer(pose: dict[str, float], axis: int) -> None:
    face, camera_from_face = placed(charuco(), **pose)
    corners = camera_from_face @ face.outline
    nearest = corners[corners[:, 2] < corners[:, 2].mean()][:, axis].mean()
    name = (("left", "right"), ("upper", "lower"))[axis][int(nearest > 0)]
    wanted = needs([view_of("v", **pose)], CAMERA)
    tilts = {need.name for need in wanted if need.kind is Kind.TILT and need.is_met}
    assert tilts == {f"{name} edge nearer"}


def test_a_board_that_is_held_straight_tells_no_tilt() -> None:
    tilts = [n for n in needs([view_of("v")], CAMERA) if n.kind is Kind.TILT]
    assert max(need.share for need in tilts) < 0.1


def test_near_and_far_are_two_needs() -> None:
    near, far = view_of("near", distance=0.35), view_of("far", distance=0.9)
    assert "near" in met([near])
    assert "far" not in met([near])
    assert {"near", "far"} <= met([near, far])


def test_places_are_where_corners_were() -> None:
    view = view_of("v", x=-0.25, y=-0.18, distance=0.8)
    covered = coverage([view], SIZE)
    assert covered.sum() == len(view)
    middle = view.pixels.mean(axis=0)
    assert middle[0] < SIZE[0] / 3
    assert middle[1] < SIZE[1] / 2
    shares = {n.name: n.share for n in needs([view], CAMERA) if n.kind is Kind.PLACE}
    assert max(shares, key=lambda name: shares[name]) == "upper left"
    assert shares["lower right"] == 0


def test_views_all_over_meet_every_need() -> None:
    wanted = needs(board_views(60, 3, near=0.25), PINHOLE)
    assert [need for need in wanted if need.kind is not Kind.DISTANCE and not need.is_met] == []
    assert len(wanted) == 9 + 4 + 2


def test_the_kind_that_is_met_least_comes_next_and_of_it_the_least_met() -> None:
    def need(kind: Kind, name: str, share: float) -> Need:
        return Need(kind, name, share, f"do {name}")

    wanted = [
        need(Kind.PLACE, "left", 0.6),
        need(Kind.PLACE, "right", 1.4),
        need(Kind.TILT, "a", 0.5),
        need(Kind.TILT, "b", 0.3),
        need(Kind.DISTANCE, "near", 1.0),
    ]
    found = next_need(wanted)
    assert found is not None
    assert found.name == "b"
    assert next_need([wanted[1], wanted[4]]) is None


def test_advice_follows_what_is_shown() -> None:
    views = [view_of(str(n), x=x) for n, x in enumerate(np.linspace(-0.1, 0.1, 3))]
    guide = guide_with(views)
    shown = dict.fromkeys(("is_seen", "is_held", "is_taken"), True)
    shown |= dict.fromkeys(("is_done", "is_working"), False)
    assert guide.step(**shown).advice.startswith("tilt the board now: its ")
    assert guide.step(**shown | {"is_held": False}).advice.startswith("hold the board still")
    assert guide.step(**shown | {"is_seen": False}).advice == "show the board, all of it"
    assert guide.step(**shown | {"is_done": True}).advice == "the lens is taken"
    assert guide.step(**shown | {"is_taken": False}).advice == ""


def test_advice_names_the_need_that_it_is_for() -> None:
    tilted = [
        view_of(f"{a}{b}", tilt_deg=a, yaw_deg=b, distance=d)
        for a, b, d in ((35, 0, 0.35), (-35, 0, 1.2), (0, 35, 0.5), (0, -35, 0.5))
    ]
    step = guide_with(tilted).step(
        is_seen=True, is_held=True, is_taken=True, is_done=False, is_working=False
    )
    assert step.advice.startswith("bring the board to the ")
    assert step.name in step.advice


def test_needs_are_worked_out_anew_where_views_are_others() -> None:
    guide = guide_with([view_of("a")])
    first = guide.needs
    guide.look([view_of("a")], SIZE, None)
    assert guide.needs is first
    guide.look([view_of("a"), view_of("b", yaw_deg=35.0)], SIZE, None)
    assert sum(guide.coverage) == 24
    assert guide.needs != first
