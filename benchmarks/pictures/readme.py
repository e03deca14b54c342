"""`python -m benchmarks.pictures.readme DEMO`: README's pictures, of the page and in the viewer."""

import shutil
import sys
import time
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from trigpoint.recorder.viewer.process import Viewer

FOLDER = Path("docs/pictures")
_FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",  # drawn by the processor: there may be no graphics card
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
_PATIENCE_MS = 240_000
# The viewer says nowhere that it has drawn: a picture is not empty, and stays as it is for so long.
_SETTLED_S, _DRAWN_BYTES = 20.0, 100_000


def _of_the_page(browser: Browser, report: Path) -> None:
    """The map on a demo's page."""
    page = browser.new_page(viewport={"width": 1000, "height": 900})
    page.goto(report.resolve().as_uri())
    page.locator("section figure").first.screenshot(path=FOLDER / "report.png")


def _of_the_viewer(browser: Browser, recording: Path) -> None:
    """The whole session in rerun's page, at its end."""
    page = browser.new_page(viewport={"width": 1120, "height": 665})
    with Viewer(recording, is_web=True) as viewer:
        page.goto(f"{viewer.web_url}&renderer=webgl", timeout=_PATIENCE_MS)
        picture, since = b"", time.monotonic()
        until = since + _PATIENCE_MS / 1000
        while len(picture) < _DRAWN_BYTES or time.monotonic() < since + _SETTLED_S:
            if time.monotonic() > until:
                sys.exit("the viewer does not come to rest; look at it by `trigpoint review --web`")
            time.sleep(1.0)
            last, picture = picture, page.screenshot(timeout=_PATIENCE_MS)
            since = since if picture == last else time.monotonic()
    (FOLDER / "viewer.png").write_bytes(picture)


def main(demo: Path) -> None:
    """Draw both pictures of a demo's folder."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no Chromium here; install Debian's package «chromium»")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(_FLAGS))
        _of_the_page(browser, demo / "report.html")
        _of_the_viewer(browser, demo / "session.rrd")
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
