// A press on the wall that is dragged over the camera view: the server draws the view under it.
import { by, node, post, show } from "./api.js";

const STEP = 0.02, FAR = 5;

export class Press {
  constructor(model, views, live) {
    Object.assign(this, { model, views, live });
    this.at = { camera: 0, x: 0.5, y: 0.5 };
    this.placed = this.asking = this.again = false;
    this.handles = [];
    this.on = by("press-on");
    this.force = by("press-force");
    this.on.addEventListener("change", () => this.switched());
    this.force.addEventListener("input", () => this.ask());
    views.onDraft = draft => this.drafted(draft);
    this.resized = new ResizeObserver(() => this.place());
  }

  drafted(draft) {
    const { force_max_N: most } = draft.resolved.training;
    if (most !== this.most) {
      this.most = most;
      this.force.max = most;
      this.force.value = most / 2;
    }
    if (this.on.checked) this.ask();
  }

  switched() {
    this.force.disabled = !this.on.checked;
    for (const handle of this.handles) handle.remove();
    this.handles = [];
    if (!this.on.checked) {
      this.views.press(null);
      by("press-text").textContent = "";
      return;
    }
    if (!this.placed) this.first();
    this.ask();
  }

  // Beside the middle of the picture, where there is a marker.
  first() {
    const camera = this.views.cameras[0];
    const { width, height } = camera;
    let best = Infinity;
    for (const [x, y] of camera.tip_px) {
      const away = x === null ? Infinity : Math.abs(Math.hypot(x - width / 2, y - height / 2) - height / 3);
      if (away < best) {
        best = away;
        this.at = { camera: 0, x: (x + 0.5) / width, y: (y + 0.5) / height };
      }
    }
    this.placed = true;
  }

  // One handle on each camera's view; only the one that is dragged leads.
  hold() {
    const { cameras } = this.views;
    if (this.handles.length === cameras.length && this.handles.every(one => one.isConnected)) return;
    this.resized.disconnect();
    for (const handle of this.handles) handle.remove();
    this.handles = cameras.map((camera, k) => {
      const handle = node("button", { type: "button", class: "press-handle", "data-camera": k,
        "aria-label": "Press: drag it, or move it by the arrow keys", "aria-describedby": "press-text" });
      handle.addEventListener("pointerdown", event => {
        handle.setPointerCapture(event.pointerId);
        this.dragged = k;
        event.preventDefault();
        handle.focus();
      });
      handle.addEventListener("pointermove", event => {
        if (!handle.hasPointerCapture(event.pointerId)) return;
        const box = camera.canvas.getBoundingClientRect();
        this.move(k, (event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
      });
      for (const end of ["pointerup", "pointercancel"]) {
        handle.addEventListener(end, () => {
          this.dragged = undefined;
          this.place();
        });
      }
      handle.addEventListener("keydown", event => this.key(k, event));
      camera.canvas.after(handle);
      this.resized.observe(camera.canvas);
      return handle;
    });
  }

  key(k, event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!way || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    const { width, height } = this.views.cameras[k], step = STEP * (event.shiftKey ? FAR : 1);
    const { x, y } = this.places ? this.places[k] : this.at;
    this.move(k, x + way[0] * step, y + way[1] * step * width / height);
  }

  move(k, x, y) {
    const inside = value => Math.min(1, Math.max(0, value));
    this.at = { camera: k, x: inside(x), y: inside(y) };
    if (this.places) this.places[k] = { x: this.at.x, y: this.at.y };
    this.place();
    this.ask();
  }

  place() {
    this.handles.forEach((handle, k) => {
      const { canvas } = this.views.cameras[k], at = (this.places || [])[k];
      handle.hidden = !at || at.x === null;
      if (handle.hidden) return;
      handle.style.left = `${canvas.offsetLeft + at.x * canvas.clientWidth}px`;
      handle.style.top = `${canvas.offsetTop + at.y * canvas.clientHeight}px`;
    });
  }

  // One request at a time; when it is answered, the newest place is asked for.
  async ask() {
    if (!this.on.checked) return;
    if (this.asking) {
      this.again = true;
      return;
    }
    this.asking = true;
    document.body.dataset.press = "asking";
    const asked = this.at;
    try {
      const body = { ...this.live.body(), side_px: this.live.side(), ...asked,
        force_N: Number(this.force.value) };
      const found = await post("api/press", body);
      // A later draft is of another design: its own press follows.
      const same = JSON.stringify(body.data) === JSON.stringify(this.model.now.data);
      if (this.on.checked && same) await this.shown(found);
    } catch (error) {
      if (!error.stale) by("press-text").textContent = `No press can be drawn: ${error.message}`;
    }
    this.asking = false;
    if (this.again) {
      this.again = false;
      this.ask();
    } else document.body.dataset.press = "shown";
  }

  async shown(found) {
    await this.views.press(found.cameras);
    this.hold();
    // The place under the pointer stays where it is dragged, also off the wall.
    this.places = found.cameras.map(({ press: [x, y] }, k) =>
      (k === this.dragged ? { x: this.at.x, y: this.at.y } : { x, y }));
    this.place();
    by("press-text").textContent = `${show(found.force_N)} N on ø${show(2 * found.radius_mm)} mm beside marker `
      + `${found.marker}: it moves ${show(found.dent_mm)} mm inwards (linear), `
      + `${found.on} switches on`;
    document.body.dataset.presses = String(1 + Number(document.body.dataset.presses || 0));
  }
}
