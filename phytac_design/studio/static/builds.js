// A build of the current design: start, progress, stop, report.
import { by, node, post, show } from "./api.js";

export class Build {
  constructor(model, accuracies, state) {
    this.model = model;
    by("accuracy").append(...accuracies.map(name => node("option", { value: name }, name)));
    by("build-button").addEventListener("click", () => this.start(false));
    by("stop-button").addEventListener("click", () => this.stop());
    model.addEventListener("state", () => {
      by("build-out").textContent = `exports/${model.value("name") || ""}`;
    });
    this.log = by("build-log").querySelector("pre");
    if (state.state !== "none") this.follow();
  }

  async start(force) {
    by("build-state").textContent = "";
    by("report").replaceChildren();
    this.log.textContent = "";
    try {
      const { data, source } = this.model.now;
      await post("api/build", { data, source, accuracy: by("accuracy").value, force });
      this.follow();
    } catch (error) {
      by("build-state").textContent = error.message;
    }
  }

  follow() {
    const events = new EventSource("api/build/events");
    this.log.textContent = "";
    this.running(true);
    events.addEventListener("message", message => {
      const state = JSON.parse(message.data);
      by("build-bar").value = state.done || 0;
      by("build-stage").textContent = `${state.name}, ${state.accuracy}: ${state.stage} `
        + `(${show(state.seconds)} s)`;
      for (const line of state.lines) this.log.append(line + "\n");
      if (state.state !== "running") {
        events.close();
        this.ended(state);
      }
    });
    events.addEventListener("error", () => {
      if (events.readyState === EventSource.CLOSED) this.running(false);
    });
  }

  running(is) {
    by("build-button").disabled = is;
    by("stop-button").hidden = !is;
    by("build-progress").hidden = !is;
    by("build-log").hidden = false;
  }

  ended(state) {
    this.running(false);
    const took = `${show(state.seconds)} s`;
    const text = {
      done: `${state.name} is built (${state.accuracy}, ${took}), in ${state.out}.`,
      stopped: `Stopped after ${took}; the next build resumes there.`,
      failed: state.error || "The build failed.",
    }[state.state] || "";
    by("build-state").textContent = text;
    if (state.state === "failed" && text.includes("--force")) {
      const button = node("button", { type: "button" }, "Build all the same");
      button.addEventListener("click", () => this.start(true));
      by("report").replaceChildren(button);
    }
    if (!state.report) return;
    const address = "files/" + state.report.split("/").map(encodeURIComponent).join("/");
    by("report").replaceChildren(
      node("p", {}, node("a", { href: address, target: "_blank", rel: "noopener" },
        "Open the report by itself")),
      node("iframe", { src: address, sandbox: "allow-scripts allow-popups",
        title: `Report of ${state.name}` }));
  }

  async stop() {
    by("stop-button").disabled = true;
    try {
      await post("api/build/stop", {});
    } finally {
      by("stop-button").disabled = false;
    }
  }
}
