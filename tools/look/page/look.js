// The newest moment wins: a picture is asked for only when the one before is drawn.
const SVG = "http://www.w3.org/2000/svg", FIELDS = 9, STALE_MS = 4000;
const element = (id) => document.getElementById(id);
let newest = null, isLoading = false, heardAt = 0, over = "";

function made(tag, text, kind = "") {
  const one = document.createElement(tag);
  one.textContent = text;
  if (kind) one.className = kind;
  return one;
}

function drawn(tag, attributes) {
  const one = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
  return one;
}

function put(id, text) { if (element(id).textContent !== text) element(id).textContent = text; }

function list(id, items) {
  const now = items.map((item) => item.outerHTML).join("");
  if (element(id).innerHTML !== now) element(id).replaceChildren(...items);
}

function pairs(id, rows) { list(id, rows.flatMap(([what, value]) => [made("dt", what), made("dd", value)])); }

// The ninth of the picture that a place's name means: its column and row, 0 to 2.
function ninth(name) {
  const part = (low, high) => (name.includes(low) ? 0 : name.includes(high) ? 2 : 1);
  return [part("left", "right"), part("upper", "lower")];
}

function tell(moment) {
  put("advice", moment.over || moment.advice);
  pairs("facts", [...moment.facts, ["picture", `${moment.number}, ${moment.width} × ${moment.height}`]]);
  list("hints", moment.hints.map((hint) => made("li", hint)));
  element("taking").hidden = !moment.needs.length;
  const work = moment.is_working ? "; the lens is being worked out" : moment.trouble ? `; ${moment.trouble}` : "";
  put("progress", `${moment.views} views kept${work}`);
  list("needs", moment.needs.map((need) =>
    made("li", need.share >= 1 ? need.name : `${need.name} ${Math.round(100 * need.share)} %`, need.share >= 1 ? "met" : need.name === moment.next ? "next" : "")));
  map(moment);
  const lens = moment.lens;
  put("summary", lens ? lens.summary : "");
  pairs("numbers", lens ? lens.rows : []);
  list("open", lens ? lens.open.map((text) => made("li", `not determined: ${text}`)) : []);
  put("written", moment.written ? `written: ${moment.written}` : "");
}

function place(moment) {
  const need = moment.needs.find((one) => one.name === moment.next && one.kind === "place");
  return need ? ninth(need.name) : null;
}

function map(moment) {
  const most = Math.max(1, ...moment.coverage), next = place(moment);
  const fields = moment.coverage.map((count, i) => drawn("rect",
    { x: i % FIELDS, y: Math.floor(i / FIELDS), width: 1, height: 1, "fill-opacity": count ? (0.25 + 0.75 * count / most).toFixed(2) : 0 }));
  if (next) fields.push(drawn("rect", { class: "next", x: 3 * next[0], y: 3 * next[1], width: 3, height: 3 }));
  element("map").style.aspectRatio = `${moment.width} / ${moment.height}`;
  element("map").replaceChildren(...fields);
}

// Corners as crosses; the middle of the first pixel is at (0, 0).
function overlay(moment) {
  const { width, height } = moment, arm = width / 160, next = place(moment);
  element("view").style.width = `min(100%, ${74 * width / height}vh)`;
  element("over").setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  element("corners").replaceChildren(...moment.faces.map(({ name, pixels }) => {
    let d = "";
    for (let i = 0; i < pixels.length; i += 2) d += `M${pixels[i] - arm} ${pixels[i + 1]}h${2 * arm}M${pixels[i]} ${pixels[i + 1] - arm}v${2 * arm}`;
    return drawn("path", { d, "data-name": name });
  }));
  const third = [width / 3, height / 3];
  element("region").replaceChildren(...(next ? [drawn("rect", { x: next[0] * third[0] - 0.5, y: next[1] * third[1] - 0.5, width: third[0], height: third[1] })] : []));
}

function draw() {
  if (isLoading || !newest) return;
  const moment = newest, image = new Image();
  newest = null;
  isLoading = true;
  image.onload = () => {
    element("picture").src = image.src;
    overlay(moment);
    isLoading = false;
    draw();
  };
  image.onerror = () => { isLoading = false; draw(); };
  image.src = `/picture/${moment.stamp}`;
}

function listen() {
  const source = new EventSource("/events");
  source.onmessage = ({ data }) => {
    const moment = JSON.parse(data);
    heardAt = Date.now();
    over = moment.over;
    newest = moment;
    tell(moment);
    draw();
    if (over) source.close();
    state();
  };
  source.onerror = state;
}

function state() {
  const isCut = Boolean(over) || Date.now() - heardAt > STALE_MS;
  document.body.classList.toggle("cut", isCut);
  put("link", over ? "ended" : isCut ? (heardAt ? `no picture for ${Math.round((Date.now() - heardAt) / 1000)} s` : "connecting …") : "live");
}

listen();
setInterval(state, 1000);
