"""What a day leaves in memory, of the page's server and in a browser.

The server's reader, history and alarms read a small site whose clock runs as fast as it is read: it
says everything once a second, and a robot is in trouble every other minute. The browser's page is
told of a large site, second after second, as fast as it draws.
"""

import gc
import shutil
import threading
from functools import partial
from urllib.parse import urlsplit

from support.builders import make_site
from support.site.board_site import BoardSite, Truth

from benchmarks.table import Row
from benchmarks.timing import in_new_process, resident_mb
from trigpoint.base.clock import ManualClock, to_ns, to_seconds
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.board.app import assets
from trigpoint.tools.board.feed import Feed
from trigpoint.tools.board.history import History
from trigpoint.tools.board.pictures import Pictures
from trigpoint.tools.board.reader import Reader
from trigpoint.tools.web.answers import media_type

_CAMERAS, _ROBOTS = 4, 2
_BEGIN_S = 1_000_000.0
_SECOND_S, _MINUTE_S, _YOUNG_S, _HOUR_S = 1.0, 60.0, 600.0, 3600.0
_CALL_S, _PATIENCE_MS = 600, 300_000
_row = partial(Row, "page")

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


class _Day(ManualClock):
    """Says what is due whenever somebody waits, until it is over; `memory_mb`: after ten minutes,
    and in the end."""

    def __init__(self, hours: float) -> None:
        super().__init__(to_ns(_BEGIN_S))
        self._end_s = _BEGIN_S + hours * _HOUR_S
        self._young_s = _BEGIN_S + _YOUNG_S
        self.site: BoardSite | None = None
        self.memory_mb: list[float] = []

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        self.advance(max(_SECOND_S, timeout_s))
        now_s = to_seconds(self.now_ns())
        if self.site is not None:
            is_troubled = now_s // _MINUTE_S % 2 > 0
            self.site.troubles = {"robot/r1": f"no port {now_s:.0f}"} if is_troubled else {}
            self.site.announce(now_s)
            self.site.move(now_s)
        if now_s >= (self._end_s if self.memory_mb else self._young_s):
            gc.collect()
            self.memory_mb.append(resident_mb("self"))
            if now_s >= self._end_s:
                event.set()
        return event.is_set()


def day(hours: float) -> list[Row]:
    """The memory of both after so many hours, against that after ten minutes."""
    kinds = {"server's memory": in_new_process(_lived, hours)}
    if chromium := shutil.which("chromium"):
        kinds["memory of a browser's page"] = _shown(chromium, hours)
    return [
        _row(f"{what} after {hours:g} hours", "MB", old_mb, young_mb, "after ten minutes")
        for what, (young_mb, old_mb) in kinds.items()
    ]


def _shown(chromium: str, hours: float) -> tuple[float, float]:
    """What of the page's process is resident after ten minutes and in the end, MB."""
    from playwright.sync_api import Route, sync_playwright

    files = assets()

    def answer(route: Route) -> None:
        name = urlsplit(route.request.url).path.strip("/") or "board.html"
        if name not in files:
            route.fulfill(status=404)
        else:
            route.fulfill(body=files[name], content_type=media_type(name))

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.set_default_timeout(_PATIENCE_MS)
        page.add_init_script(_TOLD)
        page.route("**/*", answer)
        page.goto("http://board.test/")
        collector = page.context.new_cdp_session(page)
        processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")
        drawing = [one["id"] for one in processes["processInfo"] if one["type"] == "renderer"]
        found_mb: list[float] = []
        for seconds in (_YOUNG_S, hours * _HOUR_S - _YOUNG_S):
            for left in range(round(seconds), 0, -_CALL_S):
                page.evaluate("(seconds) => window.live(seconds)", min(_CALL_S, left))
            collector.send("HeapProfiler.collectGarbage")
            found_mb.append(sum(resident_mb(process) for process in drawing))
        browser.close()
    young_mb, old_mb = found_mb
    return young_mb, old_mb


def _lived(hours: float) -> tuple[float, float]:
    site, clock = make_site(cameras=_CAMERAS, robots=_ROBOTS), _Day(hours)
    broker = MemoryBroker(clock)
    with broker.session() as speaking, broker.session() as bus:
        clock.site = BoardSite(speaking, site, Truth(_CAMERAS, _ROBOTS))
        clock.site.cover()
        pictures = Pictures(lambda: bus, site.name, frozenset(site.cameras))
        reader = Reader(site, Feed(), History(), pictures, about={}, clock=clock)
        reader.begin()
        reader.run(bus, threading.Event())
    young_mb, old_mb = clock.memory_mb
    return young_mb, old_mb
