// Reading the data of data.py, and the colours that markers get; used by viewer.js and map.js.
(function () {
  "use strict";
  const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const NONE = [190, 190, 190];

  function bytes(text) {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }

  // Places in mm (three of each) of quantised text.
  function places(box, text) {
    const count = new Uint16Array(bytes(text)), out = new Float32Array(count.length);
    for (let i = 0; i < count.length; i++) out[i] = box.low[i % 3] + box.step[i % 3] * count[i];
    return out;
  }

  function scale(share) {
    const at = Math.min(3.9999, Math.max(0, share * 4)), k = Math.floor(at), t = at - k;
    return STOPS[k].map((low, j) => Math.round(low + t * (STOPS[k + 1][j] - low)));
  }

  function hue(number) {
    const h = ((number * 67) % 180) / 30, c = 200, x = c * (1 - Math.abs(h % 2 - 1));
    const [r, g, b] = [[c, x, 0], [x, c, 0], [0, c, x], [0, x, c], [x, 0, c], [c, 0, x]][h | 0];
    return [r + 30, g + 30, b + 30].map(Math.round);
  }

  const parse = hex => [1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16));
  const css = rgb => "rgb(" + rgb.join(",") + ")";

  function values(colouring) {
    if (!colouring.numbers) colouring.numbers = new Float32Array(bytes(colouring.values));
    return colouring.numbers;
  }

  const find = (data, key) => data.colourings.find(item => item.key === key) || data.colourings[0];

  // Colour [r, g, b] of each marker in a colouring.
  function of(data, colouring) {
    const numbers = values(colouring), bent = colouring.log ? Math.log : value => value;
    const low = bent(colouring.low), range = bent(colouring.high) - low || 1;
    const paint = new Uint8Array(bytes(data.markers.paint));
    return Array.from(numbers, (value, marker) => {
      if (colouring.kind === "id") return hue(marker);
      if (colouring.kind === "paint") return parse(data.markers.paints[paint[marker]].colour);
      return Number.isFinite(value) ? scale((bent(value) - low) / range) : NONE;
    });
  }

  function show(value) {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    return size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(2)
      : String(+value.toPrecision(4));
  }

  // Numbers of one marker: [label, text] of each colouring that has numbers.
  function numbers(data, marker) {
    return data.colourings.filter(item => item.kind === "value").map(item => [
      item.label, show(values(item)[marker]) + (item.unit ? " " + item.unit : "")]);
  }

  // Write the legend into an element.
  function legend(element, data, colouring) {
    element.replaceChildren();
    const add = (tag, text, style) => {
      const child = document.createElement(tag);
      child.textContent = text;
      if (style) child.setAttribute("style", style);
      element.append(child);
    };
    if (colouring.kind === "value") {
      const stops = [0, 1, 2, 3, 4].map(k => css(scale(k / 4))).join(",");
      add("span", show(colouring.low));
      add("span", "", "flex:1;height:.8rem;max-width:18rem;background:linear-gradient(90deg," + stops + ")");
      add("span", show(colouring.high) + (colouring.unit ? " " + colouring.unit : ""));
      if (colouring.log) add("span", "(logarithmic)");
      if (Array.from(values(colouring)).some(value => !Number.isFinite(value))) {
        add("span", "", "width:.8rem;height:.8rem;background:" + css(NONE));
        add("span", "no value");
      }
    } else if (colouring.kind === "paint") {
      for (const item of data.markers.paints) {
        add("span", "", "width:.8rem;height:.8rem;background:" + item.colour);
        add("span", item.name);
      }
    } else add("span", "each marker in its own colour");
    if (colouring.note) add("span", colouring.note);
  }

  window.PhytacColours = { bytes, places, values, find, of, css, show, numbers, legend };
})();
