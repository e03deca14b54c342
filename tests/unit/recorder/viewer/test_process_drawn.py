"""What a browser draws of a session: the page is looked at in headless Chromium, by its pixels."""

import io
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.viewer import style
from trigpoint.recorder.viewer.process import Viewer
from trigpoint.recorder.viewer.review import write_rrd

CHROMIUM = shutil.which("chromium")
FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",  # drawn by the processor: there is no graphics card in a test
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--js-flags=--no-wasm-tier-up",  # to compile 40 MB of program once is enough
)
ERROR_MARK = (236, 0, 79)
"""Of the disc that rerun shows on a panel that cannot draw something."""
NEAR = 40
PATIENCE_S = 240.0  # it takes ten seconds, but a busy machine ten times as long

pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no Chromium here; install Debian's package «chromium»"
    ),
    pytest.mark.timeout(2 * PATIENCE_S),
    pytest.mark.long,
]


@pytest.fixture
def page() -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=list(FLAGS), timeout=1000 * PATIENCE_S
        )
        yield browser.new_page(viewport={"width": 900, "height": 600})
        browser.close()


def picture_of(page: Page) -> np.ndarray:
    """(600, 900, 3) of what is drawn now."""
    data = page.screenshot(timeout=1000 * PATIENCE_S)
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=int)


def count(picture: np.ndarray, colour: tuple[int, int, int]) -> int:
    """How many pixels are nearly of a colour."""
    return int(np.sum(np.abs(picture - colour).max(axis=-1) < NEAR))


def whole(picture: np.ndarray) -> bool:
    """Whether the map, left above the plots, has its paths and its one located camera, and the
    pictures their frames."""
    scene, pictures = picture[60:400, :520], picture[60:410, 540:]
    drawn = (style.DEAD_RECKONING, style.robot_colour(0), style.camera_colour(0))
    if not all(count(pictures, style.camera_colour(i)) > 30 for i in range(4)):
        return False
    return all(count(scene, colour) > 30 for colour in drawn)


def test_a_reviewed_session_is_drawn_without_an_error(
    page: Page, session_file: Path, tmp_path: Path
) -> None:
    write_rrd(open_recording(session_file), tmp_path / "session.rrd")
    with Viewer(tmp_path / "session.rrd", is_web=True) as viewer:
        page.goto(f"{viewer.web_url}&renderer=webgl", timeout=1000 * PATIENCE_S)
        until = time.monotonic() + PATIENCE_S
        while not whole(picture := picture_of(page)) and time.monotonic() < until:
            time.sleep(1.0)  # to draw costs the page more than to wait
        # What is left of a long first frame: panels say a moment later what they cannot draw.
        picture = picture_of(page)
    Image.fromarray(picture.astype(np.uint8)).save(tmp_path / "drawn.png")
    assert whole(picture), f"the map lacks paths or cameras; look at {tmp_path / 'drawn.png'}"
    assert count(picture, ERROR_MARK) < 20, f"a panel has an error: {tmp_path / 'drawn.png'}"
