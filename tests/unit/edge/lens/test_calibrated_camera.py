"""Which lens an agent announces, and pictures that do not fit it."""

import numpy as np
import pytest
from support.pictures.boards import CAMERA
from support.site.edge_desk import EMPTY, Desk, ScriptedFrames, desk, taken

from trigpoint.base.errors import ConfigError, InputError
from trigpoint.contract.messages import CameraInfo, Sightings
from trigpoint.contract.topics import CAMERA_INFO, SIGHTINGS
from trigpoint.site.camera_info import write_camera_info

__all__ = ["desk"]  # the fixture


def test_lens_of_the_intrinsics_file_is_announced_once(desk: Desk) -> None:
    write_camera_info(desk.folder / "c1.yaml", CAMERA, "c1")
    ScriptedFrames.own_lens = CAMERA.with_parameters(CAMERA.parameters * 1.1)
    ears = desk.listen(CAMERA_INFO)
    desk.start((1000, EMPTY), (2000, EMPTY), camera='intrinsics = "c1.yaml"').wait()
    (info,) = taken(ears)
    assert isinstance(info, CameraInfo)
    assert info.camera == CAMERA


def test_lens_that_the_source_knows_comes_before_the_nominal_one(desk: Desk) -> None:
    ScriptedFrames.own_lens = CAMERA
    ears = desk.listen(CAMERA_INFO)
    desk.start((1000, EMPTY), camera='intrinsics = "estimate"').wait()
    (info,) = taken(ears)
    assert isinstance(info, CameraInfo)
    assert info.camera == CAMERA


@pytest.mark.parametrize("camera", ["", 'intrinsics = "estimate"'])
def test_lens_that_nobody_knows_is_not_announced(
    desk: Desk, caplog: pytest.LogCaptureFixture, camera: str
) -> None:
    ears = desk.listen(CAMERA_INFO)
    desk.start((1000, EMPTY), camera=camera).wait()
    assert taken(ears) == []
    assert ("camera c1 has no intrinsics" in caplog.text) == (not camera)


def test_late_listener_gets_the_lens(desk: Desk) -> None:
    ScriptedFrames.own_lens = CAMERA
    desk.start((1000, EMPTY)).wait()
    assert len(taken(desk.listen(CAMERA_INFO))) == 1


def test_lens_for_another_size_ends_the_node_with_one_line(desk: Desk) -> None:
    node = desk.start((1000, np.zeros((720, 1280), np.uint8)))
    with pytest.raises(
        ConfigError, match=r"pictures are 1280 × 720, but the site file says 640 × 480; write width"
    ):
        node.wait()


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (np.zeros((480, 640), np.complex64), "values are complex64"),
        (np.zeros((480, 640, 5), np.uint8), "has 5 channels"),
        (np.zeros((0, 0), np.uint8), "is no picture"),
        (np.zeros((1, 1), np.uint8), "pictures are 1 × 1"),
    ],
)
def test_pictures_of_a_bad_kind_end_the_node_with_one_line(
    desk: Desk, picture: np.ndarray, said: str
) -> None:
    node = desk.start((1000, picture))
    with pytest.raises(InputError, match=said) as caught:
        node.wait()
    assert "\n" not in str(caught.value)


def test_camera_of_one_pixel_sees_nothing(desk: Desk) -> None:
    ears = desk.listen(SIGHTINGS)
    tiny = (1000, np.zeros((1, 1), np.uint8))
    desk.start(tiny, camera="width = 1\nheight = 1").wait()
    (message,) = taken(ears)
    assert isinstance(message, Sightings)
    assert (message.width, message.height, message.faces) == (1, 1, ())


def test_missing_intrinsics_file_is_told_before_anything_starts(desk: Desk) -> None:
    with pytest.raises(InputError, match=r"none\.yaml"):
        desk.start((1000, EMPTY), camera='intrinsics = "none.yaml"')
