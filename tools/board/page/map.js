// The map, in metres: x to the right, y up, which SVG counts downwards. Marks keep their size. What
// moves is a drawing of its own above the rest, which then need not be painted again.
import { isUnheard, robotColour } from "./tables.js";

const TIMES = 10;  // ellipses are drawn so much larger
const WAY_POINTS = 600, WAY_S = 60, WAY_MS = 500, NEAR_M = 0.05;
const CROWD = 30;  // with more cameras, names are shown where one has come closer
const SVG = "http://www.w3.org/2000/svg";
const nameOf = (entity) => entity.slice(entity.indexOf("/") + 1);
const layerOf = (name) => document.getElementById(name);
const degrees = (rad) => -180 * rad / Math.PI;

function made(parent, tag, attributes = {}) {
  const one = document.createElementNS(SVG, tag);
  set(one, attributes);
  parent.append(one);
  return one;
}

function set(one, attributes) {
  for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
}

export class SiteMap {
  constructor(svg, look) {
    this.svg = svg;
    this.look = look;
    this.isOwn = false;  // whether a person has chosen the part that is shown
    this.box = { x: -5, y: -5, w: 10, h: 10 };
    document.getElementById("times").textContent = TIMES;
    this.unit = 0;  // marks have no size before the page is laid out
    this.begin({});
    new ResizeObserver(() => (this.isOwn ? this.place() : this.fit())).observe(svg);
    this.listen();
  }

  begin(ways) {
    for (const layer of document.querySelectorAll(".drawn > g")) layer.replaceChildren();
    this.parts = new Map();
    this.fields = {};
    this.tracks = new Map();
    this.drawn = new Map();
    this.looks = new Map();
    for (const [name, way] of Object.entries(ways)) this.tracks.set(name, way.map((v, i) => i % 2 ? null : { x: v, y: way[i + 1], t: performance.now() }).filter(Boolean));
    this.low = [Infinity, Infinity];
    this.high = [-Infinity, -Infinity];
  }

  ways() {
    const found = {};
    for (const [name, way] of this.tracks) found[name] = way.flatMap((p) => [p.x, p.y]);
    return found;
  }

  show(name, fields) {
    if (!fields) return this.drop(name);
    this.fields[name] = fields;
    if (name === "plan" || name === "grid") this.lay(name, fields);
    else if (name.startsWith("camera/")) this.camera(name, fields);
    else if (name.startsWith("robot/")) this.robot(name, fields);
    else if (name.startsWith("node/edge/")) {
      const camera = `camera/${name.slice("node/edge/".length)}`;
      if (this.fields[camera]) this.camera(camera, this.fields[camera]);
    }
  }

  drop(name) {
    if (name === "grid") this.lay(name, {});
    for (const part of Object.values(this.parts.get(name) || {})) part.remove();
    this.parts.delete(name);
    this.looks.delete(name);
    delete this.fields[name];
  }

  // -- what is drawn

  // A picture of the floor: the plan, or how well robots are corrected where.
  lay(name, { matrix, size, version }) {
    const layer = layerOf(name);
    if (!matrix) return layer.replaceChildren();
    const image = layer.firstChild || made(layer, "image", { preserveAspectRatio: "none" });
    const [a, b, c, d, e, f] = matrix, href = `/${name}.png${version ? `?${version}` : ""}`;
    if (image.getAttribute("href") !== href) image.setAttribute("href", href);
    set(image, { width: size[0], height: size[1], transform: `matrix(${a} ${-b} ${c} ${-d} ${e} ${-f})` });
    for (const [u, v] of [[0, 0], [size[0], 0], [0, size[1]], size]) this.reach(a * u + c * v + e, b * u + d * v + f);
  }

  camera(name, camera) {
    if (!camera.at) return;
    const stale = isUnheard(camera, this.fields[`node/edge/${nameOf(name)}`]);
    const look = [camera.at, camera.look, camera.state, stale, camera.ellipse, camera.floor, this.unit].join();
    if (this.looks.get(name) === look) return;  // when it saw a target is not on the map
    this.looks.set(name, look);
    const parts = this.part(name, () => this.newCamera(name));
    const [x, y] = camera.at;
    set(parts.mark, { class: `${camera.state}${stale ? " stale" : ""}`, "data-x": x, "data-y": y });
    parts.mark.querySelector(".turned").setAttribute("transform", `rotate(${degrees(camera.look[0])})`);
    this.mark(parts.mark, x, y);
    this.ellipse(parts.ellipse, { ...camera, stale }, x, y);
    set(parts.floor, { class: stale ? "stale" : "" });
    if (camera.floor && parts.floor.dataset.drawn !== String(camera.floor)) {
      parts.floor.dataset.drawn = String(camera.floor);
      parts.floor.setAttribute("d", path(camera.floor) + "Z");
      for (let i = 0; i < camera.floor.length; i += 2) this.reach(camera.floor[i], camera.floor[i + 1]);
    }
    this.reach(x, y);
  }

