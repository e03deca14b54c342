// The same facts as the map's, as tables and in words.

export function spoken(seconds) {
  const s = Math.max(0, Math.round(seconds));
  if (s < 90) return `${s} s`;
  if (s < 5400) return `${Math.round(s / 60)} min`;
  const min = Math.round(s / 60);
  return s < 172800 ? `${Math.floor(min / 60)} h ${min % 60} min` : `${Math.round(s / 86400)} days`;
}

const AWAY = ["silent", "gone", "missing"];
// Whether nothing is heard of a camera: from fusion about its place, or from its agent.
export const isUnheard = (camera, agent) => Boolean(camera.stale) || AWAY.includes(agent?.state);
export const robotColour = (index) => `var(--r${index % 8})`;
const centimetres = (m) => m < 1e-3 ? "<0.1 cm" : m < 1 ? `±${(100 * m).toFixed(1)} cm` : `±${m.toFixed(1)} m`;
export const degrees = (rad) => `${(Math.round(180 * rad / Math.PI) + 360) % 360}°`;
const fine = (rad) => `±${(180 * rad / Math.PI).toFixed(1)}°`;
const tilt = (rad) => `${Math.abs(Math.round(180 * rad / Math.PI))}° ${rad < 0 ? "down" : "up"}`;
const metres = (values) => values.map((v) => v.toFixed(2)).join(", ");
const named = (text) => text.slice(text.indexOf("/") + 1);
const byName = new Intl.Collator("en", { numeric: true }).compare;

export class Tables {
  constructor(look) {
    this.look = look;
    this.cut = "";  // why nothing is known of now
    this.begin();
  }

  begin() {
    for (const id of ["robot-table", "camera-table", "node-table"]) body(id).replaceChildren();
    this.state = {};
    this.rows = new Map();
    this.dirty = new Set();
  }

  show(name, fields) {
    if (fields) this.state[name] = fields;
    else delete this.state[name];
    this.dirty.add(name);
  }

  // Ages go on while nothing comes, so every row is looked at once a second, a table at a time so
  // that robots do not wait; only cells that differ are touched.
  update(table, now) {
    for (const name of this.dirty) if (!this.state[name]) this.drop(name);
    this.dirty.clear();
    if (table === 3) {
      this.alarms(now);
      this.counts();
      return;
    }
    const kind = ["robot", "camera", "node"][table];
    for (const [name, fields] of this.kinds(kind)) this[kind](name, fields, now);
  }

  robot(name, robot, now) {
    const row = this.row("robot-table", name, robot.stale);
    const head = row.cells[0];
    if (!head.firstChild) {
      const disc = document.createElement("i");
      disc.style.background = robotColour(robot.index);
      head.append(disc, named(name));
    }
    if (!robot.at) return this.cells(row, [null, "not placed yet", "", "", "", ""]);
    const fixed = this.ago(robot.fixed, now);
    const place = metres(robot.at.slice(0, 2)) + (robot.stale ? " (stale)" : "");
    this.cells(row, [null, place, fixed, `${centimetres(robot.sigma)} ${fine(robot.turn)}`, degrees(robot.at[2]), robot.goal ? `${metres(robot.goal.slice(0, 2))} (${degrees(robot.goal[2])})` : "–"]);
  }

  camera(name, camera, now) {
    const node = this.state[`node/edge/${named(name)}`] || {};
    const row = this.row("camera-table", name, isUnheard(camera, node));
    if (!row.cells[0].firstChild) {
      const button = document.createElement("button");
      button.textContent = named(name);
      button.title = "Look through this camera";
      button.addEventListener("click", () => this.look(named(name)));
      row.cells[0].append(button);
    }
    const runs = node.source && node.source !== "running" ? node.source : node.age == null ? "–" : node.age < 1 ? "live" : `${spoken(node.age)} old`;
    const isLive = runs === "live";
    const place = camera.at ? metres(camera.at) : "–";
    const looks = camera.look ? `${degrees(camera.look[0])}, ${tilt(camera.look[1])}` : "–";
    const state = camera.state + (camera.stale && camera.state === "located" ? " (stale)" : "");
    this.cells(row, [null, state, camera.sigma ? centimetres(camera.sigma) : "–", runs, this.ago(camera.seen, now), place, looks]);
    row.cells[1].className = camera.state === "located" ? "good" : "open";
    row.cells[3].className = isLive ? "" : "bad";
    row.classList.toggle("fine", camera.state === "located" && !isUnheard(camera, node) && isLive);
  }

