// Controls, made from the form that the typed design model gives.
import { node, prose } from "./api.js";

const RANGE_MAX = 200, STEPS = 200, LONG = 60;
let made = 0;

export class Controls {
  constructor(root, form, model) {
    Object.assign(this, { root, form, model, all: new Map(), last: "" });
    root.replaceChildren();
    const head = node("div", {}, ...form.head.map(field => this.control(field)));
    root.append(head);
    form.tables.forEach((table, k) => {
      const first = k < 6;
      const part = node("details", { open: first }, node("summary", {}, table.name.replace("_", " ")));
      if (table.doc) part.append(node("p", { class: "foot" }, ...prose(table.doc)));
      const inner = node("div", { id: "table-" + table.name },
        ...table.fields.map(field => this.control(field)));
      part.append(inner);
      root.append(part);
    });
    this.family = "";
  }

  // A control: label, input, explanation, error.
  control(field) {
    const id = "c" + made++, help = id + "-help", err = id + "-err";
    const words = { "aria-describedby": `${help} ${err}` };
    const part = { field, inputs: [], box: node("div", { class: "control", "data-path": field.path }) };
    const unit = field.unit ? node("span", { class: "unit" }, ` (${field.unit})`) : "";
    const label = node("label", { for: id }, field.label, unit);
    const error = node("p", { class: "err", id: err });
    part.error = error;
    const send = value => {
      this.last = field.path;
      this.showError(field.path, "");
      this.model.set(field.path, value);
    };
    if (field.kind === "choice") this.choice(part, id, words, send);
    else if (field.kind === "number" || field.kind === "whole") this.number(part, id, words, send);
    else this.text(part, id, words, send);
    const doc = field.doc + (field.assumed ? " (Assumed: not stated by the paper.)" : "");
    part.box.append(label, ...part.parts, node("p", { class: "help", id: help }, ...prose(doc)), error);
    this.all.set(field.path, part);
    return part.box;
  }

  choice(part, id, words, send) {
    const input = node("select", { id, ...words },
      ...part.field.words.map(word => node("option", { value: word }, word)));
    input.addEventListener("change", () => {
      if (part.field.path === "shape.kind") {
        this.last = "shape.kind";
        this.model.shape(this.form.examples[input.value]);
      } else send(input.value);
    });
    part.parts = [input];
    part.inputs = [input];
    part.show = value => { input.value = value; };
  }

  number(part, id, words, send) {
    const { field } = part, whole = field.kind === "whole";
    const input = node("input", { id, type: "number", inputmode: whole ? "numeric" : "decimal",
      step: whole ? 1 : "any", ...words });
    const range = node("input", { type: "range", tabindex: -1, "aria-label": field.label + ", slider" });
    const [word] = field.words;
    const check = word && node("input", { type: "checkbox", id: id + "-word" });
    part.parts = [node("div", { class: "pairing" }, range, input)];
    if (check) {
      part.parts.unshift(node("label", { class: "word", for: id + "-word" }, check, " " + word));
      check.addEventListener("change", () => {
        send(check.checked ? word : part.before ?? field.low ?? 0);
        part.show(this.model.value(field.path));
      });
    }
    const span = value => {
      const [low, high, step] = limits(field, value);
      Object.assign(range, { min: low, max: high, step });
      // Steps of the number's own magnitude for the arrow keys.
      input.step = whole ? 1 : step;
    };
    input.addEventListener("input", () => {
      const value = input.valueAsNumber;
      if (!Number.isFinite(value)) {
        this.showError(field.path, "enter a number");
        return;
      }
      range.value = value;
      send(value);
    });
    range.addEventListener("input", () => {
      input.value = +(+range.value).toPrecision(6);
      send(input.valueAsNumber);
    });
    range.addEventListener("change", () => span(range.valueAsNumber));
    part.inputs = check ? [input, range, check] : [input, range];
    part.show = value => {
      const known = typeof value === "number";
      if (check) {
        check.checked = value === word;
        input.disabled = range.disabled = check.checked;
      }
      const shown = known ? value : part.before;
      if (typeof shown !== "number") return;
      const inside = shown >= +range.min && shown <= +range.max && range.min !== "";
      if (!inside) span(shown);
      input.value = +shown.toPrecision(10);
      range.value = shown;
    };
  }

