// A camera's pictures with what was found in them, asked for while they are looked at; and, for an
// operator, a snapshot and a map begun anew.
const SVG = "http://www.w3.org/2000/svg";
const element = (id) => document.getElementById(id);
const pause = (ms) => new Promise((done) => setTimeout(done, ms));

export class Looking {
  constructor() {
    this.camera = "";
    this.isOperator = false;
    this.dialog = element("looking");
    this.dialog.addEventListener("close", () => { this.camera = ""; });
    element("close").addEventListener("click", () => this.dialog.close());
    element("snapshot").addEventListener("click", () => this.save(this.camera));
  }

  async open(camera) {
    this.camera = camera;
    element("looked-at").textContent = `Camera ${camera}`;
    element("told").textContent = "waiting for a picture …";
    element("snapshot").hidden = !this.isOperator;
    element("picture").removeAttribute("src");
    element("faces").replaceChildren();
    this.dialog.showModal();
    let stamp = "0";
    while (this.camera === camera) {
      const answer = await fetch(`/camera/${camera}/look?after=${stamp}`).catch(() => null);
      if (this.camera !== camera) return;
      if (answer?.ok) {
        const found = await answer.json();
        stamp = found.stamp;
        await this.show(camera, found);
      } else {
        element("told").textContent = answer ? await answer.text() : "the board's server does not answer; trying again";
        await pause(1000);
      }
    }
  }

  async show(camera, { stamp, faces }) {
    const image = element("picture"), next = new Image();
    next.src = `/camera/${camera}/picture/${stamp}`;
    try { await next.decode(); } catch { return; }
    if (this.camera !== camera) return;
    const corners = faces.reduce((sum, face) => sum + face.pixels.length / 2, 0);
    image.src = next.src;
    image.alt = `What camera ${camera} sees`;
    element("faces").setAttribute("viewBox", `-0.5 -0.5 ${next.naturalWidth} ${next.naturalHeight}`);
    element("faces").replaceChildren(...faces.flatMap((face) => drawn(face, next.naturalWidth)));
    const seen = faces.length ? `${faces.length} face${faces.length === 1 ? "" : "s"}, ${corners} corners` : "no target is seen";
    element("told").textContent = `${seen}; taken at ${new Date(Number(BigInt(stamp) / 1000000n)).toLocaleTimeString()}`;
  }

  async save(camera) {
    const answer = await fetch(`/command/camera/${camera}/snapshot`, { method: "POST" });
    if (!answer.ok) { element("told").textContent = await answer.text(); return; }
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = `${camera}.jpg`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }
}

function drawn({ target, face, pixels }, width) {
  const arm = width / 160, cross = document.createElementNS(SVG, "path"), text = document.createElementNS(SVG, "text");
  let d = "", low = 0;
  for (let i = 0; i < pixels.length; i += 2) {
    d += `M${pixels[i] - arm} ${pixels[i + 1]}h${2 * arm}M${pixels[i]} ${pixels[i + 1] - arm}v${2 * arm}`;
    if (pixels[i + 1] > pixels[low + 1]) low = i;
  }
  cross.setAttribute("d", d);
  text.setAttribute("x", pixels[low]);
  text.setAttribute("y", pixels[low + 1] + width / 30);
  text.setAttribute("font-size", width / 40);
  if (pixels[low] > 0.7 * width) text.setAttribute("text-anchor", "end");
  text.textContent = [target, face >= 0 ? `face ${face}` : ""].filter(Boolean).join(", ");
  return [cross, text];
}

// A map begun anew cannot be taken back: yes once, and then the site's name.
export async function askTwice(site) {
  if (!await asked(`Begin a new map of ${site}? What was learnt since the last start of fusion is thrown away.`, "")) return;
  if (!await asked(`Write the site's name, ${site}, to throw its map away.`, site)) return;
  const answer = await fetch("/command/fusion/reset", { method: "POST" });
  element("news").textContent = answer.ok ? "A new map begins." : await answer.text();
  await asked(element("news").textContent, "");
}

function asked(text, wanted) {
  const dialog = element("asking"), field = element("answer"), go = element("go");
  element("asked").textContent = text;
  field.hidden = !wanted;
  field.value = "";
  go.disabled = Boolean(wanted);
  field.onkeydown = (event) => {  // else Enter takes the form's first button, which leaves it
    if (event.key !== "Enter") return;
    event.preventDefault();
    go.click();
  };
  field.oninput = () => { go.disabled = field.value.trim() !== wanted; };
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((done) => { dialog.onclose = () => done(dialog.returnValue === "yes"); });
}