  // What the server did not hear since its start may have been before.
  ago(at, now) {
    return at ? `${spoken(now - at)} ago` : `not for ${spoken(now - (this.state.site?.started || now))}`;
  }

  node(name, node) {
    const row = this.row("node-table", name, node.state === "gone");
    this.cells(row, [named(name), node.state, (node.notes || []).join(". ") || "–"]);
    row.cells[1].className = node.state === "ok" ? "good" : node.state === "warning" ? "open" : "bad";
  }

  row(table, name, isStale) {
    let row = this.rows.get(name);
    if (!row) {
      row = document.createElement("tr");
      row.dataset.id = name;
      for (const _ of document.querySelectorAll(`#${table} th`)) row.append(document.createElement("td"));
      const rows = body(table), next = [...rows.children].find((one) => byName(one.dataset.id, name) > 0);
      rows.insertBefore(row, next || null);
      this.rows.set(name, row);
    }
    row.classList.toggle("stale", Boolean(isStale));
    return row;
  }

  cells(row, texts) {
    texts.forEach((text, i) => {
      if (text !== null && row.cells[i].textContent !== text) row.cells[i].textContent = text;
    });
  }

  drop(name) {
    this.rows.get(name)?.remove();
    this.rows.delete(name);
  }

  alarms(now) {
    const list = document.getElementById("alarms");
    const all = Object.entries(this.state).filter(([name]) => name.startsWith("alarm/"));
    const rank = (alarm) => alarm.until ? 2 : alarm.state === "warning" ? 1 : 0;
    all.sort(([, a], [, b]) => rank(a) - rank(b) || b.since - a.since);
    const items = all.map(([name, alarm]) => {
      const at = new Date(1000 * alarm.since).toLocaleTimeString();
      const when = alarm.until ? `over; from ${at}, for ${spoken(alarm.until - alarm.since)}` : `since ${at}, for ${spoken(now - alarm.since)}`;
      return { name, kind: alarm.until ? "over" : alarm.state, text: `${alarm.node}: ${alarm.text}`, when };
    });
    if (!items.some((one) => one.kind !== "over")) items.unshift({ name: "none", kind: this.cut ? "error" : "none", text: this.cut || "All is well.", when: "" });
    items.forEach((one, i) => {
      const item = list.children[i] || list.appendChild(document.createElement("li"));
      if (!item.firstChild) item.append(document.createElement("span"), document.createElement("small"));
      item.className = one.kind;
      item.dataset.id = one.name;
      if (item.firstChild.textContent !== one.text) item.firstChild.textContent = one.text;
      if (item.lastChild.textContent !== one.when) item.lastChild.textContent = one.when;
    });
    while (list.children.length > items.length) list.lastChild.remove();
  }

  kinds(kind) {
    return Object.entries(this.state).filter(([name]) => name.startsWith(`${kind}/`));
  }

  headline() {
    const alarms = this.kinds("alarm").filter(([, alarm]) => !alarm.until).length;
    return this.cut || (alarms ? `${alarms} alarm${alarms === 1 ? "" : "s"}` : "all is well");
  }

  absent() {
    const open = this.kinds("camera").filter(([, camera]) => !camera.at).map(([name, camera]) => `${named(name)} (${camera.state})`).sort(byName);
    return open.length ? `Not on the map: ${open.length > 12 ? `${open.length} cameras` : open.join(", ")}` : "";
  }

  counts() {
    const cameras = this.kinds("camera"), robots = this.kinds("robot"), nodes = this.kinds("node");
    const located = cameras.filter(([, camera]) => camera.state === "located").length;
    const placed = robots.filter(([, robot]) => robot.at && !robot.stale).length;
    const lost = nodes.reduce((sum, [, node]) => sum + (node.lost || 0), 0);
    const alarms = this.kinds("alarm").filter(([, alarm]) => !alarm.until).length;
    const texts = [["cameras located", `${located} / ${cameras.length}`], ["robots placed", `${placed} / ${robots.length}`], [alarms === 1 ? "alarm" : "alarms", alarms], [lost === 1 ? "message or picture lost" : "messages or pictures lost", lost]];
    const list = document.getElementById("counts");
    texts.forEach(([word, value], i) => {
      const item = list.children[i] || list.appendChild(document.createElement("li"));
      if (!item.firstChild) item.append(document.createElement("b"), document.createTextNode(""));
      item.firstChild.textContent = value;
      item.lastChild.textContent = ` ${word}`;
      item.className = i === 2 && alarms ? "bad" : "";
    });
  }
}

const body = (id) => document.querySelector(`#${id} tbody`);