  text(part, id, words, send) {
    const json = part.field.kind === "json";
    let input = node("input", { id, type: "text", spellcheck: "false", autocomplete: "off", ...words });
    const holder = node("div", {}, input);
    const listen = () => input.addEventListener("change", () => {
      if (!json) {
        send(input.value);
        return;
      }
      try {
        send(JSON.parse(input.value));
      } catch {
        if (/^[\w-]+$/.test(input.value.trim())) send(input.value.trim());
        else this.showError(part.field.path, "not a list; write it as [1, 2] or [\"blue\", \"green\"]");
      }
    });
    listen();
    part.parts = [holder];
    part.inputs = [input];
    part.show = value => {
      const text = json ? (value === undefined ? "" : JSON.stringify(value)) : value ?? "";
      if (json && (text.length > LONG) !== (input.tagName === "TEXTAREA")) {
        const other = node(text.length > LONG ? "textarea" : "input", { id, spellcheck: "false", ...words });
        if (text.length <= LONG) other.type = "text";
        input.replaceWith(other);
        input = other;
        part.inputs = [input];
        listen();
      }
      input.value = text;
    };
  }

  // Show the values of the model in all controls but the focused one.
  refresh(everything) {
    const kind = this.model.value("shape.kind");
    if (kind !== this.family && this.form.shapes[kind]) {
      this.family = kind;
      for (const path of [...this.all.keys()]) {
        if (path.startsWith("shape.") && path !== "shape.kind") this.all.delete(path);
      }
      const inner = this.root.querySelector("#table-shape");
      inner.replaceChildren(inner.firstChild, ...this.form.shapes[kind].map(field => this.control(field)));
    }
    for (const [path, part] of this.all) {
      const typing = part.inputs.some(input => input === document.activeElement
        && !(input.type === "range" || input.type === "checkbox" || input.tagName === "SELECT"));
      const value = this.model.value(path);
      if (value !== undefined && (everything || !typing)) part.show(value);
      const when = this.form.when[path];
      if (when) {
        const at = this.model.value(when.field);
        part.box.hidden = at !== undefined && !when.is.includes(at);
      }
    }
  }

  // The current value of a word such as `fit`.
  stands(path, value) {
    const part = this.all.get(path);
    if (part && typeof this.model.value(path) !== "number") {
      part.before = +value.toPrecision(6);
      part.show(this.model.value(path));
    }
  }

  showError(path, text) {
    const part = this.all.get(path);
    if (!part) return false;
    if (part.error.textContent !== text) part.error.textContent = text;
    part.box.classList.toggle("wrong", Boolean(text));
    for (const input of part.inputs) {
      if (text) input.setAttribute("aria-invalid", "true");
      else input.removeAttribute("aria-invalid");
    }
    return true;
  }

  // Errors at the controls that they name; others at the control changed last.
  errors(fields, text) {
    for (const path of this.all.keys()) this.showError(path, fields[path] || "");
    const shown = Object.keys(fields).filter(path => this.all.has(path));
    if (text && !shown.length && this.last) this.showError(this.last, text);
    for (const path of shown) {
      const fold = this.all.get(path).box.closest("details");
      if (fold && path === this.last) fold.open = true;
    }
  }
}

// Range and step of a slider: the field's own where they are close, else around its value.
function limits(field, value) {
  let { low, high } = field;
  const near = low !== null && high !== null && high - low <= RANGE_MAX;
  if (!near) {
    const size = Math.abs(value) || 5;
    const least = value - size, most = value + 1.5 * size;
    low = Math.max(low ?? least, value < 0 ? value - size : Math.max(least, 0));
    high = Math.min(high ?? most, most);
  }
  const rough = (high - low) / STEPS, power = 10 ** Math.floor(Math.log10(rough));
  let step = [1, 2, 5, 10].map(k => +(k * power).toPrecision(1)).find(k => k >= rough);
  if (field.kind === "whole") step = Math.max(1, Math.round(step));
  if (near && field.low_open) low += step;
  if (near && field.high_open) high -= step;
  low = Math.ceil(low / step - 1e-9) * step;
  return [+low.toPrecision(6), +high.toPrecision(6), step];
}
