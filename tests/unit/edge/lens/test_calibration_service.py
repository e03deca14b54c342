"""What an agent keeps for a calibration, and how it answers."""

import json

import numpy as np
import pytest
from msgspec.structs import replace
from support.pictures.boards import target_of
from support.pictures.lens_views import BOARD, PINHOLE, SIZE, board_views

from trigpoint.base.errors import InputError, OperationError
from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.lens.calibration_service import CalibrationService
from trigpoint.edge.lens.calibration_views import View, views_of
from trigpoint.geometry.rotation import Array
from trigpoint.site.camera_info import parse_camera_info
from trigpoint.site.target import NOWHERE, Face, Pattern, Target

FACE = Face(0, Pattern.CHECKERBOARD, 9, 7, 0.03, *NOWHERE)
TARGET = target_of(FACE)


def sighting(view: View, *, sigma: float = 0.1, face: int = 0) -> FaceSighting:
    ids = np.arange(len(BOARD), dtype=np.uint16)
    return FaceSighting(TARGET.name, face, ids, view.pixels.astype(np.float32), sigma)


def service_with(views: list[View]) -> CalibrationService:
    service = CalibrationService("c1", [TARGET])
    for view in views:
        service.offer([sighting(view)], SIZE)
    return service


def test_lens_is_worked_out_from_what_was_seen() -> None:
    reply = json.loads(service_with(board_views(14, 1)).answer(b""))
    lens = parse_camera_info(reply["camera_info"])
    assert lens.fx == pytest.approx(PINHOLE.fx, abs=5 * reply["intrinsics"]["sigma"]["fx"])
    assert reply["kept"] == 14
    assert "camera_name: c1" in reply["camera_info"]


def test_view_like_one_before_is_kept_only_where_it_is_sharper() -> None:
    view = board_views(1, 2)[0]
    service = CalibrationService("c1", [TARGET])
    for sigma in (0.2, 0.2, 0.05):
        service.offer([sighting(view, sigma=sigma)], SIZE)
    assert service.kept == 1
    (kept,) = service._views
    assert kept.sigma == pytest.approx(0.05)


def test_store_is_bounded_and_still_spread() -> None:
    service = service_with(board_views(400, 3, near=0.25))
    assert 50 <= service.kept <= 150
    marks = np.array(service._marks).reshape(-1, 4, 2)
    assert np.ptp(marks[..., 0]) > 0.9


def test_too_few_views_are_told() -> None:
    with pytest.raises(OperationError, match="2 views of the target were found"):
        service_with(board_views(2, 4)).answer(b"")


def test_lens_that_the_views_leave_open_is_given_only_where_that_is_asked_for() -> None:
    service = service_with(board_views(12, 4, tilt_deg=0.0))
    with pytest.raises(OperationError, match="focal length: the board was never tilted"):
        service.answer(b"")
    reply = json.loads(service.answer(b'{"force": true}'))
    assert reply["undetermined"][0]["what"] == "focal length"


LINE_DELAY_S, PERIOD_NS = 30e-6, 100_000_000


def rolled(views: list[View], seed: int) -> list[tuple[FaceSighting, FaceSighting]]:
    """Each view as it was a picture before and as a rolling shutter has it: all corners move by up
    to 0.6 px a millisecond, and every row is exposed at its own time."""
    random = np.random.default_rng(seed)
    pairs = []
    for view in views:
        pixels_a_second = random.uniform(-600, 600, 2)
        pairs.append(
            tuple(
                sighting(replace(view, pixels=_exposed(view.pixels + way, pixels_a_second)))
                for way in (-pixels_a_second * PERIOD_NS * 1e-9, 0.0)
            )
        )
    return pairs


def _exposed(pixels: Array, pixels_a_second: Array) -> Array:
    """Where moving corners are as their own row is exposed."""
    seen = pixels
    for _ in range(5):
        late_s = LINE_DELAY_S * (seen[:, 1] - (SIZE[1] - 1) / 2)
        seen = pixels + late_s[:, None] * pixels_a_second
    return seen


def test_motion_during_a_rolling_shutters_readout_does_not_bend_the_lens() -> None:
    residuals = []
    for line_delay_s in (LINE_DELAY_S, 1e-12):
        service = CalibrationService("c1", [TARGET], line_delay_s=line_delay_s)
        for i, (before, now) in enumerate(rolled(board_views(16, 6), 1)):
            service.offer([before], SIZE, 1 + 10 * i * PERIOD_NS)
            service.offer([now], SIZE, 1 + (10 * i + 1) * PERIOD_NS)
        assert service.kept >= 14
        reply = json.loads(service.answer(b'{"force": true}'))
        residuals.append(reply["noise_px"])
    assert residuals[0] < 0.11  # the noise is 0.1
    assert residuals[1] > 1.5 * residuals[0]


def test_it_can_begin_anew() -> None:
    service = service_with(board_views(5, 5))
    assert json.loads(service.answer(b'{"forget": true}')) == {"kept": 0}
    assert service.kept == 0


def test_pictures_of_another_size_begin_anew() -> None:
    service = service_with(board_views(5, 5))
    service.offer([], (1280, 720))
    assert service.kept == 0


@pytest.mark.parametrize("request_bytes", [b"[]", b"{", b'{"remember": true}', b"\xff"])
def test_request_that_is_none_is_refused(request_bytes: bytes) -> None:
    with pytest.raises(InputError, match="camera c1: calibrate takes nothing"):
        service_with([]).answer(request_bytes)


def test_views_are_of_faces_with_corners_enough_that_are_not_on_a_line() -> None:
    whole = sighting(board_views(1, 6)[0])
    few = FaceSighting(TARGET.name, 0, whole.corners[[0, 1, 8, 9]], whole.pixels[[0, 1, 8, 9]], 0.1)
    row = FaceSighting(TARGET.name, 0, whole.corners[:8], whole.pixels[:8], 0.1)
    (view,) = views_of("p", [few, whole, row], [TARGET])
    assert len(view) == 48
    np.testing.assert_allclose(view.points, BOARD, atol=1e-12)


def test_face_that_looks_like_others_is_a_view_but_one_of_unknown_shape_is_none() -> None:
    other = Face(1, Pattern.CHECKERBOARD, 9, 7, 0.03, *NOWHERE)
    larger = Face(2, Pattern.CHECKERBOARD, 10, 8, 0.03, *NOWHERE)
    seen = sighting(board_views(1, 6)[0], face=-1)
    assert len(views_of("p", [seen], [Target(TARGET.name, (FACE, other))])) == 1
    assert len(views_of("p", [seen], [Target(TARGET.name, (FACE, other, larger))])) == 1
    part = FaceSighting(TARGET.name, -1, seen.corners[:40], seen.pixels[:40], 0.1)
    assert views_of("p", [part], [Target(TARGET.name, (FACE, larger))]) == []
    assert views_of("p", [seen], [Target("another", (FACE,))]) == []
