// The studio: controls of a design; the server computes the views.
import { by, get } from "./api.js";
import { Build } from "./builds.js";
import { Controls } from "./controls.js";
import { Files } from "./files.js";
import { Live } from "./live.js";
import { Model } from "./model.js";
import { Press } from "./press.js";
import { Studies } from "./studies.js";
import { Views } from "./views.js";

async function begin() {
  const start = await get("api/start");
  const model = new Model(start.form.sets), views = new Views();
  const controls = new Controls(by("controls"), start.form, model);
  model.addEventListener("change", event => {
    if (event.detail === "all") controls.refresh(true);
    else controls.refresh(false);
  });
  const live = new Live(model, views, controls);
  const press = new Press(model, views, live);
  const files = new Files(model, start);
  model.addEventListener("state", () => {
    const { source } = model.now, name = model.value("name") || "";
    by("where").textContent = `${name}${source && source !== name ? ` (${source})` : ""}`
      + (model.dirty ? ", not saved" : "");
    document.title = `${name}: PhyTac studio`;
    by("undo-button").disabled = !model.past.length;
    by("redo-button").disabled = !model.future.length;
  });
  by("undo-button").addEventListener("click", () => model.undo());
  by("redo-button").addEventListener("click", () => model.redo());
  document.addEventListener("keydown", event => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey || document.querySelector("dialog[open]")) return;
    const key = event.key.toLowerCase();
    const act = key === "s" ? () => files.saving()
      : key === "z" && event.target.tagName !== "TEXTAREA"
        ? () => (event.shiftKey ? model.redo() : model.undo())
        : key === "y" ? () => model.redo() : null;
    if (!act) return;
    event.preventDefault();
    act();
  });
  window.addEventListener("beforeunload", event => { if (model.dirty) event.preventDefault(); });
  const build = new Build(model, start.accuracies, start.build), studies = new Studies(model);
  model.open(start.design, false);
  const openAddress = () => {
    if (!location.hash.startsWith("#design=")) return;
    try {
      files.openShared(location.hash);
    } catch (error) {
      by("where").textContent = error.message;
    }
    history.replaceState(null, "", location.pathname);
  };
  window.addEventListener("hashchange", openAddress);
  openAddress();
  window.studio = { model, live, views, press, build, studies };
}

begin().catch(error => {
  by("verdict").className = "verdict bad";
  by("verdict").textContent = `The studio could not start: ${error.message}`;
});
