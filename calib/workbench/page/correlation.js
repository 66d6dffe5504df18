// Measured and model modes: MAC of all pairs, a pair's shapes beside and over each other, and edits of the pairing.
import { afterFailure } from "./app.js";
import { Changes } from "./changes.js";
import { ask, h, panel, shade, table } from "./dom.js";
import { Shapes } from "./shapes.js";

export class Correlation {
  constructor(pane, place) {
    Object.assign(this, { pane, place, seen: "", results: null, stage: "", picked: null });
    this.failed = h("div", {});
    this.changes = new Changes(pane, () => { this.known = null; pane.refresh(); });  // what it shows stays, whatever else is drawn anew
    this.body = h("div", { class: "stack" });
    place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body));
  }

  close() {
    this.shapes?.close();
  }

  async look(live) {
    if (!this.known || live?.results !== this.results) {
      const [known, found] = await Promise.all([ask(this.pane.of("")), ask(this.pane.of("correlation"))]);
      if (!this.pane.shown) return;
      this.results = live?.results ?? null;
      Object.assign(this, { known, found: found.correlation, undoing: found.undo, test: found.test, stated: found.stated });
      this.pane.knows(known);
    }
    this.failed.replaceChildren(afterFailure(this.pane) ?? "");
    const now = JSON.stringify([this.found, this.undoing, this.known?.analyses.map((one) => one.state), Boolean(this.pane.running)]);
    if (now === this.seen) return;
    this.seen = now;
    if (this.found) this.fill(); else this.empty();
  }

  // -- the view ------------------------------------------------------------------------------------------------------

  fill() {
    const { found, pane } = this, stages = found.stages;
    this.stage = stages.some((one) => one.name === this.stage) ? this.stage : stages.at(-1).name;
    const stage = stages.find((one) => one.name === this.stage);
    const choice = h("select", { "aria-label": "stage of the model", onchange: (event) => { this.stage = event.target.value; this.picked = null; this.fill(); } },
      stages.map((one) => h("option", { value: one.name, selected: one.name === this.stage }, one.words)));
    const pair = stage.pairs.find((one) => one.model_mode !== null);
    this.picked ??= pair ? [pair.mode, pair.model_mode] : null;
    this.detail = h("div", { class: "stack", id: "pair" });
    this.shapes?.close();
    this.shapes = found.scene ? new Shapes(found.scene) : null;
    const stale = this.known.analyses.find((one) => one.verb === "compare" && one.state === "stale");
    this.body.replaceChildren(
      stale ? h("div", { class: "note" }, h("p", {}, stale.stale), h("div", { class: "act" }, pane.button("compare", "Compare again", "main"))) : "",
      h("div", { class: "grid search" },
        h("div", { class: "stack" },
          h("section", { class: "panel" }, h("div", { class: "head" }, h("h2", {}, `MAC of all pairs${this.test ? `, ${this.test}` : ""}`), h("span", { class: "grow" }), choice), this.matrix(stage)),
          panel("Pairs", this.pairs(stage))),
        h("div", { class: "stack" }, this.detail, this.edits())));
    this.show(stage);
  }

  matrix(stage) {
    if (!stage.mac.length) return h("p", { class: "soft" }, "No shapes were measured: there is no MAC.");
    const pairs = new Map(stage.pairs.map((one) => [one.mode, one.model_mode]));
    const cell = (value, row, column) => {
      const mode = stage.measured[row].name, number = stage.model[column].number, is = pairs.get(mode) === number;
      return h("td", {}, h("button", { type: "button", class: `cell${is ? " paired" : ""}${shade(value)}`, "data-row": row, "data-column": column,
        tabIndex: row === 0 && column === 0 ? 0 : -1,
        style: { "--mac": value ?? 0 }, "aria-pressed": String(this.picked?.[0] === mode && this.picked?.[1] === number),
        "aria-label": `${mode} with model mode ${number}: MAC ${value === null ? "unknown" : value.toFixed(3)}${is ? ", paired" : ""}`,
        title: `${mode} (${stage.measured[row].freq} Hz) with model mode ${number} (${stage.model[column].freq} Hz): MAC ${value === null ? "unknown" : value.toFixed(3)}`,
        onclick: () => this.pick(stage, mode, number) },
      value !== null && value >= 0.095 ? value.toFixed(2).replace(/^0/, "") : ""));
    };
    const grid = h("table", { class: "mac" },
      h("caption", {}, "Rows: measured modes; columns: modes of the model. A frame marks a pair. Click a cell, or move with the arrow keys."),
      h("thead", {}, h("tr", {}, h("th", {}), stage.model.map((one) => h("th", { scope: "col" }, String(one.number), h("span", { class: "at" }, one.freq))))),
      h("tbody", {}, stage.mac.map((row, k) => h("tr", {}, h("th", { scope: "row" }, stage.measured[k].name, h("span", { class: "at" }, stage.measured[k].freq)), row.map((value, j) => cell(value, k, j))))));
    grid.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key], own = event.target.dataset;
      if (!step || own.row === undefined) return;
      event.preventDefault();
      const next = grid.querySelector(`[data-row="${Number(own.row) + step[0]}"][data-column="${Number(own.column) + step[1]}"]`);
      if (!next) return;
      event.target.tabIndex = -1;
      next.tabIndex = 0;
      next.focus();
    });
    return h("div", { class: "wide" }, grid);
  }

  pairs(stage) {
    return table([{ title: "measured", words: true }, "Hz", "model mode", "Hz", "error, %", "MAC", "damping, %", "model, %"], stage.pairs.map((one) =>
      h("tr", { class: "pick", "aria-selected": String(this.picked?.[0] === one.mode), onclick: () => one.model_mode !== null && this.pick(stage, one.mode, one.model_mode) },
        h("th", { scope: "row" }, one.mode), h("td", {}, one.measured), h("td", {}, one.model_mode === null ? h("span", { class: "warn" }, "not paired") : String(one.model_mode)),
        ...[one.model, one.error, one.mac, one.damping, one.damping_model].map((value) => h("td", {}, value)))));
  }

  pick(stage, mode, number) {
    this.choose(stage, mode, number);
    this.pane.picked({ mode });
  }

  // A mode was picked beside this study.
  follow({ mode }) {
    const stage = this.found?.stages.find((one) => one.name === this.stage), pair = stage?.pairs.find((one) => one.mode === mode);
    if (pair && pair.model_mode !== null) this.choose(stage, mode, pair.model_mode);
  }

  choose(stage, mode, number) {
    this.picked = [mode, number];
    for (const own of this.body.querySelectorAll(".cell")) {
      own.setAttribute("aria-pressed", String(stage.measured[own.dataset.row].name === mode && stage.model[own.dataset.column].number === number));
    }
    for (const own of this.body.querySelectorAll("tr.pick")) own.setAttribute("aria-selected", String(own.firstChild.textContent === mode));
    this.show(stage);
  }

  // A measured mode beside a mode of the model, and what can be done with them.
  show(stage) {
    if (!this.picked) { this.detail.replaceChildren(); return; }
    const [mode, number] = this.picked, pair = stage.pairs.find((one) => one.mode === mode), is = pair?.model_mode === number;
    const known = this.found.modes.find((one) => one.name === mode), row = stage.measured.findIndex((one) => one.name === mode), column = stage.model.findIndex((one) => one.number === number);
    const mac = stage.mac[row]?.[column];
    const motion = this.found.motions[`${stage.name} calibration`]?.[number];
    const drawn = this.shapes?.show(stage.name, mode, motion);
    this.detail.replaceChildren(h("section", { class: "panel" },
      h("div", { class: "head" }, h("h2", {}, `${mode} and model mode ${number}`), is ? h("span", { class: "chip good" }, "paired") : h("span", { class: "chip" }, "not a pair"), h("span", { class: "grow" }),
        mac === undefined || mac === null ? null : h("span", { class: "num" }, `MAC ${mac.toFixed(3)}`)),
      drawn ?? h("p", { class: "soft" }, "There is no geometry to draw the shapes on."),
      drawn && !motion ? h("p", { class: "soft" }, "The motion of this model mode is not stored: only modes that a measured one is paired with are.") : null,
      h("div", { class: "act" },
        is ? null : h("button", { type: "button", onclick: () => this.propose({ what: "pair", name: mode, value: number }) }, `Pair ${mode} with ${number}`),
        this.stated.includes(mode) ? h("button", { type: "button", onclick: () => this.propose({ what: "unpair", name: mode }) }, `Pair ${mode} automatically`) : null,
        h("button", { type: "button", onclick: () => this.propose({ what: "mode", name: mode }) }, known?.held_out ? `Use ${mode} again` : `Hold out ${mode}`))));
  }

  edits() {
    const { found } = this;
    const sensor = h("select", { "aria-label": "sensor" }, found.sensors.map((one) => h("option", { value: one.name }, one.held_out ? `${one.name} (held out)` : one.name)));
    return panel("Sensors and edits",
      h("p", { class: "soft" }, "An edit goes into study.toml, with its comments kept. It is shown first and can be undone; what it makes out of date is marked."),
      h("div", { class: "act" }, sensor,
        h("button", { type: "button", onclick: () => this.propose({ what: "flip", name: sensor.value }) }, "Flip its sign"),
        h("button", { type: "button", onclick: () => this.propose({ what: "sensor", name: sensor.value }) }, "Hold out or use"),
        this.changes.undo(this.undoing, this.test)),
      this.changes.element);
  }

  propose(edit) {
    this.changes.propose(edit, this.test);
  }

  empty() {
    const { pane } = this, other = this.known.kind && this.known.kind !== "modes", compare = this.known.analyses.find((one) => one.verb === "compare");
    this.body.replaceChildren(h("section", { class: "panel empty" },
      h("h2", {}, other ? "This study compares no modes" : compare.state === "stale" ? "The comparison is out of date" : "No comparison has been run"),
      h("p", {}, other ? "MAC and shapes belong to measured modes." : compare.stale || "A comparison pairs measured modes with those of the model by MAC and strain energy; it takes seconds."),
      h("div", { class: "act" }, other ? null : pane.button("compare", "Compare", "main"),
        this.changes.undo(this.undoing, this.test))));
  }
}
