// The searches as they run: curves of all cases, and the best design's errors as they fall.
import { afterFailure, bar } from "./app.js";
import { Chart, COLOURS } from "./chart.js";
import { ask, change, figure, h, lasting, panel, table } from "./dom.js";
import { Shapes } from "./shapes.js";

const WAIT = 1000;  // milliseconds between two looks while the model is read

export class Search {
  constructor(pane, place) {
    Object.assign(this, { pane, place, cases: new Map(), last: 0, seen: "", live: null, stamp: null });
    this.chart = new Chart("Misfit over the generations", "generation", "misfit");
    this.head = h("div", {});
    this.legend = h("ul", { class: "legend" });
    this.counts = h("div", {});
    this.best = h("div", {});
    this.worst = h("section", { class: "panel", id: "worst", hidden: true });
    this.after = h("div", { class: "stack" });
    this.failed = h("div", {});
    this.body = h("div", { class: "grid search" },
      h("div", { class: "stack" }, panel("", this.head, this.chart.element, this.legend), this.after),
      h("div", { class: "stack" }, panel("Cases", this.counts), panel("Best design so far", this.best), this.worst));
    this.ticking = setInterval(() => this.clock(), 1000);
  }

  close() {
    clearInterval(this.ticking);
    this.shapes?.close();
  }

  async look(live) {
    if (!this.pane.known || this.results !== live?.results) {
      this.pane.knows(await ask(this.pane.of("")));
      this.results = live?.results;
    }
    if (!live || live.search !== this.stamp || !this.found) {
      this.stamp = live?.search ?? null;
      const found = await ask(this.pane.of("search", { since: this.last }));
      if (!this.pane.shown) return;
      this.take(found);
    }
    this.draw();
  }

  // Join the generations that came since to those that are known.
  take(found) {
    const names = new Set(found.cases.map((one) => one.name));
    for (const name of [...this.cases.keys()]) if (!names.has(name)) this.cases.delete(name);
    let lost = false;
    for (const one of found.cases) {
      const known = this.cases.get(one.name)?.generations ?? [];
      const first = one.generations[0]?.[0] ?? Infinity;
      const generations = [...known.filter(([generation]) => generation < first), ...one.generations];
      lost ||= generations.length && one.generation !== generations.at(-1)[0] || !known.length && this.last > 0 && first > 1;
      this.cases.set(one.name, { ...one, generations });
    }
    this.found = found;
    this.last = found.last;
    if (lost) { this.last = 0; this.stamp = null; this.cases.clear(); }
  }

