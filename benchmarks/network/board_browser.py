"""The page in Chromium, where there is one: how long after its message a robot has moved on the
screen; and what a day leaves in the page's memory, of a large site that it is told of second after
second, as fast as it draws.
"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from benchmarks.timing import resident_mb
from trigpoint.tools.board.app import assets
from trigpoint.tools.web.answers import media_type

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

_YOUNG_S, _HOUR_S = 600.0, 3600.0
_SETTLED_MS, _CALL_S, _PATIENCE_MS = 2000, 600, 300_000

# A frame after the one that shows a new place, that one has been painted.
_WATCH = """(seconds) => new Promise((done) => {
  const found = [], end = performance.now() + 1000 * seconds;
  let last = "", seen = null;
  const look = () => {
    if (seen !== null) found.push([seen, Date.now()]);
    const mark = document.querySelector('#robots [data-id="robot/r1"]');
    const at = mark ? mark.dataset.x : last;
    seen = at !== last ? Number(at) : null;
    last = at;
    if (performance.now() < end) requestAnimationFrame(look);
    else done(found);
  };
  requestAnimationFrame(look);
})"""

# In place of the server: 100 cameras, 30 robots on circles, a node each; alarms come each
# minute, and the last forty are shown.
_TOLD = """
let told = null, t = 1e6;
window.EventSource = class { constructor() { told = this; } };
const many = (count, one) => Object.fromEntries(Array.from({ length: count }, (_, i) => one(i)));
const known = () => ({ sigma: 0.02, turn: 0.01, ellipse: [0.05, 0.02 + (t % 7) / 1000, 0.1] });
const robot = (i) => [`robot/r${i}`, { index: i, stale: false, fixed: t, ...known(),
  at: [10 * Math.cos(t / 40 + i), 10 * Math.sin(t / 40 + i), (t / 40 + i) % 3],
  goal: [i, t % 9, 0] }];
const camera = (i) => [`camera/c${i}`, { state: "located", seen: t, at: [i % 10, i / 10, 3],
  look: [0.1, -0.5], ...known(), floor: [0, 0, 4, 0, 4, 4] }];
const node = (i) => [`node/edge/c${i}`, { state: "ok", age: 0, notes: [`pictures ${10 + t % 3}`] }];
const say = (message) => told.onmessage({ data: JSON.stringify({ t, ...message }) });
window.live = async (seconds) => {
  if (t === 1e6) say({ all: { site: { name: "lab" }, ...many(100, camera), ...many(130, node) } });
  for (let i = 0; i < seconds; i++) {
    t++;
    const set = { ...many(30, robot), ...many(100, camera), ...many(130, node) };
    const minute = Math.floor(t / 60), gone = [];
    if (t % 60 === 0) {
      set[`alarm/${minute}`] = { node: "robot/r1", text: `no port ${t}`, state: "error", since: t };
      set[`alarm/${minute - 1}`] = { until: t };
      gone.push(`alarm/${minute - 40}`);
    }
    say({ set, gone });
    if (i % 60 === 0) await new Promise(requestAnimationFrame);
  }
};
"""


def is_there() -> bool:
    """Whether there is Chromium."""
    return shutil.which("chromium") is not None


def pixels_shown(address: str, seconds: float) -> list[tuple[float, float]]:
    """Where robot r1 was seen along x, and when its picture had been painted, ms of the epoch."""
    with _page() as (_, page):
        page.goto(address)
        page.wait_for_selector('#robots [data-id="robot/r1"]')
        page.wait_for_timeout(_SETTLED_MS)
        return page.evaluate(_WATCH, seconds)


def memory_mb(hours: float) -> tuple[float, float]:
    """What of the page's process is resident after ten minutes of a fast clock and in the end."""
    with _page() as (browser, page):
        page.set_default_timeout(_PATIENCE_MS)
        page.add_init_script(_TOLD)
        files = assets()

        def answer(route: "Route") -> None:
            name = urlsplit(route.request.url).path.strip("/") or "board.html"
            if name in files:
                route.fulfill(body=files[name], content_type=media_type(name))
            else:
                route.fulfill(status=404)

        page.route("**/*", answer)
        page.goto("http://board.test/")
        collector = page.context.new_cdp_session(page)
        processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")
        drawing = [one["id"] for one in processes["processInfo"] if one["type"] == "renderer"]

        def after(seconds: float) -> float:
            for left in range(round(seconds), 0, -_CALL_S):
                page.evaluate("(seconds) => window.live(seconds)", min(_CALL_S, left))
            collector.send("HeapProfiler.collectGarbage")
            return sum(map(resident_mb, drawing))

        return after(_YOUNG_S), after(hours * _HOUR_S - _YOUNG_S)


@contextmanager
def _page() -> "Iterator[tuple[Browser, Page]]":
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        yield browser, browser.new_page(viewport={"width": 1440, "height": 900})
        browser.close()