  newCamera(name) {
    const mark = made(layerOf("cameras"), "g", { "data-id": name });
    made(made(mark, "g", { class: "turned" }), "path", { d: "M-9-6H3V-2L10-6V6L3 2V6H-9Z", "stroke-width": 1 });
    made(mark.firstChild, "path", { d: "M12 0 30-11V11Z", class: "view", stroke: "none" });
    made(mark, "text", { y: 24, stroke: "none" }).textContent = nameOf(name);
    made(mark, "title").textContent = `camera ${nameOf(name)}: click to look through it`;
    mark.addEventListener("click", () => this.look(nameOf(name)));
    return { mark, ellipse: made(layerOf("camera-ellipses"), "ellipse"), floor: made(layerOf("floors"), "path", { "data-id": name }) };
  }

  robot(name, robot) {
    if (!robot.at) return;
    const [x, y, heading] = robot.at;
    const parts = this.part(name, () => this.newRobot(name));
    set(parts.mark, { class: robot.stale ? "stale" : "", "data-x": x, "data-y": y, "data-heading": heading });
    parts.mark.firstChild.setAttribute("transform", `rotate(${degrees(heading)})`);
    this.mark(parts.mark, x, y);
    this.ellipse(parts.ellipse, robot, x, y);
    this.goal(parts.goal, robot.goal, x, y);
    this.walk(name, parts.way, x, y);
    this.reach(x, y);
  }

  newRobot(name) {
    const colour = robotColour(this.fields[name].index);
    const mark = made(layerOf("robots"), "g", { "data-id": name });
    const turned = made(mark, "g");
    made(turned, "path", { d: "M-8-6H4L12 0 4 6H-8Z" });
    made(mark, "text", { y: -11 }).textContent = nameOf(name);
    made(mark, "title").textContent = `robot ${nameOf(name)}`;
    const goal = made(layerOf("goals"), "g");
    made(goal, "line");
    made(goal, "circle", { r: 7 });
    const parts = { mark, goal, ellipse: made(layerOf("robot-ellipses"), "ellipse"), way: made(layerOf("ways"), "path", { "data-id": name }) };
    turned.style.fill = parts.ellipse.style.fill = colour;
    parts.ellipse.style.stroke = parts.way.style.stroke = goal.style.stroke = colour;
    return parts;
  }

  ellipse(one, { ellipse, stale }, x, y) {
    if (!ellipse) return;
    const [long, short, direction] = ellipse;
    set(one, { rx: TIMES * long, ry: TIMES * short, transform: `translate(${x} ${-y}) rotate(${degrees(direction)})`, class: stale ? "stale" : "" });
  }

  goal(one, goal, x, y) {
    one.setAttribute("visibility", goal ? "visible" : "hidden");
    if (!goal) return;
    const u = this.unit;
    set(one.firstChild, { x1: x, y1: -y, x2: goal[0], y2: -goal[1] });
    set(one.lastChild, { transform: `translate(${goal[0]} ${-goal[1]}) scale(${u})` });
    this.reach(goal[0], goal[1]);
  }

  walk(name, line, x, y) {
    let way = this.tracks.get(name);
    if (!way) this.tracks.set(name, way = []);
    const last = way[way.length - 1];
    const t = performance.now();
    if (!last || Math.abs(last.x - x) + Math.abs(last.y - y) >= NEAR_M) way.push({ x, y, t });
    else if (line.hasAttribute("d")) return;
    if (t - (this.drawn.get(name) || 0) < WAY_MS) return;  // it covers much of the map
    this.drawn.set(name, t);
    while (way.length > WAY_POINTS || t - way[0].t > 1000 * WAY_S) way.shift();
    line.setAttribute("d", path(way.flatMap((p) => [p.x, p.y])));
  }

