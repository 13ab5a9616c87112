// Drafts while controls move, a check when they stop. Only the newest request counts.
import { node, post, Refused } from "./api.js";

const QUICK_MS = 500, REST_MS = 400;

export class Live {
  constructor(model, views, controls) {
    Object.assign(this, { model, views, controls });
    this.tab = crypto.randomUUID ? crypto.randomUUID() : String(Math.random()).slice(2);
    this.waiting = false;
    this.mean = 0;
    this.times = [];
    views.repair = button => this.repair(button);
    model.addEventListener("change", event => {
      this.whole = this.whole || event.detail === "all";
      this.change();
    });
  }

  // drawing, drawn, checked or refused, for tests that wait for it.
  state(now) { document.body.dataset.state = now; }

  change() {
    this.state("drawing");
    this.since ??= performance.now();
    clearTimeout(this.rest);
    if (this.checking) this.checking.abort();
    if (!this.under) this.send();
    else {
      this.waiting = true;
      // Fast drafts are drawn meanwhile; slow ones would delay the newest.
      if (this.mean > QUICK_MS) this.under.abort();
    }
  }

  body() {
    const { data, source } = this.model.now;
    return { data, source, tab: this.tab };
  }

  // Longer side of the pictures, px.
  side() {
    const wide = document.getElementById("cameras").clientWidth * (window.devicePixelRatio || 1);
    return Math.round(Math.min(864, Math.max(480, wide)));
  }

  async send() {
    const since = this.since, start = performance.now();
    this.since = undefined;
    this.waiting = false;
    // After undo the focused control shows its value too.
    const whole = this.whole;
    this.whole = false;
    this.under = new AbortController();
    let drawn = null;
    try {
      const draft = await post("api/draft", { ...this.body(), side_px: this.side() }, this.under.signal);
      this.model.resolved = draft.resolved;
      await this.views.draw(draft);
      this.controls.refresh(whole);
      for (const camera of draft.cameras.slice(0, 1)) {
        this.controls.stands("camera.stand_off_mm", camera.stand_off_mm);
      }
      this.controls.errors(draft.fields, draft.refused);
      this.views.drafted(draft);
      drawn = draft;
    } catch (error) {
      this.failed(error);
    }
    this.under = null;
    if (drawn) {
      const took = performance.now() - start;
      this.mean = this.mean ? 0.7 * this.mean + 0.3 * took : took;
      await painted();
      this.times.push(performance.now() - since);
      document.body.dataset.drafts = String(this.times.length);
    }
    if (this.waiting) this.send();
    else if (drawn) this.state(drawn.refused ? "refused" : "drawn");
    if (this.waiting || this.under) return;
    if (drawn && !drawn.refused) this.rest = setTimeout(() => this.check(), REST_MS);
  }

  async check() {
    const own = this.checking = new AbortController();
    try {
      const found = await post("api/check", this.body(), own.signal);
      if (!own.signal.aborted && !this.under) {
        this.views.check(found);
        this.state("checked");
      }
    } catch (error) {
      if (!own.signal.aborted) this.failed(error);
    }
  }

  // Look for a change after which the design passes, and offer it.
  async repair(button) {
    button.disabled = true;
    button.textContent = "Looking for a change that repairs this…";
    try {
      const found = await post("api/repair", this.body());
      if (!found.words) {
        button.replaceWith("No change of one field that was tried repairs this.");
        return;
      }
      const apply = node("button", { type: "button", id: "apply-repair" }, "Apply");
      apply.addEventListener("click", () => this.model.setAll(found.fields));
      button.replaceWith(`${found.words} repairs it. `, apply);
      apply.focus();
    } catch (error) {
      if (!error.stale) button.replaceWith(`No repair was found: ${error.message}`);
    }
  }

  failed(error) {
    if (error.name === "AbortError" || error.stale) return;
    if (error instanceof Refused) {
      this.controls.errors(error.fields, error.message);
      this.views.refused(error.message);
      this.state("refused");
    } else {
      const text = "The studio does not answer: it has ended. Start `phytac studio` again, and open "
        + "the address that it prints; what is not saved is still in this page.";
      this.views.verdict("bad", text, [], "");
    }
  }
}

// After the next animation frame.
const painted = () => new Promise(done => {
  const late = setTimeout(done, 1000);  // a hidden page has no frames
  requestAnimationFrame(() => setTimeout(() => { clearTimeout(late); done(); }, 0));
});
