// The page: a connection that comes back by itself, the state that it brings, and who draws it.
import { SiteMap } from "./map.js";
import { Tables, spoken } from "./tables.js";
import { askTwice, Looking } from "./looking.js";

const SILENT_S = 3;
const element = (id) => document.getElementById(id);
const query = new URLSearchParams(location.search);
document.body.classList.toggle("kiosk", query.has("kiosk"));

let live = {}, ways = {};
let shown = {}, past = null;  // the state that is drawn: the live one, or one of the past
let told = { t: 0, at: -1e9 };  // the server's time, and when it was told
let source, dirty = new Set(), announced = new Set(), loadedVersion = "";

const looking = new Looking();
const map = new SiteMap(element("map"), (camera) => looking.open(camera));
const tables = new Tables((camera) => looking.open(camera));

const now = () => past ? past.t : told.t + (performance.now() - told.at) / 1000;
const silentFor = () => (performance.now() - told.at) / 1000;

function connect() {
  source = new EventSource("/events");
  source.onmessage = (event) => take(JSON.parse(event.data));
  source.onerror = () => {
    if (source.readyState === EventSource.CLOSED) setTimeout(comeBack, 2000);
  };
}

// The server refused: it is full, or wants a login, to which loading the page anew leads.
async function comeBack() {
  try {
    const answer = await fetch("/", { method: "HEAD", redirect: "manual" });
    if (answer.type === "opaqueredirect") location.reload();
  } catch { /* the server is away; so says the page */ }
  connect();
}

function take(message) {
  told = { t: message.t, at: performance.now() };
  if (message.all) {
    live = message.all;
    ways = message.ways || {};
    announced = new Set(Object.keys(live));
    if (!past) showAll(live, ways);
  } else {
    for (const [name, fields] of Object.entries(message.set || {})) {
      live[name] = { ...live[name], ...fields };
      if (name.startsWith("alarm/") && !announced.has(name)) announce(name, live[name]);
      if (!past) dirty.add(name);
    }
    for (const name of message.gone || []) {
      delete live[name];
      announced.delete(name);
      if (!past) dirty.add(name);
    }
  }
  const version = live.site?.page;
  loadedVersion ||= version;
  if (version !== loadedVersion) location.reload();
  if (message.all) {
    draw();
    showTables();
  } else schedule();
}

function announce(name, alarm) {
  announced.add(name);
  element("news").textContent = `${alarm.node}: ${alarm.text}`;
}

function showAll(state, itsWays) {
  shown = state;
  map.begin(itsWays);
  tables.begin();
  dirty = new Set(Object.keys(state));
  schedule();
}

let isDue = false;
function schedule() {
  if (!isDue) requestAnimationFrame(draw);
  isDue = true;
}

function draw() {
  isDue = false;
  for (const name of dirty) {
    map.show(name, shown[name]);
    tables.show(name, shown[name]);
  }
  dirty.clear();
}

function everySecond() {
  const site = shown.site || {}, silent = silentFor();
  const link = silent > SILENT_S
    ? (told.t ? `no news from the board's server for ${spoken(silent)}; trying again` : "connecting …")
    : live.site?.link || "";
  document.body.classList.toggle("cut", link !== "");
  tables.cut = past ? "" : link;
  document.body.classList.toggle("past", past !== null);
  element("link").textContent = link || (past ? `as it was at ${clockOf(past.t)}` : "live");
  element("site").textContent = site.name || "Trigpoint";
  document.title = `${site.name || "Trigpoint"}: ${tables.headline()}`;
  element("for-grid").hidden = !shown.grid;
  element("operator").hidden = !site.operator;
  looking.isOperator = Boolean(site.operator);
  element("absent").textContent = [tables.absent(), shown.plan?.trouble].filter(Boolean).join("; ");
  const begin = live.site?.begin;
  if (begin) element("when").min = -Math.min(3600, Math.max(60, Math.round(told.t - begin)));
}

function showTables() {
  for (let table = 0; table < 4; table++) tables.update(table, now());
  everySecond();
}

let quarter = 0;
function everyQuarter() {
  tables.update(quarter, now());
  if (quarter === 3) everySecond();
  quarter = (quarter + 1) % 4;
}

// -- the last hour

const clockOf = (t) => new Date(1000 * t).toLocaleTimeString();
let asked = 0;
async function goTo(seconds) {
  const mine = ++asked;
  element("now").hidden = seconds === 0;
  if (seconds === 0) {
    past = null;
    element("then").textContent = "now";
    showAll(live, map.ways());
    draw();
    return showTables();
  }
  const at = told.t + (performance.now() - told.at) / 1000 + seconds;
  element("then").textContent = `${clockOf(at)}, ${spoken(-seconds)} ago`;
  const answer = await fetch(`/past?at=${at.toFixed(1)}`).catch(() => null);
  if (mine !== asked || !answer?.ok) return;
  past = await answer.json();
  showAll(past.all, past.ways || {});
  draw();
  showTables();
}
element("when").addEventListener("input", (event) => goTo(Number(event.target.value)));
element("now").addEventListener("click", () => {
  element("when").value = 0;
  element("when").focus();  // the button goes
  goTo(0);
});

// -- what one may switch

for (const layer of ["floors", "ways", "grid"]) {
  element(`with-${layer}`).addEventListener("change", (event) => {
    document.body.classList.toggle(`hide-${layer}`, !event.target.checked);
  });
}
element("reset").addEventListener("click", () => askTwice(shown.site.name));
element("closer").addEventListener("click", () => map.zoom(1.4));
element("further").addEventListener("click", () => map.zoom(1 / 1.4));
element("fit").addEventListener("click", () => map.fit());

connect();
setInterval(everyQuarter, 250);
