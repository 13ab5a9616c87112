// Results for the design: verdict, camera views, figures, shell and map.
import { by, node, prose, show } from "./api.js";

const C = window.PhytacColours, NEAR = 0.012;

export class Views {
  constructor() {
    this.explorer = null;
    this.draft = null;
    this.checked = null;
    this.cameras = [];
    by("colour-camera").addEventListener("change", () => this.paint());
    // On a phone the picture stays in view only beside the controls.
    new IntersectionObserver(([entry]) =>
      by("camera-part").classList.toggle("still", !entry.isIntersecting)).observe(by("controls"));
  }

  // A draft: everything but the verdict of the check.
  async draw(draft) {
    const pictures = await Promise.all(draft.cameras.map(load));
    this.draft = draft;
    this.checked = null;
    if (pictures.length !== this.cameras.length) this.frames(draft);
    pictures.forEach((picture, k) => Object.assign(this.cameras[k], draft.cameras[k], picture));
    this.cameras.forEach(camera => {
      camera.caption.textContent = caption(camera);
      camera.pressed = null;
    });
    this.paint();
    this.figures(draft);
    this.explore(draft.view);
    this.old(false);
    if (this.onDraft) this.onDraft(draft);
  }

  // The views under a press, from the server; null for those at rest.
  async press(cameras) {
    const pictures = cameras ? await Promise.all(cameras.map(load)) : [];
    this.cameras.forEach((camera, k) => {
      camera.pressed = cameras && cameras[k] ? { ...cameras[k], ...pictures[k] } : null;
    });
    this.paint();
  }

  explore(data) {
    const root = by("explorer");
    if (this.explorer) {
      this.explorer.update(data);
      return;
    }
    const made = window.PhytacExplorer.create(root, data), chosen = made.select;
    this.explorer = made;
    made.select = marker => {
      chosen(marker);
      this.paint();
    };
    for (const view of [made.shell, made.map]) if (view) view.onSelect = made.select;
    new MutationObserver(() => this.paint()).observe(root,
      { attributes: true, attributeFilter: ["data-colouring"] });
  }

  frames(draft) {
    this.cameras = draft.cameras.map((camera, k) => {
      const canvas = node("canvas", { role: "img", "data-camera": k });
      const text = node("figcaption", {});
      const own = { canvas, caption: text };
      canvas.addEventListener("pointermove", event => this.point(own, event));
      canvas.addEventListener("click", event => this.point(own, event));
      return own;
    });
    by("cameras").replaceChildren(
      ...this.cameras.map(camera => node("figure", {}, camera.canvas, camera.caption)));
  }

  // The marker under the pointer; `ids` holds numbers from 1, 0 for none. In the unpainted hole of
  // a receptor the nearest end counts.
  point({ canvas, ...rest }, event) {
    const box = canvas.getBoundingClientRect(), camera = rest.pressed || rest;
    const x = Math.floor((event.clientX - box.left) / box.width * camera.width);
    const y = Math.floor((event.clientY - box.top) / box.height * camera.height);
    let marker = (camera.ids[y * camera.width + x] || 0) - 1;
    if (marker < 0) {
      let best = NEAR * camera.width;
      camera.tip_px.forEach(([px, py], k) => {
        const away = px === null ? Infinity : Math.hypot(px - x, py - y);
        if (away < best) [best, marker] = [away, k];
      });
    }
    if (marker >= 0 && this.explorer && marker !== this.explorer.marker) this.explorer.select(marker);
  }

  paint() {
    if (!this.draft) return;
    const recolour = by("colour-camera").checked && this.explorer;
    const data = this.draft.view;
    let colours = null;
    if (recolour) colours = C.of(data, C.find(data, by("explorer").dataset.colouring));
    for (const own of this.cameras) {
      const { canvas } = own, camera = own.pressed || own, { width, height } = camera;
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      const pen = canvas.getContext("2d", { willReadFrequently: true });
      pen.drawImage(camera.image, 0, 0, width, height);
      if (colours) this.recolour(pen, camera, colours);
      this.rings(pen, camera);
      canvas.setAttribute("aria-label", caption(own) + (own.pressed ? ", pressed" : ""));
      canvas.dataset.drawn = String(1 + Number(canvas.dataset.drawn || 0));
    }
  }

  recolour(pen, camera, colours) {
    const image = pen.getImageData(0, 0, camera.width, camera.height), { data } = image;
    for (let i = 0; i < camera.ids.length; i++) {
      const marker = camera.ids[i] - 1;
      if (marker < 0 || !colours[marker]) continue;
      for (let k = 0; k < 3; k++) data[4 * i + k] = colours[marker][k];
    }
    pen.putImageData(image, 0, 0);
  }

