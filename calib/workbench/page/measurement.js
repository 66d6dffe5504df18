// The measurement: files, values with their standard deviations, sensors in space, doubts, and what to measure next.
import { afterFailure } from "./app.js";
import { Changes } from "./changes.js";
import { ask, h, panel, table } from "./dom.js";
import { viewer } from "./space.js";

const WRAPPED = { "white-space": "normal" };

export class Measurement {
  constructor(pane, place) {
    Object.assign(this, { pane, place, seen: "" });
    this.failed = h("div", {});
    this.body = h("div", { class: "stack", id: "measurement" });
    this.changes = new Changes(pane, () => { this.known = null; pane.refresh(); });
    place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body));
  }

  async look(live) {
    if (!this.known || live?.results !== this.results) {
      const [known, found] = await Promise.all([ask(this.pane.of("")), ask(this.pane.of("measurement"))]);
      if (!this.pane.shown) return;
      this.results = live?.results ?? null;
      Object.assign(this, { known, found: found.measurement, undoing: found.undo, test: found.test });
      this.pane.knows(known);
    }
    this.failed.replaceChildren(afterFailure(this.pane) ?? "");
    const now = JSON.stringify([this.found, this.undoing, Boolean(this.pane.running)]);
    if (now === this.seen) return;
    this.seen = now;
    if (this.found) this.fill(); else this.empty();
  }

  fill() {
    const { found } = this, [first, ...heads] = found.heads, held = (one) => (one.held_out ? h("span", { class: "chip warn" }, "held out") : "");
    const hold = (what, one) => (found.kind === "modes" ? h("button", { type: "button", onclick: () => this.changes.propose({ what, name: one.name }, this.test) }, one.held_out ? "Use again" : "Hold out") : "");
    const sensor = h("select", { "aria-label": "sensor" }, found.sensors.map((one) => h("option", { value: one.name }, one.held_out ? `${one.name} (held out)` : one.name)));
    const edit = (what, words) => h("button", { type: "button", onclick: () => this.changes.propose({ what, name: sensor.value }, this.test) }, words);
    this.body.replaceChildren(h("div", { class: "grid search rows" },
      h("div", { class: "stack" },
        panel("What was measured", table([{ title: first, words: true }, ...heads, ""], found.rows.map((one) => h("tr", {},
          h("th", { scope: "row" }, one.name, " ", held(one)), one.cells.map((words) => h("td", {}, words)), h("td", {}, hold("mode", one)))))),
        this.changes.element,
        found.doubts.length || found.fine.length ? panel("Doubts", found.doubts.map((words) => h("p", {}, words)), found.fine.map((words) => h("p", { class: "soft" }, words))) : null,
        panel("Files", h("ul", { class: "tree" }, found.files.map((name) => h("li", {}, h("code", {}, name)))))),
      h("div", { class: "stack" },
        found.scene ? h("section", { class: "panel", id: "space" }, h("h2", {}, "Sensors"), viewer(found.scene, "sensors")) : null,
        found.sensors.length && found.kind === "modes" ? panel("A sensor", h("div", { class: "act" }, sensor, edit("flip", "Flip its sign"), edit("sensor", "Hold out or use"), this.changes.undo(this.undoing, this.test))) : null)),
    this.next());
  }

  next() {
    const { found, pane } = this;
    if (!found.order.length && !found.measurements.length) {
      const explained = this.known.analyses.find((one) => one.verb === "explain");
      return h("section", { class: "panel", id: "next" }, h("h2", {}, "What to measure next"),
        h("p", { class: "soft" }, explained?.state === "done" ? "The explanation recommends no further measurement." : "An explanation computes which measurement would tell most: sensors, modes, excitation."),
        explained && explained.state !== "done" ? h("div", { class: "act" }, pane.button("explain", "Find what is missing")) : null);
    }
    const words = (value) => h("td", { class: "words", style: WRAPPED }, value);
    return h("section", { class: "panel", id: "next" }, h("h2", {}, "What to measure next"),
      found.order.length ? table([{ title: "test", words: true }, { title: "excite", words: true }, { title: "sensors", words: true }, { title: "how", words: true }, { title: "what it narrows", words: true }],
        found.order.map((one) => h("tr", {}, h("th", { scope: "row", class: "words", style: WRAPPED }, one.what), words(one.excite), words(one.sensors), words(one.how), words(one.narrows)))) : null,
      found.measurements.length ? h("details", { open: !found.order.length }, h("summary", { class: "soft" }, "Gains of single measurements"), table([{ title: "measurement", words: true }, { title: "for", words: true }, "score", "range"],
        found.measurements.map((one) => h("tr", {}, h("th", { scope: "row", class: "words", style: WRAPPED }, one.what), words(one.effect), h("td", {}, one.gain), h("td", { class: "soft" }, one.range))))) : null,
      found.axes ? h("p", { class: "soft small" }, found.axes) : null);
  }

  empty() {
    this.body.replaceChildren(h("section", { class: "panel empty" }, h("h2", {}, "The measurement has not been read yet"),
      h("p", {}, "A comparison reads every file, combines repeats without outliers, and places the sensors on the model; it takes seconds."),
      h("div", { class: "act" }, this.pane.button("compare", "Compare", "main"))));
  }
}
