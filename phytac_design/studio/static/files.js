// Opening and saving design files.
import { by, node, post } from "./api.js";
import { addressPart, sharedDesign } from "./share.js";

export class Files {
  constructor(model, start) {
    Object.assign(this, { model, shipped: start.shipped, files: start.files });
    by("save-root").textContent = start.root;
    by("open-button").addEventListener("click", () => this.ask());
    by("open-go").addEventListener("click", () => this.open());
    by("save-button").addEventListener("click", () => this.saving());
    by("share-button").addEventListener("click", () => this.share());
    by("share-copy").addEventListener("click", () => {
      by("share-text").select();
      navigator.clipboard.writeText(by("share-text").value);
    });
    by("save-go").addEventListener("click", () => this.save(false));
    by("save-over").addEventListener("click", () => this.save(true));
    by("save-dialog").querySelector("form").addEventListener("keydown", event => {
      if (event.key !== "Enter" || event.target !== by("save-name")) return;
      event.preventDefault();
      this.save(false);
    });
  }

  ask() {
    const group = (label, names) => node("optgroup", { label },
      ...names.map(name => node("option", { value: name }, name)));
    by("open-error").textContent = by("open-shared").value = "";
    by("open-name").replaceChildren(...[
      this.files.length && group("in this folder", this.files),
      group("shipped", this.shipped)].filter(Boolean));
    by("open-dialog").showModal();
  }

  async open() {
    const text = by("open-shared").value.trim();
    try {
      if (text) this.openShared(text);
      else this.model.open(await post("api/open", { name: by("open-name").value }), true);
      by("open-dialog").close();
    } catch (error) {
      by("open-error").textContent = error.message;
    }
  }

  share() {
    by("share-text").value = addressPart(this.model.now.data);
    by("share-dialog").showModal();
  }

  // It belongs to no file: it counts as not saved.
  openShared(text) {
    const data = sharedDesign(text);
    if (!data) throw new Error("a shared design starts with #design=");
    this.model.open({ name: "", data }, true);
    this.model.saved = "{}";
    this.model.notify("all");
  }

  async saving() {
    const { data, source } = this.model.now, name = this.model.value("name") || "design";
    by("save-error").textContent = "";
    by("save-ask").hidden = true;
    by("save-text").textContent = "";
    by("save-name").value = !source || this.shipped.includes(source) ? `${name}.toml` : source;
    by("save-dialog").showModal();
    try {
      by("save-text").textContent = (await post("api/text", { data, source })).text;
    } catch (error) {
      by("save-error").textContent = error.message;
    }
  }

  async save(force) {
    const { data, source, digest } = this.model.now, name = by("save-name").value.trim();
    const replace = name === source ? digest : "";
    try {
      const opened = await post("api/save", { data, source, name, replace, force });
      this.model.wasSaved(opened);
      if (!this.files.includes(name)) this.files = [...this.files, name].sort();
      by("save-dialog").close();
    } catch (error) {
      by("save-ask").hidden = !error.ask;
      by("save-ask-text").textContent = error.ask || "";
      by("save-error").textContent = error.ask ? "" : error.message;
      if (error.ask) by("save-over").focus();
    }
  }
}
