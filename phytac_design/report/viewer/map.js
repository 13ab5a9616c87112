// The flat map of the markers: PhytacMap.create(element, data) -> map.
(function () {
  "use strict";
  const C = window.PhytacColours, SVG = "http://www.w3.org/2000/svg";
  const FONT_PX = 12, TICKS = 5;
  const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  function make(tag, parent, set) {
    const node = document.createElementNS(SVG, tag);
    for (const key in set) node.setAttribute(key, set[key]);
    parent.append(node);
    return node;
  }

  // Round numbers across a range.
  function ticks(low, high) {
    const rough = (high - low) / TICKS, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find(k => k * power >= rough), out = [];
    for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) {
      out.push(+(k * step).toPrecision(6));
    }
    return out;
  }

  function create(element, first) {
    const svg = document.createElementNS(SVG, "svg"), self = { onSelect: null };
    let data = null, colouring = null, marker = -1, dots = [], places = null, x0, y0, flip;
    svg.setAttribute("tabindex", "0");
    svg.setAttribute("role", "application");
    element.append(svg);
    element.classList.add("live");

    const X = x => x - x0, Y = y => flip * (y - y0);
    const place = i => [X(places[2 * i]), Y(places[2 * i + 1])];

    function draw() {
      const { map } = data, [[ax, ay], [bx, by]] = map.limits;
      const wide = bx - ax, high = by - ay;
      places = new Float32Array(C.bytes(map.points));
      flip = map.y_down ? 1 : -1;
      x0 = ax;
      y0 = map.y_down ? ay : by;
      svg.replaceChildren();
      const unit = wide / Math.max(element.clientWidth - 60, 200);  // mm of a CSS pixel, about
      const text = FONT_PX * unit, left = 4 * text, below = 3.2 * text;
      svg.setAttribute("viewBox", [-left, -text, wide + left + text, high + below + text].join(" "));
      svg.setAttribute("font-size", text);
      svg.setAttribute("aria-label", "Map of the markers, " + map.note + ". Arrow keys go from "
        + "marker to marker; the numbers of the marker are read out below.");
      for (const edge of map.outline) {
        const at = new Float32Array(C.bytes(edge)), points = [];
        for (let i = 0; i < at.length; i += 2) points.push(X(at[i]) + "," + Y(at[i + 1]));
        make("polyline", svg, { points: points.join(" "), fill: "none", stroke: "#999",
          "stroke-width": unit });
      }
      make("rect", svg, { x: 0, y: 0, width: wide, height: high, fill: "none", stroke: "#444",
        "stroke-width": unit });
      const say = (content, set) => { make("text", svg, { fill: "#333", ...set }).textContent = content; };
      for (const value of ticks(ax, bx)) {
        say(value, { x: X(value), y: high + 1.2 * text, "text-anchor": "middle" });
      }
      for (const value of ticks(ay, by)) {
        say(value, { x: -0.4 * text, y: Y(value) + 0.35 * text, "text-anchor": "end" });
      }
      say(map.x_label, { x: wide / 2, y: high + 2.6 * text, "text-anchor": "middle" });
      say(map.y_label, { transform: `translate(${-3 * text} ${high / 2}) rotate(-90)`,
        "text-anchor": "middle" });
      const paint = new Uint8Array(C.bytes(data.markers.paint)), n = paint.length;
      const radius = Math.min(0.28 * Math.sqrt(wide * high / Math.max(n, 1)), 0.05 * wide);
      dots = Array.from(paint, (colour, i) => {
        const [cx, cy] = place(i);
        return make("circle", svg, { cx, cy, r: radius, "stroke-width": 0.3 * radius,
          stroke: data.markers.paints[colour].colour });
      });
      self.ring = make("circle", svg, { r: 1.8 * radius, fill: "none", stroke: "#ff6a00",
        "stroke-width": 0.5 * radius, visibility: "hidden" });
    }

    self.update = next => {
      data = next;
      draw();
      self.colourBy(colouring ? colouring.key : data.colourings[0].key);
      self.select(marker < dots.length ? marker : -1);
    };
    self.colourBy = key => {
      colouring = C.find(data, key);
      C.of(data, colouring).forEach((rgb, i) => dots[i].setAttribute("fill", C.css(rgb)));
    };
    self.select = chosen => {
      marker = chosen;
      self.ring.setAttribute("visibility", marker >= 0 ? "visible" : "hidden");
      if (marker < 0) return;
      const [cx, cy] = place(marker);
      self.ring.setAttribute("cx", cx);
      self.ring.setAttribute("cy", cy);
    };

    function choose(found) {
      if (found < 0 || found === marker) return;
      self.select(found);
      if (self.onSelect) self.onSelect(found);
    }
    // Marker with the minimum cost(dx, dy) from a point of the drawing; -1 if all are infinite.
    function best(from, cost) {
      let found = -1, least = Infinity;
      for (let i = 0; i < dots.length; i++) {
        const [x, y] = place(i), value = cost(x - from[0], y - from[1]);
        if (value < least) [found, least] = [i, value];
      }
      return found;
    }
    svg.addEventListener("pointermove", event => {
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      const near = 3 * Number(self.ring.getAttribute("r"));
      choose(best([at.x, at.y], (dx, dy) => (Math.hypot(dx, dy) < near ? Math.hypot(dx, dy) : Infinity)));
    });
    svg.addEventListener("keydown", event => {
      const way = WAYS[event.key];
      if (!way || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      if (marker < 0) { choose(0); return; }
      choose(best(place(marker), (dx, dy) => {
        const ahead = dx * way[0] + dy * way[1], aside = Math.abs(dx * way[1]) + Math.abs(dy * way[0]);
        return ahead > 1e-6 && ahead >= 0.4 * aside ? ahead + 2 * aside : Infinity;
      }));
    });
    const watch = new ResizeObserver(() => self.update(data));
    self.dispose = () => { watch.disconnect(); svg.remove(); element.classList.remove("live"); };
    self.update(first);
    watch.observe(element);
    return self;
  }

  window.PhytacMap = { create };
})();