  part(name, make) {
    if (!this.parts.has(name)) this.parts.set(name, make());
    return this.parts.get(name);
  }

  // -- which part of it is seen

  mark(one, x, y) {
    one.setAttribute("transform", `translate(${x} ${-y}) scale(${this.unit})`);
  }

  reach(x, y) {
    const isNew = x < this.low[0] || y < this.low[1] || x > this.high[0] || y > this.high[1];
    this.low = [Math.min(this.low[0], x), Math.min(this.low[1], y)];
    this.high = [Math.max(this.high[0], x), Math.max(this.high[1], y)];
    if (isNew && !this.isOwn && !this.isFitting) {
      this.isFitting = true;
      requestAnimationFrame(() => this.fit());
    }
  }

  fit() {
    this.isFitting = this.isOwn = false;
    if (!Number.isFinite(this.low[0])) return this.place();
    const w = Math.max(2, this.high[0] - this.low[0]), h = Math.max(2, this.high[1] - this.low[1]);
    const x = (this.low[0] + this.high[0] - w) / 2, y = -(this.low[1] + this.high[1] + h) / 2;
    const { clientWidth, clientHeight } = this.svg;  // marks and names need their place at the edge
    const edge = 42 * Math.max(w / Math.max(100, clientWidth - 84), h / Math.max(100, clientHeight - 84));
    this.box = { x: x - edge, y: y - edge, w: w + 2 * edge, h: h + 2 * edge };
    this.place();
  }

  zoom(factor, at = { x: this.box.x + this.box.w / 2, y: this.box.y + this.box.h / 2 }) {
    const { x, y, w, h } = this.box;
    this.isOwn = true;
    this.box = { x: at.x - (at.x - x) / factor, y: at.y - (at.y - y) / factor, w: w / factor, h: h / factor };
    this.place();
  }

  move(right, down) {
    this.isOwn = true;
    this.box.x += right;
    this.box.y += down;
    this.place();
  }

  // Metres a pixel; marks and texts are redrawn where that has changed.
  place() {
    const { x, y, w, h } = this.box, { clientWidth, clientHeight } = this.svg;
    this.svg.classList.toggle("own", this.isOwn);  // else a finger moves the page
    if (!clientWidth || !clientHeight) return;
    for (const one of document.querySelectorAll(".drawn")) one.setAttribute("viewBox", `${x} ${y} ${w} ${h}`);
    const unit = Math.max(w / clientWidth, h / clientHeight);
    const cameras = Object.keys(this.fields).filter((name) => name.startsWith("camera/")).length;
    this.svg.classList.toggle("crowded", cameras > CROWD && unit > 0.02);
    if (unit === this.unit) return;
    this.unit = unit;
    for (const [name, fields] of Object.entries(this.fields)) this.show(name, fields);
    this.scale();
  }

  scale() {
    const most = 120 * this.unit, step = 10 ** Math.floor(Math.log10(most));
    const metres = [5, 2, 1].map((n) => n * step).find((m) => m <= most);
    const [bar, text] = document.getElementById("scale").children;
    bar.style.width = `${metres / this.unit}px`;
    text.textContent = metres < 1 ? `${100 * metres} cm` : `${metres} m`;
  }

  listen() {
    const svg = this.svg;
    const pointed = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-0.0015 * event.deltaY), pointed(event));
    }, { passive: false });
    let from = null;
    svg.addEventListener("pointerdown", (event) => { if (event.isPrimary && (event.pointerType === "mouse" || this.isOwn)) from = pointed(event); });
    svg.addEventListener("pointermove", (event) => {
      if (!from || !event.isPrimary) return;
      const to = pointed(event);
      this.move(from.x - to.x, from.y - to.y);
    });
    for (const end of ["pointerup", "pointercancel"]) addEventListener(end, () => { from = null; });
    svg.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (steps) this.move(0.1 * this.box.w * steps[0], 0.1 * this.box.h * steps[1]);
      else if (event.key === "+" || event.key === "=") this.zoom(1.4);
      else if (event.key === "-") this.zoom(1 / 1.4);
      else if (event.key === "0") this.fit();
      else return;
      event.preventDefault();
    });
  }
}

function path(values) {
  let d = "";
  for (let i = 0; i < values.length; i += 2) d += `${i ? "L" : "M"}${values[i].toFixed(2)} ${(-values[i + 1]).toFixed(2)}`;
  return d;
}
