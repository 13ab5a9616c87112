// Shell and map together: one colouring, one chosen marker, its numbers, and all of them as a table.
(function () {
  "use strict";
  const C = window.PhytacColours;
  let made = 0;

  function node(tag, set, ...children) {
    const out = document.createElement(tag);
    for (const key in set) out.setAttribute(key, set[key]);
    out.append(...children);
    return out;
  }

  // root holds .shell and .map (each may hold a picture that shows until it is live).
  function create(root, first) {
    let data = first;
    const id = "explorer" + made++, self = { marker: -1, onColour: null };
    const by = node("select", { id: id + "by" }), pick = node("input", { id: id + "pick",
      type: "number", min: 0, step: 1, inputmode: "numeric" });
    const legend = node("div", { class: "legend" });
    const readout = node("p", { class: "readout", "aria-live": "polite" });
    // A label and its control stay on one line.
    const field = (text, control) => node("span", { class: "field" },
      node("label", { for: control.id }, text + " "), control);
    const controls = node("div", { class: "controls" }, field("Colour by", by), field("Marker", pick));
    const shell = window.PhytacViewer.create(root.querySelector(".shell"), data);
    const map = window.PhytacMap.create(root.querySelector(".map"), data);
    const views = [shell, map].filter(Boolean);
    const button = (text, act) => {
      const out = node("button", { type: "button" }, text);
      out.addEventListener("click", act);
      controls.append(out);
      return out;
    };
    if (shell) {
      button("Turn back", shell.reset);
      const wall = node("select", { id: id + "wall" }, ...[["cut", "cut open"],
        ["clear", "seen through"], ["none", "left out"]].map(([value, text]) =>
        node("option", { value }, text)));
      wall.value = data.wall;
      wall.addEventListener("change", () => shell.wall(wall.value));
      controls.append(field("Wall", wall));
      button("Save picture", () => {
        const link = node("a", { href: shell.picture(), download: "shell.png" });
        link.click();
      });
    }
    const all = node("details", {}, node("summary", {}, "All markers as a table"),
      node("div", { class: "all", tabindex: 0, role: "region", "aria-label": "Numbers of all markers" }));
    root.prepend(controls, legend);
    root.append(readout, all);

    function tabulate() {
      const items = data.colourings.filter(item => item.kind === "value");
      const cells = (tag, texts, scope) => texts.map((text, k) =>
        node(k === 0 ? "th" : tag, k === 0 || scope ? { scope: scope || "row" } : {}, text));
      const head = node("tr", {}, ...cells("th", ["number", "marker", ...items.map(item =>
        item.label + (item.unit ? ` (${item.unit})` : ""))], "col"));
      const rows = data.markers.names.map((name, i) => node("tr", {}, ...cells("td",
        [String(i), name, ...items.map(item => C.show(C.values(item)[i]))])));
      // The box around it scrolls, by keys too.
      all.lastChild.replaceChildren(
        node("table", { style: "display:table" }, node("thead", {}, head), node("tbody", {}, ...rows)));
    }
    all.addEventListener("toggle", () => { if (all.open) tabulate(); });

    self.colourBy = key => {
      const colouring = C.find(data, key);
      by.value = colouring.key;
      for (const view of views) view.colourBy(colouring.key);
      C.legend(legend, data, colouring);
      root.dataset.colouring = colouring.key;
    };
    self.select = marker => {
      self.marker = marker;
      for (const view of views) view.select(marker);
      if (marker < 0) {
        readout.textContent = "Point at a marker, or choose one, for its numbers.";
        return;
      }
      pick.value = marker;
      readout.replaceChildren(node("strong", {}, `Marker ${marker}`),
        ` (${data.markers.names[marker]}): `,
        C.numbers(data, marker).map(([label, text]) => `${label} ${text}`).join("; "));
    };
    self.update = next => {
      data = next;
      const key = by.value;
      by.replaceChildren(...data.colourings.map(item => node("option", { value: item.key }, item.label)));
      pick.max = data.markers.names.length - 1;
      pick.placeholder = `0–${pick.max}`;
      if (next !== first) for (const view of views) view.update(data);
      self.colourBy(key || data.colourings[0].key);
      self.select(self.marker < data.markers.names.length ? self.marker : -1);
      if (all.open) tabulate();
    };
    self.dispose = () => {
      for (const view of views) view.dispose();
      for (const part of [controls, legend, readout, all]) part.remove();
    };
    self.shell = shell;
    self.map = map;
    by.addEventListener("change", () => {
      self.colourBy(by.value);
      if (self.onColour) self.onColour(by.value);
    });
    pick.addEventListener("input", () => {
      const marker = Number(pick.value);
      if (Number.isInteger(marker) && marker >= 0 && marker <= Number(pick.max)) self.select(marker);
    });
    for (const view of views) view.onSelect = self.select;
    self.update(data);
    return self;
  }

  window.PhytacExplorer = { create };
})();