  draw() {
    const { pane, found } = this, run = pane.running;
    this.failed.replaceChildren(afterFailure(pane) ?? "");
    if (!found.cases.length && !run) {
      this.place.replaceChildren(this.failed, this.empty());
      return;
    }
    if (!this.body.isConnected) this.place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body));
    const cases = [...this.cases.values()];
    const series = cases.flatMap((one, k) => [
      { name: `${one.case} best`, colour: COLOURS[k % COLOURS.length], points: one.generations.map(([x, y]) => [x, y]) },
      { name: `${one.case} mean`, colour: COLOURS[k % COLOURS.length], points: one.generations.map(([x, , y]) => [x, y]), dashed: true },
    ]);
    this.chart.show(series, cases.length ? `Misfit over the generations: ${cases.map((one) => `${one.case} at ${one.best} in generation ${one.generation}`).join("; ")}` : "No generation yet");
    this.chart.element.hidden = !cases.length;
    this.legend.replaceChildren(...cases.map((one, k) => h("li", {}, h("i", { style: { "border-color": `var(${COLOURS[k % COLOURS.length]})` } }), `${one.case}: ${one.best}`)),
      cases.length ? h("li", { class: "soft" }, h("i", { class: "dashed" }), "mean of the generation") : "");
    this.counts.replaceChildren(cases.length ? table(["case", "generation", "best misfit", "designs", "failed", "infeasible"], cases.map((one) =>
      h("tr", {}, h("th", { scope: "row" }, one.case), ...[one.generation, one.best, one.individuals, one.failed, one.infeasible].map((value) => h("td", {}, String(value)))))) :
      h("p", { class: "soft" }, "The first generation has not ended yet."),
    h("p", { class: "soft small" }, `${found.evaluations.toLocaleString("en")} evaluations stored${found.earlier ? `; ${found.earlier} searches of earlier states are not shown` : ""}.`));
    this.errors(found.best);
    this.worst.hidden = !found.best?.worst;
    if (!this.worst.hidden && !this.worst.firstChild) {
      this.worst.replaceChildren(h("h2", {}, "Worst mode of the best design"), h("div", { class: "act" },
        h("button", { type: "button", onclick: () => { this.watched = true; this.shape(); } }, "Show its shape"), h("span", { class: "soft small" }, "It follows the search; reading the model takes seconds.")));
    }
    this.shape();
    this.clock();
    this.figures(found.calibrated && !run);
  }

  clock() {
    const run = this.pane.running, since = run ? Date.now() / 1000 - run.began : 0;
    const now = JSON.stringify([run?.words, run?.left, run?.stopping, Math.round(since)]);
    if (now === this.seen) return;
    this.seen = now;
    this.head.replaceChildren(h("div", { class: "head" }, run ? [
      h("h2", {}, phase(run)), bar(run.done, run.total), h("span", { class: "grow" }),
      h("span", { class: "soft num", id: "left" }, `${lasting(since)} so far${run.left ? `, ${run.left} left` : ""}`),
      h("button", { type: "button", class: "stop", disabled: run.stopping, onclick: () => this.pane.stop(run.pid) }, run.stopping ? "Stopping …" : "Stop"),
    ] : [h("h2", {}, "Search"), h("span", { class: "grow" }), this.pane.quickly(), this.pane.button("calibrate", "Calibrate again")]));
  }

  errors(best) {
    if (!best || !best.rows.length) {
      this.best.replaceChildren(h("p", { class: "soft" }, best ? `Misfit ${best.misfit}, ${best.case}.` : "None yet."));
      return;
    }
    const both = (was, is) => h("td", {}, h("span", { class: "was" }, `${was} → `), is);
    this.best.replaceChildren(table([{ title: "mode", words: true }, "measured, Hz", "model, Hz", "error, %", "MAC"], best.rows.map((row) =>
      h("tr", {}, h("th", { scope: "row" }, row.mode), h("td", {}, row.measured), h("td", {}, row.model), both(row.error_before, row.error), both(row.mac_before, row.mac)))),
    h("p", { class: "soft small" }, `Nominal → best design, of ${best.case}, misfit ${best.misfit}, as the search computes it; least squares refine it afterwards.`));
  }

  // The worst mode's shape beside the measured one, from the model of "What if": on request, since it is read first.
  async shape() {
    const { best } = this.found, now = JSON.stringify([best?.values, best?.worst]);
    if (!this.watched || this.drawing || !best?.worst || this.drawn === now) return;
    this.drawing = true;
    const say = (words) => this.worst.replaceChildren(h("h2", {}, "Worst mode of the best design"), h("p", { class: "soft", role: "status" }, words));
    try {
      const state = await ask(this.pane.of("what-if"));
      if (state.fault) throw new Error(state.fault);
      if (state.ready) {
        this.scene ??= (await ask(this.pane.of("scene"))).scene;
        const stage = this.scene?.stages.find((one) => one.modes.length)?.name.split(" ")[0];
        const found = await change(this.pane.of("evaluate"), { values: best.values, effects: [], mode: best.worst });
        if (!this.pane.shown) return;
        this.shapes ??= stage ? new Shapes(this.scene) : null;
        const shape = this.shapes?.show(stage, best.worst, found.motion), row = found.rows.find((one) => one.name === best.worst);
        if (shape && shape.parentElement !== this.worst) this.worst.replaceChildren(h("h2", {}, "Worst mode of the best design"), shape);
        if (shape) this.shapes.facts.textContent = `${best.worst}: MAC ${row.mac_words}, frequency ${row.error_words} %`; else say("There is no geometry to draw the shapes on.");
        this.drawn = now;
      } else {
        say(`${state.stage} …`);
        setTimeout(() => { if (this.pane.shown) this.shape(); }, WAIT);
      }
    } catch (fault) {
      say(fault.message);
      this.drawn = now;
    }
    this.drawing = false;
  }

  figures(done) {
    const key = done ? `${this.results}` : "";
    if (this.after.dataset.of === key) return;
    this.after.dataset.of = key;
    this.after.replaceChildren(...(done ? [
      panel("Where the cases ended", figure(this.pane.of("figure/searches"), "searches", "Where the search of every case ended, between the limits")),
    ] : []));
  }

  empty() {
    return h("section", { class: "panel empty" },
      h("h2", {}, "No search has been run"),
      h("p", {}, "A calibration searches the parameters in several independent cases and refines each by least squares. Its curves appear here while it runs, also where a terminal has started it."),
      h("div", { class: "act" }, this.pane.button("calibrate", "Calibrate", "main"), this.pane.quickly()));
  }

  themed() {
    this.chart.draw();
  }
}

// The phase of a command, in words.
function phase(run) {
  return run.stage ? `${run.stage[0].toUpperCase()}${run.stage.slice(1)}` : run.words || run.verb;
}
