// The report page: fills its explorers from their data, and makes its slider of presses work.
(function () {
  "use strict";

  function slider(press) {
    const forces = press.dataset.forces.split(" "), on = press.dataset.on.split(" ");
    const input = press.querySelector("input"), output = press.querySelector("output");
    const figures = [...press.querySelectorAll("figure")].map(f => [...f.querySelectorAll("img")]);
    const show = () => {
      const k = Number(input.value);
      for (const images of figures) images.forEach((image, i) => image.classList.toggle("on", i === k));
      output.textContent = `${forces[k]} N, ${on[k]} switches on`;
      input.setAttribute("aria-valuetext", output.textContent);
    };
    press.classList.add("live");
    press.querySelector(".controls").hidden = false;
    input.addEventListener("input", show);
    show();
  }

  function explore(root) {
    const data = document.getElementById(root.dataset.from);
    root.explorer = window.PhytacExplorer.create(root, JSON.parse(data.textContent));
    return root.explorer;
  }

  // Side by side: one choice of colouring and one turn for all.
  function together(explorers) {
    for (const one of explorers) {
      const others = explorers.filter(other => other !== one);
      one.onColour = key => others.forEach(other => other.colourBy(key));
      if (one.shell) {
        one.shell.onTurn = view => others.forEach(other => other.shell && other.shell.look(view));
      }
    }
  }

  // What scrolls sideways can be scrolled by keys.
  function reach() {
    for (const part of document.querySelectorAll("table, pre")) {
      if (part.scrollWidth > part.clientWidth) part.tabIndex = 0;
    }
  }

  document.querySelectorAll(".press").forEach(slider);
  document.querySelectorAll("details").forEach(part => part.addEventListener("toggle", reach));
  window.addEventListener("resize", reach);
  reach();
  // After the first paint: making a WebGL context can take a second.
  requestAnimationFrame(() => setTimeout(() => {
    const made = [...document.querySelectorAll(".explorer[data-from]")].map(explore);
    if (made.length > 1) together(made);
    document.documentElement.dataset.ready = "yes";
  }));
})();
