// The current design: its tables as in the file, the resolved values, and earlier states for undo.

const TOGETHER_MS = 800;
const PAST_MAX = 300;

const copy = value => structuredClone(value);

export class Model extends EventTarget {
  constructor(sets) {
    super();
    this.sets = sets;
    this.now = { data: {}, source: "", digest: "" };
    this.resolved = {};
    this.saved = "{}";
    this.past = [];
    this.future = [];
    this.last = { path: "", at: 0 };
  }

  // Open a design; undo returns to the one before.
  open(opened, keep) {
    if (keep) this.remember("");
    this.now = {
      data: copy(opened.data), source: opened.name, digest: opened.digest || "",
    };
    this.saved = JSON.stringify(this.now.data);
    if (!keep) {
      this.past = [];
      this.future = [];
    }
    this.resolved = {};
    this.notify("all");
  }

  remember(path) {
    const at = performance.now();
    const same = path && path === this.last.path && at - this.last.at < TOGETHER_MS;
    this.last = { path, at };
    if (same && this.past.length) return;
    this.past.push(copy(this.now));
    if (this.past.length > PAST_MAX) this.past.shift();
    this.future = [];
  }

  value(path) {
    const [table, key] = split(path);
    const own = key ? (this.now.data[table] || {})[key] : this.now.data[table];
    if (own !== undefined) return own;
    const made = this.resolved[table];
    return key ? (made || {})[key] : made;
  }

  set(path, value) {
    this.remember(path);
    this.put(path, value);
    this.notify(path);
  }

  // Several fields in one step to undo.
  setAll(fields) {
    this.remember("");
    for (const [path, value] of Object.entries(fields)) this.put(path, value);
    this.notify("all");
  }

  put(path, value) {
    const [table, key] = split(path);
    const data = this.now.data;
    if (key) data[table] = { ...data[table], [key]: value };
    else data[table] = value;
    // A choice that sets other fields replaces their own values.
    for (const name of this.sets[path] || []) delete data[table][name];
  }

  // Another surface family: an example's tables of shape, layout, receptors, switches and light.
  shape(tables) {
    this.remember("");
    Object.assign(this.now.data, copy(tables));
    this.notify("all");
  }

  step(from, to) {
    const before = from.pop();
    if (!before) return;
    to.push(copy(this.now));
    this.now = before;
    this.last = { path: "", at: 0 };
    this.notify("all");
  }

  undo() { this.step(this.past, this.future); }

  redo() { this.step(this.future, this.past); }

  wasSaved(opened) {
    this.now.source = opened.name;
    this.now.digest = opened.digest;
    this.saved = JSON.stringify(this.now.data);
    this.dispatchEvent(new CustomEvent("state"));
  }

  get dirty() { return JSON.stringify(this.now.data) !== this.saved; }

  notify(path) {
    this.dispatchEvent(new CustomEvent("change", { detail: path }));
    this.dispatchEvent(new CustomEvent("state"));
  }
}

function split(path) {
  const at = path.indexOf(".");
  return at < 0 ? [path, ""] : [path.slice(0, at), path.slice(at + 1)];
}