  // Red around what the check found, orange around the chosen marker.
  rings(pen, camera) {
    const ring = (marker, colour, radius) => {
      const at = camera.tip_px[marker];
      if (!at || at[0] === null) return;
      pen.strokeStyle = colour;
      pen.lineWidth = Math.max(1, camera.width / 500);
      pen.beginPath();
      pen.arc(at[0], at[1], radius * camera.width, 0, 7);
      pen.stroke();
    };
    const found = this.checked;
    if (found) for (const marker of [...found.occluded, ...found.fused]) ring(marker, "#ff3b30", 0.008);
    const chosen = this.explorer ? this.explorer.marker : -1;
    if (chosen >= 0) ring(chosen, "#ff8a00", 0.02);
  }

  figures(draft) {
    const rows = draft.measures.map(item => [item.doc, item.value, item.unit]);
    rows.push(["surface to the optical axis", draft.surface_class, ""]);
    const key = rows.map(row => row[0]).join();
    if (key !== this.figureKey) {
      this.figureKey = key;
      this.figureCells = rows.map(() => node("td", {}));
      by("figures").replaceChildren(node("table", { class: "facts" },
        node("thead", {}, node("tr", {}, node("th", { scope: "col" }, "figure"),
          node("th", { scope: "col" }, "value"))),
        node("tbody", {}, ...rows.map((row, k) =>
          node("tr", {}, node("th", { scope: "row" }, row[0]), this.figureCells[k])))));
    }
    rows.forEach((row, k) => {
      this.figureCells[k].textContent = show(row[1]) + (row[2] ? " " + row[2] : "");
    });
  }

  // kind: wait, good, odd or bad; lines: [mark, text].
  verdict(kind, head, lines, foot, repair) {
    const root = by("verdict"), key = JSON.stringify([kind, head, lines, foot]);
    if (key === this.verdictKey) return;
    this.verdictKey = key;
    root.className = "verdict" + (kind === "good" ? "" : " " + kind);
    root.replaceChildren(node("p", {}, head));
    if (lines.length) {
      root.append(node("ul", {}, ...lines.map(([mark, text]) => node("li", { class: mark }, ...prose(text)))));
    }
    if (foot) root.append(node("p", { class: "foot" }, ...prose(foot)));
    if (!repair) return;
    const button = node("button", { type: "button", id: "repair" }, "Find a repair");
    button.addEventListener("click", () => this.repair(button));
    root.append(node("p", {}, button));
  }

  drafted(draft) {
    const hidden = draft.measures.find(item => item.name === "sampled_hidden").value;
    const lines = draft.warnings.map(text => ["odd", text]);
    if (draft.refused) {
      lines.unshift(["bad", draft.refused]);
      this.verdict("bad", "This design cannot be built as it is.", lines,
        "The views show it all the same.", true);
      return;
    }
    const sum = hidden ? `${hidden} markers are hidden in a sample of rays.`
      : "No marker is hidden in a sample of rays.";
    // As high as the verdict, so that nothing moves under the pointer when that comes.
    this.verdict("wait", sum + " Checking…", lines, "`phytac check` follows.");
  }

  check(found) {
    this.checked = found;
    const lines = found.warnings.map(text => ["odd", text]);
    const blind = found.visibility.switch_unreadable;
    if (blind) lines.unshift(["odd", `about ${blind} switches cannot be read`]);
    for (const fault of found.faults) lines.unshift(["bad", fault.text]);
    if (found.clear) {
      this.verdict(lines.length ? "odd" : "good", "Every marker is visible and separate.", lines,
        "As `phytac check` finds.");
    } else if (found.visible) {
      this.verdict("bad", "Its switches cannot be used as they are.", lines,
        "As `phytac check` finds.");
    } else {
      lines.unshift(["bad", found.advice]);
      const { occluded, fused } = found.visibility;
      this.verdict("bad", `${occluded} markers are hidden, ${fused} fused.`, lines,
        "As `phytac check` finds; red rings in the camera view.", true);
    }
    this.paint();
  }

  refused(text) {
    this.verdict("bad", "This design cannot be built as it is.", [["bad", text]],
      this.draft ? "The views show the last design that could be drawn." : "", true);
    this.old(true);
  }

  old(is) {
    for (const id of ["cameras", "figures", "explorer"]) by(id).classList.toggle("old", is);
  }
}

const caption = camera => `What the ${camera.end} camera sees, ${show(camera.stand_off_mm)} mm before its `
  + `rim; ${camera.of_width} × ${camera.of_height} px, drawn with ${camera.width} × ${camera.height}`;

async function bitmap(text, type) {
  const blob = new Blob([C.bytes(text)], { type });
  return createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}

async function load(camera) {
  const [image, coded] = await Promise.all([
    bitmap(camera.jpeg, "image/jpeg"), bitmap(camera.ids, "image/png")]);
  const sheet = new OffscreenCanvas(camera.width, camera.height);
  const pen = sheet.getContext("2d", { willReadFrequently: true });
  pen.drawImage(coded, 0, 0);
  const { data } = pen.getImageData(0, 0, camera.width, camera.height);
  const numbers = new Uint32Array(camera.width * camera.height);
  for (let i = 0; i < numbers.length; i++) numbers[i] = data[4 * i] + 256 * data[4 * i + 1];
  return { image, ids: numbers };
}
