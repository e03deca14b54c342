"""The sim:// source in (manual) real time."""

import itertools
import threading
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import FrameError
from trigpoint.site.config import CameraConfig
from trigpoint.tools.simulation.frames import SimulatedFrames
from trigpoint.tools.simulation.world import load_world

EPOCH_NS = 1_700_000_000_000_000_000
URL = f"sim://c2?world=lab&seed=1&epoch_ns={EPOCH_NS}"
CAMERA = CameraConfig(source=URL)
SECOND = 1_000_000_000


def opened(clock: ManualClock, url: str = URL) -> SimulatedFrames:
    return SimulatedFrames(url, CAMERA, clock=clock)


def test_pictures_come_on_the_worlds_grid_of_time_once_they_are_exposed() -> None:
    clock = ManualClock(EPOCH_NS - 3 * SECOND)
    camera = load_world("lab", seed=1).cameras["c2"]
    source = opened(clock)
    for k, frame in enumerate(itertools.islice(source.frames(threading.Event()), 4)):
        assert frame.captured_ns - EPOCH_NS == round(float(camera.time_of(k)) * SECOND)
        late_s = (clock.now_ns() - frame.captured_ns) / SECOND
        assert late_s == pytest.approx(camera.exposure_s / 2, abs=1e-6)
        assert frame.picture.shape == (480, 640)
    assert source.skipped == 0
    source.close()


def test_a_rolling_shutters_picture_comes_once_its_last_row_is_exposed(tmp_path: Path) -> None:
    file = tmp_path / "rolling.toml"
    camera = "position = [0.0, -2.0, 1.5]\nyaw = 90.0\npitch = 20.0\nline_delay = 50e-6"
    robot = "waypoints = [[-1.0, 0.0], [1.0, 0.0]]"
    file.write_text(f'site = "hall"\n[cameras.c1]\n{camera}\n[robots.r1]\n{robot}\n')
    clock = ManualClock(EPOCH_NS)
    url = f"sim://c1?world={file}&epoch_ns={EPOCH_NS}"
    frame = next(opened(clock, url).frames(threading.Event()))
    late_s = (clock.now_ns() - frame.captured_ns) / SECOND
    assert late_s == pytest.approx((0.008 + 479 * 50e-6) / 2, abs=1e-6)


def test_a_source_that_is_opened_again_goes_on_where_the_world_is() -> None:
    clock = ManualClock(EPOCH_NS + 14 * SECOND)
    first = next(opened(clock).frames(threading.Event()))
    again = ManualClock(EPOCH_NS + 14 * SECOND)
    second = next(opened(again).frames(threading.Event()))
    assert 14.0 <= (first.captured_ns - EPOCH_NS) / SECOND < 14.25
    assert first.captured_ns == second.captured_ns
    assert np.array_equal(first.picture, second.picture)


def test_a_slow_taker_gets_the_newest_picture_and_the_others_are_counted() -> None:
    clock = ManualClock(EPOCH_NS)
    source = opened(clock)
    frames = source.frames(threading.Event())
    first = next(frames)
    clock.advance(1.1)
    second = next(frames)
    assert (second.captured_ns - first.captured_ns) / SECOND == pytest.approx(1.0, abs=1e-6)
    assert source.skipped == 4


def test_after_the_worlds_end_the_robot_stands_still() -> None:
    world = load_world("lab", seed=1)
    clock = ManualClock(EPOCH_NS + round((world.duration_s + 100) * SECOND))
    frames = opened(clock).frames(threading.Event())
    gap = next(frames).picture.astype(int) - next(frames).picture
    assert np.abs(gap).max() < 30  # noise alone
    assert world.sightings("c2", world.duration_s + 100)


def test_stopping_ends_the_pictures_while_it_waits() -> None:
    clock = ManualClock(EPOCH_NS - 60 * SECOND)
    stopping = threading.Event()
    stopping.set()
    assert list(opened(clock).frames(stopping)) == []


def test_the_lens_is_known() -> None:
    source = opened(ManualClock(EPOCH_NS))
    assert source.intrinsics == load_world("lab", seed=1).cameras["c2"].model


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("sim://c9?world=lab&seed=1", "no camera «c9»"),
        ("sim://c1?world=moon", "no world «moon»"),
        ("sim://c1?sed=1", "unknown key «sed»"),
        ("sim://c1?seed=one", "seed is «one»"),
        ("sim://?world=lab", "names no camera"),
        ("sim://c1?target=ball", "no target «ball»"),
    ],
)
def test_a_wrong_url_is_told_in_one_line(url: str, told: str) -> None:
    with pytest.raises(FrameError, match=told) as raised:
        opened(ManualClock(EPOCH_NS), url)
    assert "\n" not in str(raised.value)


def test_another_size_than_the_worlds_is_refused() -> None:
    with pytest.raises(FrameError, match="640 × 480, but the site file says 320 × 240"):
        SimulatedFrames(URL, CameraConfig(source=URL, width=320, height=240), clock=ManualClock())


def test_the_plug_in_is_registered() -> None:
    (entry,) = entry_points(group="trigpoint.frames", name="sim")
    assert entry.load() is SimulatedFrames
