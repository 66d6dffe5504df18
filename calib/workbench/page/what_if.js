// What if: parameters and effects by sliders; frequencies, MAC, FRF and shape follow as they move.
import { afterFailure, bar } from "./app.js";
import { Changes } from "./changes.js";
import { Chart } from "./chart.js";
import { ask, change, h, panel, shade, tell } from "./dom.js";
import { Shapes } from "./shapes.js";

const STEPS = 1000;  // places of a slider
const WAIT = 600;  // milliseconds between two looks while the model is read

export class WhatIf {
  constructor(pane, place) {
    Object.assign(this, { pane, place, seen: "", values: {}, on: new Set(), mode: "", began: 0 });
    this.failed = h("div", {});
    this.body = h("div", { class: "stack", id: "what-if" });
    this.changes = new Changes(pane, () => pane.refresh());
    this.undo = h("span", {});
    place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body));
  }

  close() {
    clearTimeout(this.waiting);
    this.shapes?.close();
  }

  async look(live) {
    clearTimeout(this.waiting);
    if (!this.known || live?.results !== this.results) {
      this.known = await ask(this.pane.of(""));
      if (!this.pane.shown) return;
      this.results = live?.results ?? null;
      this.pane.knows(this.known);
    }
    const state = await ask(this.pane.of("what-if"));
    if (!this.pane.shown) return;
    this.failed.replaceChildren(afterFailure(this.pane) ?? "");
    this.test = state.test;
    if (!state.ready) { this.prepare(state); return; }
    this.undo.replaceChildren(this.changes.undo(state.undo, state.test) ?? "");
    const now = JSON.stringify([state.ready.parameters, state.ready.effects, state.ready.starts]);
    if (now === this.seen) {
      if (this.behind) this.ask(performance.now());
      this.behind = false;
      return;
    }
    this.seen = now;
    this.ready = state.ready;
    this.scene = (await ask(this.pane.of("scene"))).scene;
    if (this.pane.shown) this.fill();
  }

  prepare(state) {
    const { pane } = this;
    if (this.ready && state.stage) {  // the study has changed: what is shown stays until the model is there again
      this.trouble.textContent = `${state.stage} …`;
      this.waiting = setTimeout(() => pane.refresh(), WAIT);
      this.behind = true;
      return;
    }
    this.seen = "";
    this.ready = null;
    if (state.fault) {
      const earlier = this.known.analyses.find((one) => one.verb === "compare" && one.state === "never");
      this.body.replaceChildren(h("section", { class: "panel empty" }, h("h2", {}, "The model cannot be moved yet"), h("p", {}, state.fault),
        earlier ? h("div", { class: "act" }, pane.button("compare", "Compare", "main")) : null));
      return;
    }
    this.body.replaceChildren(h("section", { class: "panel empty" }, h("h2", {}, "The model is being prepared"),
      h("p", {}, "A large model is reduced to a basis once, for parameters and effects together; it is kept, and an evaluation then takes milliseconds."),
      h("div", { class: "act" }, bar(state.done, state.total), h("span", { class: "num" }, state.stage))));
    this.waiting = setTimeout(() => pane.refresh(), WAIT);
  }

  // -- the view ------------------------------------------------------------------------------------------------------

  fill() {
    const { ready, scene } = this, { at } = ready;
    this.shapes?.close();
    const stage = scene?.stages.find((one) => one.modes.length);
    this.shapes = at.kind === "modes" && stage ? new Shapes(scene, ["both"]) : null;
    this.stage = stage?.name.split(" ")[0];
    this.mode = at.rows.some((one) => one.name === this.mode) ? this.mode : at.rows[0]?.name ?? "";
    this.place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body));
    const starts = h("div", { class: "act", id: "starts" }, ready.starts.map((one) => h("button", { type: "button", onclick: () => this.begin(one) }, one.words)));
    const [free, held] = [ready.parameters.filter((one) => one.free), ready.parameters.filter((one) => !one.free)];
    this.sliders = new Map();
    this.facts = h("dl", { class: "pairs", id: "facts" });
    this.trouble = h("p", { class: "warn", role: "status" });
    this.offer = h("div", { class: "act" });
    this.rows = h("tbody", {});
    this.mac = h("table", { class: "mac small" });
    this.drawn = h("div", {});
    this.chart = at.kind === "frf" ? new Chart("FRF, measured and model", "Hz", "amplitude") : null;
    this.body.replaceChildren(h("div", { class: "grid what-if" },
      h("div", { class: "stack" },
        h("section", { class: "panel" }, h("h2", {}, "Parameters"), starts, free.map((one) => this.slider(one)),
          held.length ? h("details", {}, h("summary", { class: "soft" }, `${held.length} more, which the calibration holds`), held.map((one) => this.slider(one))) : null),
        ready.effects.length ? panel("Effects", h("p", { class: "soft small" }, "What the model may lack: a slider adds it."), ready.effects.map((one) => this.effect(one))) : null),
      h("div", { class: "stack" },
        h("section", { class: "panel" }, this.facts, this.trouble, this.offer, this.changes.element),
        h("div", { class: "grid two" },
          h("div", { class: "stack" },
            panel("Model against measurement", h("div", { class: "wide" }, h("table", { id: "rows" }, this.head(at), this.rows))),
            at.mac ? panel("MAC", h("div", { class: "wide" }, this.mac)) : null),
          this.shapes ? h("section", { class: "panel" }, this.drawn) : this.chart ? panel("FRF", this.chart.element) : null))));
    if (!this.moved.every((one) => one.name in this.values)) { this.begin(ready.starts.at(-1)); return; }
    this.write();
    this.ask(performance.now());
  }

  head(at) {
    const heads = { modes: ["mode", "measured, Hz", "model, Hz", "error, %", "before", "MAC", "before"], frf: ["function", "error, σ", "before", "FRAC", "before"], numbers: ["response", "measured", "model", "error, σ", "before"] }[at.kind];
    return h("thead", {}, h("tr", {}, heads.map((words) => h("th", { scope: "col" }, words))));
  }

  slider(one, effect = null, title = one.name) {
    const range = h("input", { type: "range", min: 0, max: STEPS, step: 1, name: one.name, "aria-label": `${one.name}${one.unit ? `, ${one.unit}` : ""}` });
    const number = h("span", { class: "num" });
    const to = (value) => (one.log ? Math.log(value) : value), from = (x) => (one.log ? Math.exp(x) : x);
    const write = () => {
      const value = this.values[one.name], off = effect !== null && !this.on.has(effect);
      range.value = Math.round(STEPS * (to(value) - to(one.lower)) / (to(one.upper) - to(one.lower)));
      number.textContent = off ? "off" : `${short(value)}${one.unit ? ` ${one.unit}` : ""}`;
      range.setAttribute("aria-valuetext", number.textContent);
    };
    range.addEventListener("input", (event) => {
      const value = from(to(one.lower) + range.value / STEPS * (to(one.upper) - to(one.lower)));
      this.values[one.name] = one.integer ? Math.round(value) : Number(value.toPrecision(6));
      if (effect !== null && !this.on.has(effect)) { this.on.add(effect); this.write(); }
      write();
      this.ask(event.timeStamp);
      this.pane.picked({ parameter: one.name, value: this.values[one.name] });
    });
    this.sliders.set(one.name, write);
    return h("label", { class: "slider", title: title === one.name ? one.words : `${one.name}: ${one.words}` }, h("span", { class: "name" }, title), number, range);
  }

  effect(one) {
    const box = h("input", { type: "checkbox", "aria-label": one.title, onchange: (event) => {
      if (box.checked) this.on.add(one.name); else this.on.delete(one.name);
      if (box.checked && this.values[one.name] === one.sliders[0].value) this.values[one.name] = Math.min(one.plausible, one.sliders[0].upper);
      this.write();
      this.ask(event.timeStamp);
    } });
    const more = h("div", {}, one.sliders.slice(1).map((own) => this.slider(own, one.name)));
    const first = this.slider(one.sliders[0], one.name, one.title), write = this.sliders.get(one.name);
    this.sliders.set(one.name, () => { write(); box.checked = this.on.has(one.name); more.hidden = !box.checked; });
    return h("div", { class: "effect", "data-name": one.name }, box, first, more);
  }

  get moved() {
    return [...this.ready.parameters, ...this.ready.effects.flatMap((one) => one.sliders)];
  }

  write() {
    for (const write of this.sliders.values()) write();
  }

  begin(start) {
    this.values = { ...Object.fromEntries(this.moved.map((one) => [one.name, one.value])), ...start.values };
    this.on = new Set(start.effects);
    this.base = null;
    this.write();
    this.ask(performance.now());
  }

  // -- evaluations ---------------------------------------------------------------------------------------------------

  // One at a time; the latest values follow those that are under way.
  async ask(began) {
    this.began = began;
    if (this.asking) { this.again = true; return; }
    this.asking = true;
    do {
      this.again = false;
      const since = this.began;
      try {
        const found = await this.evaluated({});
        if (!this.pane.shown) break;
        this.base ??= found;
        this.show(found);
        this.trouble.textContent = "";
        this.body.dataset.latency = (performance.now() - since).toFixed(1);  // which the benchmark reads
        this.body.dataset.moves = Number(this.body.dataset.moves ?? 0) + 1;
      } catch (fault) {
        if (!this.pane.shown) break;
        this.trouble.textContent = fault.message;
        if (!this.again) this.pane.refresh();
      }
    } while (this.again);
    this.asking = false;
  }

  evaluated(more) {
    return change(this.pane.of("evaluate"), { values: this.values, effects: [...this.on], mode: this.shapes ? this.mode : "", function: this.mode, ...more });
  }

  show(found) {
    const { base, shapes } = this;
    this.found = found;
    const before = new Map(base.rows.map((one) => [one.name, one])), picks = found.kind !== "numbers";
    this.rows.replaceChildren(...found.rows.map((one) => {
      const old = before.get(one.name) ?? {}, cells = found.kind === "frf" ? [] : [one.measured, found.kind === "modes" && one.partner === null ? "not paired" : one.model];
      return h("tr", { class: picks ? "pick" : "", tabIndex: picks ? 0 : -1, "data-name": one.name, "aria-selected": String(one.name === this.mode), onclick: () => this.pick(one.name),
        onkeydown: (event) => { if (event.key === "Enter") this.pick(one.name); } },
      h("th", { scope: "row" }, one.name), cells.map((words) => h("td", {}, words)), h("td", { class: better(one.error, old.error) }, one.error_words), h("td", { class: "soft" }, old.error_words),
      one.mac_words === undefined ? null : [h("td", {}, one.mac_words), h("td", { class: "soft" }, old.mac_words)]);
    }));
    if (found.mac) this.matrix(found);
    if (shapes && found.mode === this.mode) {
      const drawn = shapes.show(this.stage, this.mode, found.motion);
      if (drawn && drawn.parentElement !== this.drawn) this.drawn.replaceChildren(h("h2", {}, "Shape"), drawn);
      shapes.facts.textContent = `${this.mode}, over the measured shape`;
    }
    if (this.chart) this.curve(found);
    this.tell(found);
  }

  tell(found) {
    const on = [...this.on], unit = found.kind === "frf" ? " σ" : "", of = found.kind === "frf" ? "of an FRF" : "of an eigenvalue";
    const within = found.error === undefined || found.error <= found.tolerance;
    this.facts.replaceChildren(...[
      ["error of the fitted data", h("span", {}, h("strong", {}, `${short(found.rms)} σ`), h("span", { class: "soft" }, `, before ${short(this.base.rms)} σ; a correct model has about 1`))],
      ["error of the reduced basis", found.error === undefined ? "none: solved at full order" : h("span", { class: within ? "" : "warn" }, `${found.error.toExponential(1)}${unit} ${of}, tolerance ${found.tolerance.toExponential(0)}${unit}${within ? "" : ": solve at full order"}`)],
    ].flatMap(([what, value]) => [h("dt", {}, what), h("dd", { class: "num" }, value)]));
    const now = JSON.stringify([on, within, Boolean(this.pane.running)]);
    if (this.offered === now && this.offer.firstChild) return;
    this.offered = now;
    const have = this.known.summary !== null;
    this.offer.replaceChildren(...[
      h("button", { type: "button", id: "start", onclick: () => this.start() }, "Start from here"),
      found.error === undefined ? null : h("button", { type: "button", onclick: (event) => this.check(event.target) }, "Check at full order"),
      on.length && have ? h("button", { type: "button", disabled: Boolean(this.pane.running), onclick: () => this.pane.add(on) }, `Add ${on.join(" and ")}`) : null,
      this.undo,
    ].filter(Boolean));
  }

  // The start of a calibration has parameters alone: effects come into a study by Add.
  start() {
    const value = Object.fromEntries(this.ready.parameters.filter((one) => one.free).map((one) => [one.name, Number(this.values[one.name].toPrecision(6))]));
    this.changes.propose({ what: "start", name: "the values of the sliders", value }, this.test);
  }

  async check(button) {
    const { textContent: words } = button;
    Object.assign(button, { disabled: true, textContent: "Solving at full order …" });
    try {
      const full = await this.evaluated({ full: true }), own = new Map(this.found.rows.map((one) => [one.name, one.error]));
      const most = Math.max(...full.rows.map((one) => Math.abs(one.error - own.get(one.name))));
      tell(`At full order the error is ${short(full.rms)} σ; the largest difference ${full.kind === "modes" ? `of a frequency is ${short(100 * most)} %` : `is ${short(most)} σ`}.`);
    } catch (fault) {
      tell(fault.message, "bad");
    }
    Object.assign(button, { disabled: false, textContent: words });
  }

  pick(name) {
    this.mode = name;
    this.ask(performance.now());
    this.pane.picked({ mode: name });
  }

  // A parameter was moved, or a mode picked, beside this study.
  follow({ parameter, value, mode }) {
    if (!this.ready) return;
    if (this.found?.rows.some((one) => one.name === mode)) this.mode = mode;
    else if (this.ready.parameters.some((one) => one.name === parameter)) this.values[parameter] = value;
    else return;
    this.write();
    this.ask(performance.now());
  }

  matrix(found) {
    const shape = `${found.rows.length}x${found.model.length}`;
    if (this.mac.dataset.shape !== shape) {
      this.mac.dataset.shape = shape;
      this.heads = found.model.map(() => h("span", { class: "at" }));
      this.cells = found.mac.map((row) => row.map(() => h("span", { class: "cell" })));
      this.mac.replaceChildren(
        h("thead", {}, h("tr", {}, h("th", {}), this.heads.map((own, k) => h("th", { scope: "col" }, String(k + 1), own)))),
        h("tbody", {}, this.cells.map((row, k) => h("tr", {}, h("th", { scope: "row" }, found.rows[k].name), row.map((cell) => h("td", {}, cell))))));
    }
    found.model.forEach((freq, k) => { this.heads[k].textContent = freq; });
    found.mac.forEach((row, k) => row.forEach((value, j) => {
      const cell = this.cells[k][j];
      cell.style.setProperty("--mac", value ?? 0);
      cell.className = `cell${shade(value)}${found.rows[k].partner === j + 1 ? " paired" : ""}`;
      cell.textContent = value >= 0.095 ? value.toFixed(2).replace(/^0/, "") : "";
    }));
  }

  curve(found) {
    const known = this.ready.frfs.find((one) => one.name === found.function);
    this.chart.yWords = `amplitude, ${known.unit}`;
    const points = (values) => known.freq.map((freq, k) => [freq, values[k]]);
    this.chart.show([{ name: "measured", colour: "--ink", points: points(known.measured), dashed: true }, { name: "model", colour: "--c0", points: points(found.curve) }],
      `Amplitude of ${found.function}: measured, dashed, and model`);
  }

  themed() {
    this.chart?.draw();
  }
}

function better(now, before) {
  const change = Math.abs(now) - Math.abs(before);
  return !(Math.abs(change) > 1e-4 * Math.abs(before)) ? "" : change < 0 ? "good" : "warn";
}

function short(value) {
  return value === null ? "unknown" : String(Number(value.toPrecision(4)));
}
