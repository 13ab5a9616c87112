// Studies of the folder: candidates and front; any of them can be loaded into the controls.
import { by, get, node, post, show } from "./api.js";

const ROWS = 200;

export class Studies {
  constructor(model) {
    this.model = model;
    by("studies-button").addEventListener("click", () => this.look());
    by("study").addEventListener("change", () => this.show());
  }

  async look() {
    try {
      this.list = (await get("api/studies")).studies;
    } catch (error) {
      by("study-view").textContent = error.message;
      return;
    }
    by("study-pick").hidden = !this.list.length;
    by("study").replaceChildren(...this.list.map((item, k) =>
      node("option", { value: k }, `${item.name} (${item.folder}, ${item.kind} of ${item.design})`)));
    if (this.list.length) this.show();
    else by("study-view").textContent = "There are none in this folder yet.";
  }

  async show() {
    const item = this.list[by("study").value], page = by("study-page");
    page.hidden = !item.page;
    page.href = `files/${item.folder.split("/").map(encodeURIComponent).join("/")}/report.html`;
    try {
      this.draw(item, await post("api/study", { folder: item.folder }));
    } catch (error) {
      by("study-view").replaceChildren(node("p", { class: "err", role: "alert" }, error.message));
    }
  }

  draw(item, study) {
    const names = [...new Set([...study.variables, ...Object.keys(study.goals)])];
    const onFront = study.rows.filter(row => row.front).length;
    const canvas = node("canvas", { role: "img",
      "aria-label": `Objectives of ${study.candidates} candidates, ${onFront} on the front` });
    const head = node("tr", {}, ...["trial", "status", ...names].map(name =>
      node("th", { scope: "col", title: study.docs[name] || "" },
        name + (study.units[name] ? ` (${study.units[name]})` : ""))), node("td", {}));
    const rows = study.rows.slice(0, ROWS).map(row => {
      const button = node("button", { type: "button", "aria-label": `Open trial ${row.trial}` }, "open");
      button.addEventListener("click", () => this.open(item, row.trial));
      return node("tr", row.front ? {} : { class: "weak" },
        node("th", { scope: "row" }, String(row.trial)),
        node("td", { class: "text", title: row.reason }, row.front ? "front" : row.status),
        ...row.values.map(value => node("td", {}, show(value))), node("td", {}, button));
    });
    by("study-view").replaceChildren(
      node("p", {}, `${study.candidates} candidates, ${onFront} on the front`
        + (study.rows.length > ROWS ? `; the first ${ROWS} are listed, the front first.` : ".")),
      canvas, node("p", { class: "foot" }, this.axes(study, names)),
      node("p", { class: "err", id: "trial-error", role: "alert" }),
      node("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Candidates" },
        node("table", {}, node("thead", {}, head), node("tbody", {}, ...rows))));
    if (this.watch) this.watch.disconnect();
    this.watch = new ResizeObserver(() => this.scatter(canvas, study, names));
    this.watch.observe(canvas);
  }

  axes(study, names) {
    const [x, y] = this.pair(study, names);
    return `Across: ${names[x]}; up: ${names[y]}. Orange: the front; grey: not able.`;
  }

  pair(study, names) {
    const goals = Object.keys(study.goals).map(name => names.indexOf(name));
    return [goals[0] ?? 0, goals[1] ?? (goals[0] === 0 ? names.length - 1 : 0)];
  }

  scatter(canvas, study, names) {
    const [x, y] = this.pair(study, names), ratio = window.devicePixelRatio || 1;
    const wide = canvas.clientWidth, high = canvas.clientHeight, pad = 56;
    Object.assign(canvas, { width: wide * ratio, height: high * ratio });
    const pen = canvas.getContext("2d"), number = (row, k) =>
      typeof row.values[k] === "number" ? row.values[k] : null;
    const points = study.rows.filter(row => number(row, x) !== null && number(row, y) !== null);
    const ends = k => {
      const all = points.map(row => row.values[k]), low = Math.min(...all), high_ = Math.max(...all);
      return high_ > low ? [low, high_] : [low - 0.5, low + 0.5];
    };
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    pen.strokeStyle = "#999";
    pen.strokeRect(pad, 8, wide - pad - 8, high - 40);
    if (!points.length) return;
    const rx = ends(x), ry = ends(y);
    pen.fillStyle = "#444";
    pen.fillText(show(rx[0]), pad, high - 16);
    pen.textAlign = "right";
    pen.fillText(show(rx[1]), wide - 8, high - 16);
    pen.fillText(show(ry[0]), pad - 4, high - 34);
    pen.fillText(show(ry[1]), pad - 4, 18);
    for (const row of [...points].reverse()) {
      const px = pad + (row.values[x] - rx[0]) / (rx[1] - rx[0]) * (wide - pad - 8);
      const py = high - 32 - (row.values[y] - ry[0]) / (ry[1] - ry[0]) * (high - 40);
      pen.fillStyle = row.front ? "#e07b00" : row.status === "ok" ? "#1b6ca8" : "#c8c8c8";
      pen.beginPath();
      pen.arc(px, py, row.front ? 4 : 2.5, 0, 7);
      pen.fill();
    }
  }

  async open(item, trial) {
    try {
      this.model.open(await post("api/trial", { folder: item.folder, trial }), true);
      by("controls").focus();
    } catch (error) {
      by("trial-error").textContent = error.message;
    }
  }
}
