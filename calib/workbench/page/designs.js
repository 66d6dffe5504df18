// Every evaluated design: parallel coordinates, a cloud, correlations and a table, with one selection over all of them.
import { afterFailure } from "./app.js";
import { Changes } from "./changes.js";
import { ask, figure, h, panel, shade } from "./dom.js";

const LINES = 3000;  // designs that are drawn over parallel axes, the best first
const DOTS = 20000;  // in the cloud
const ROWS = 25;  // in the table
const ROOM = 34;  // pixels about the axes

export class Designs {
  constructor(pane, place) {
    Object.assign(this, { pane, place, filters: new Map(), picked: 0, x: "", y: "" });
    this.failed = h("div", {});
    this.body = h("div", { class: "stack", id: "designs" });
    this.changes = new Changes(pane, () => pane.refresh());
    this.further = h("div", { class: "grid even", id: "further" });
    place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body, this.further));
  }

  close() {
    this.sizes?.disconnect();
  }

  async look(live) {
    this.failed.replaceChildren(afterFailure(this.pane) ?? "");
    const changed = !this.known || live?.results !== this.results;
    if (changed) {
      this.known = await ask(this.pane.of(""));
      if (!this.pane.shown) return;
      this.results = live?.results ?? null;
      this.pane.knows(this.known);
    }
    const now = JSON.stringify([this.known.further, this.known.analyses, Boolean(this.pane.running)]);
    if (now !== this.seen) this.further.replaceChildren(...this.known.further.map((one) => this.analysis(one)));
    this.seen = now;
    if (changed) await this.read("");
  }

  // An analysis of the designs: its figure and answer, or what to run for it.
  analysis(one) {
    const { pane, known } = this, first = known.analyses.find((own) => own.verb === one.after && own.state !== "done"), { verb } = first ?? one;
    return panel(one.title, one.figure ? figure(pane.of(`figure/${one.figure}`), one.figure, one.caption) : null,
      h("p", { class: one.found ? "" : "soft" }, one.stale || one.found || `Not run: ${one.what}.`), one.then && one.found ? h("p", { class: "soft" }, one.then) : null,
      h("div", { class: "act" }, pane.button(verb, first ? `Run calib ${verb} first` : one.state === "never" ? `Run calib ${verb}` : "Again"), pane.quickly()));
  }

  // Read on request alone while a search runs: the table of a large ledger takes seconds.
  async read(evaluated) {
    if (!this.found) this.body.replaceChildren(h("p", { class: "soft" }, "Reading the designs …"));
    try {
      this.take(await ask(this.pane.of("designs", { evaluated })));
    } catch (fault) {
      if (this.pane.shown) this.empty(fault.message);
    }
  }

  take(found) {
    if (!this.pane.shown) return;
    this.found = { ...found, cases: found.cases.map((name) => (name === "other" ? "samples and others" : name)), design: numbers(found.design), case: numbers(found.case), status: numbers(found.status) };
    this.columns = found.columns.map((one) => {
      const values = numbers(one.numbers), on = one.log ? Math.log10 : (value) => value;
      let [low, high] = [Infinity, -Infinity];
      for (const value of values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
      if (!(high > low)) { low = (Number.isFinite(low) ? low : 0) - 0.5; high = low + 1; }
      return { ...one, values, low, high, share: (value) => (on(value) - on(low)) / (on(high) - on(low)), value: (share) => (one.log ? 10 ** (on(low) + share * (on(high) - on(low))) : low + share * (high - low)) };
    });
    this.by = new Map(this.columns.map((one) => [one.name, one]));
    this.axes = this.columns.filter((one) => one.input || !/[ _](natural_freq|mac)_|^mac_/.test(one.name));
    this.filters = new Map([...this.filters].filter(([name]) => this.by.has(name)));
    this.x = this.by.has(this.x) ? this.x : this.columns[0].name;
    this.y = this.by.has(this.y) ? this.y : "objective";
    this.fill();
  }

  column(name) {
    return this.by.get(name);
  }

  // -- the selection -------------------------------------------------------------------------------------------------

  select() {
    const limits = [...this.filters].map(([name, [low, high]]) => [this.column(name).values, low, high]), { found } = this;
    this.chosen = [];
    for (let k = 0; k < found.count; k += 1) {
      if (limits.every(([values, low, high]) => values[k] >= low && values[k] <= high) && (this.only === undefined || found.case[k] === this.only)) this.chosen.push(k);
    }
  }

  filter(name, low, high) {
    if (low === null) this.filters.delete(name); else this.filters.set(name, [low, high]);
    this.draw();
  }

  pick(k) {
    this.picked = k;
    this.draw();
  }

  // -- the view ------------------------------------------------------------------------------------------------------

  fill() {
    const { found } = this;
    this.words = h("p", { role: "status", id: "chosen" });
    this.chips = h("div", { class: "act" });
    this.parallel = h("canvas", { role: "img", tabIndex: 0, "aria-label": "Designs over parallel axes" });
    this.cloud = h("canvas", { role: "img", "aria-label": "Cloud of designs" });
    this.rows = h("tbody", {});
    this.matrix = h("table", { class: "mac small", id: "correlations" });
    const choice = (which) => h("label", {}, `${which} `, h("select", { "aria-label": `axis ${which}`, onchange: (event) => { this[which] = event.target.value; this.draw(); } },
      this.columns.map((one) => h("option", { value: one.name, selected: one.name === this[which] }, one.name))));
    const cases = h("select", { "aria-label": "case", onchange: (event) => { this.only = event.target.value === "" ? undefined : Number(event.target.value); this.draw(); } },
      h("option", { value: "" }, "all cases"), found.cases.map((name, k) => h("option", { value: k }, name)));
    this.selects = { x: choice("x"), y: choice("y") };
    const edge = (side) => h("input", { type: "number", step: "any", "aria-label": side, placeholder: side });
    const of = h("select", { "aria-label": "column of the filter" }, this.columns.map((one) => h("option", { value: one.name }, one.name))), [low, high] = [edge("from"), edge("to")];
    const narrow = () => this.filter(of.value, low.value === "" ? -Infinity : Number(low.value), high.value === "" ? Infinity : Number(high.value));
    this.body.replaceChildren(
      h("section", { class: "panel" },
        h("div", { class: "head" }, this.words, h("span", { class: "grow" }), cases, h("button", { type: "button", onclick: () => this.read(String(Date.now())) }, "Read again")),
        h("div", { class: "plane tall" }, this.parallel),
        h("p", { class: "soft small" }, "Drag along an axis to keep a range, in all pictures and in the table; a click on the axis drops it. The darker a line, the smaller the objective."),
        h("div", { class: "act" }, of, low, high, h("button", { type: "button", onclick: narrow }, "Filter"), this.chips)),
      h("div", { class: "grid even" },
        h("section", { class: "panel" }, h("div", { class: "head" }, h("h2", {}, "Cloud"), h("span", { class: "grow" }), this.selects.x, this.selects.y),
          h("div", { class: "plane" }, this.cloud), h("p", { class: "soft small" }, "Drag a rectangle to keep what is in it; a click picks a design.")),
        panel("Correlation of the designs that are kept", h("div", { class: "wide" }, this.matrix), h("p", { class: "soft small" }, "Linear; a click shows the cloud of two columns. Blue: together, orange: against each other."))),
      h("section", { class: "panel" }, h("h2", {}, "Best designs that are kept"), h("div", { class: "wide" }, h("table", { id: "table" }, h("thead", {}, h("tr", {}, ["design", "case", ...this.axes.map((one) => one.name), ""].map((name) => h("th", { scope: "col" }, name)))), this.rows)), this.changes.element));
    this.listen();
    this.sizes?.disconnect();
    this.sizes = new ResizeObserver(() => this.drawn && this.paint());
    this.sizes.observe(this.parallel.parentElement);
    this.draw();
  }

  draw() {
    this.select();
    const { found, chosen, filters } = this;
    this.words.textContent = `${chosen.length} of ${found.count} designs kept${chosen.length > LINES ? `; the best ${LINES} are drawn as lines` : ""}`;
    this.chips.replaceChildren(...[...filters].map(([name, [low, high]]) => h("button", { type: "button", title: "Drop this filter", onclick: () => this.filter(name, null) }, `${name} ${short(low)} to ${short(high)} ×`)));
    for (const which of ["x", "y"]) this.selects[which].lastChild.value = this[which];
    this.fillMatrix();
    this.fillTable();
    this.drawn = true;
    this.paint();
  }

  paint() {
    this.paintParallel();
    this.paintCloud();
  }

  fillTable() {
    const { found } = this, rows = this.chosen.slice(0, ROWS);
    if (!rows.includes(this.picked) && this.picked < found.count) rows.push(this.picked);
    this.rows.replaceChildren(...rows.map((k) => h("tr", { class: "pick", tabIndex: 0, "data-design": found.design[k], "aria-selected": String(k === this.picked), onclick: () => this.pick(k), onkeydown: (event) => { if (event.key === "Enter") this.pick(k); } },
      h("th", { scope: "row" }, String(found.design[k])), h("td", {}, found.cases[found.case[k]]), this.axes.map((one) => h("td", {}, found.status[k] && !one.input ? "failed" : short(one.values[k]))),
      h("td", {}, k === this.picked ? h("button", { type: "button", id: "begin", onclick: () => this.changes.propose({ what: "start", name: "a design", value: found.design[k] }, this.pane.test) }, "Start from here") : null))));
  }

  fillMatrix() {
    const inputs = this.columns.filter((one) => one.input), outputs = this.columns.filter((one) => !one.input);
    this.matrix.replaceChildren(
      h("thead", {}, h("tr", {}, h("th", {}), outputs.map((one) => h("th", { scope: "col" }, h("span", { class: "tilt" }, one.name.replace(/^error /, "")))))),
      h("tbody", {}, inputs.map((row) => h("tr", {}, h("th", { scope: "row" }, row.name), outputs.map((column) => {
        const r = correlation(row, column, this.chosen);
        return h("td", {}, h("button", { type: "button", class: `cell${shade(Math.abs(r), r < 0)}`, style: { "--mac": Math.abs(r || 0) }, "aria-pressed": String(this.x === row.name && this.y === column.name),
          title: `${row.name} and ${column.name}: ${Number.isFinite(r) ? r.toFixed(2) : "unknown"}`, "aria-label": `${row.name} and ${column.name}: ${Number.isFinite(r) ? r.toFixed(2) : "unknown"}`,
          onclick: () => { this.x = row.name; this.y = column.name; this.draw(); } }, Math.abs(r) >= 0.095 ? r.toFixed(1).replace("0.", ".") : ""));
      })))));
  }

  // -- pictures ------------------------------------------------------------------------------------------------------

  paintParallel() {
    const { pen, wide, high, colour } = canvas(this.parallel), { axes, chosen } = this;
    if (!wide) return;
    const gap = (wide - 2 * ROOM) / Math.max(1, axes.length - 1), top = 44, bottom = high - 20;
    this.spots = { gap, top, bottom };
    const y = (one, k) => bottom - one.share(one.values[k]) * (bottom - top);
    const line = (k) => {
      pen.beginPath();
      let down = false;
      axes.forEach((one, j) => {
        const at = y(one, k);
        if (!Number.isFinite(at)) { down = false; return; }
        if (down) pen.lineTo(ROOM + j * gap, at); else pen.moveTo(ROOM + j * gap, at);
        down = true;
      });
      pen.stroke();
    };
    const many = Math.min(chosen.length, LINES);
    pen.strokeStyle = colour("--c0");
    for (let n = many - 1; n >= 0; n -= 1) {
      pen.globalAlpha = Math.max(0.06, (many > 400 ? 0.35 : 0.7) * (1 - n / many));
      line(chosen[n]);
    }
    pen.globalAlpha = 1;
    pen.lineWidth = 2.5;
    pen.strokeStyle = colour("--c5");
    line(this.picked);
    pen.lineWidth = 1;
    pen.textAlign = "center";
    axes.forEach((one, j) => {
      const x = ROOM + j * gap, kept = this.filters.get(one.name);
      pen.strokeStyle = pen.fillStyle = colour("--soft");
      pen.strokeRect(x, top, 0.01, bottom - top);
      pen.fillText(short(one.high), x, top - 6);
      pen.fillText(short(one.low), x, high - 6);
      pen.fillStyle = colour("--ink");
      pen.fillText(one.name, Math.min(Math.max(x, pen.measureText(one.name).width / 2), wide - pen.measureText(one.name).width / 2), j % 2 ? 24 : 11);
      if (!kept) return;
      const [a, b] = kept.map((value) => bottom - Math.max(0, Math.min(1, one.share(value))) * (bottom - top));
      pen.globalAlpha = 0.35;
      pen.fillStyle = colour("--c5");
      pen.fillRect(x - 6, b, 12, Math.max(2, a - b));
      pen.globalAlpha = 1;
    });
  }

  paintCloud() {
    const { pen, wide, high, colour } = canvas(this.cloud), x = this.column(this.x), y = this.column(this.y);
    if (!wide) return;
    const place = (k) => [52 + x.share(x.values[k]) * (wide - 72), high - 36 - y.share(y.values[k]) * (high - 52)];
    this.dot = place;
    pen.strokeStyle = colour("--line");
    pen.strokeRect(52, 16, wide - 72, high - 52);
    const dots = (all) => { for (const k of all) { const [a, b] = place(k); if (Number.isFinite(a) && Number.isFinite(b)) pen.fillRect(a - 1.5, b - 1.5, 3, 3); } };
    pen.fillStyle = colour("--line");
    if (this.chosen.length < this.found.count) dots(Array.from({ length: Math.min(DOTS, this.found.count) }, (_, k) => k));
    pen.fillStyle = colour("--c0");
    pen.globalAlpha = this.chosen.length > 2000 ? 0.25 : 0.6;
    dots(this.chosen.slice(0, DOTS));
    pen.globalAlpha = 1;
    const [a, b] = place(this.picked);
    pen.strokeStyle = colour("--c5");
    pen.lineWidth = 2.5;
    pen.beginPath();
    pen.arc(a, b, 6, 0, 7);
    pen.stroke();
    pen.lineWidth = 1;
    pen.fillStyle = colour("--soft");
    pen.textAlign = "center";
    pen.fillText(`${x.name}${x.unit ? `, ${x.unit}` : ""}`, wide / 2, high - 5);
    pen.fillText(short(x.low), 60, high - 20);
    pen.fillText(short(x.high), wide - 30, high - 20);
    pen.textAlign = "right";
    pen.fillText(short(y.low), 48, high - 38);
    pen.fillText(short(y.high), 48, 24);
    pen.save();
    pen.translate(14, high / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(`${y.name}${y.unit ? `, ${y.unit}` : ""}`, 0, 0);
    pen.restore();
  }

  // -- the mouse -----------------------------------------------------------------------------------------------------

  listen() {
    dragged(this.parallel, (from, to) => {
      const { gap, top, bottom } = this.spots, j = Math.round((from[0] - ROOM) / gap), one = this.axes[j];
      if (!one || Math.abs(ROOM + j * gap - from[0]) > Math.min(24, gap / 2)) return;
      const [a, b] = [from[1], to[1]].map((y) => one.value((bottom - y) / (bottom - top))).sort((p, q) => p - q);
      if (Math.abs(from[1] - to[1]) < 4) this.filter(one.name, null); else this.filter(one.name, a, b);
    });
    dragged(this.cloud, (from, to) => {
      const x = this.column(this.x), y = this.column(this.y), wide = this.cloud.clientWidth, high = this.cloud.clientHeight;
      if (Math.hypot(from[0] - to[0], from[1] - to[1]) < 4) {
        let best = [Infinity, this.picked];
        for (const k of this.chosen) { const [a, b] = this.dot(k), d = Math.hypot(a - to[0], b - to[1]); if (d < best[0]) best = [d, k]; }
        this.pick(best[1]);
        return;
      }
      const [x0, x1] = [from[0], to[0]].map((at) => x.value((at - 52) / (wide - 72))).sort((p, q) => p - q);
      const [y0, y1] = [from[1], to[1]].map((at) => y.value((high - 36 - at) / (high - 52))).sort((p, q) => p - q);
      this.filters.set(x.name, [x0, x1]);
      this.filter(y.name, y0, y1);
    });
  }

  themed() {
    if (this.drawn) this.paint();
  }

  empty(words) {
    const { pane } = this;
    this.found = null;
    this.drawn = false;
    this.body.replaceChildren(h("section", { class: "panel empty" }, h("h2", {}, "There are no designs"), h("p", {}, words),
      h("div", { class: "act" }, pane.button("sensitivity", "Sample the parameters", "main"), pane.button("calibrate", "Calibrate"), pane.quickly())));
  }
}

function numbers(packed) {
  return new Float32Array(Uint8Array.from(atob(packed), (own) => own.charCodeAt(0)).buffer);
}

// Pearson's correlation over some designs, of logarithms where an axis is logarithmic.
function correlation(one, other, rows) {
  let [n, sx, sy, sxx, syy, sxy] = [0, 0, 0, 0, 0, 0];
  for (const k of rows) {
    const x = one.share(one.values[k]), y = other.share(other.values[k]);
    if (!Number.isFinite(x) || !Number.isFinite(y)) continue;
    n += 1; sx += x; sy += y; sxx += x * x; syy += y * y; sxy += x * y;
  }
  const spread = (sxx - sx * sx / n) * (syy - sy * sy / n);
  return n < 4 || !(spread > 1e-18) ? NaN : (sxy - sx * sy / n) / Math.sqrt(spread);
}

function canvas(element) {
  const ratio = devicePixelRatio || 1, { clientWidth: wide, clientHeight: high } = element.parentElement, style = getComputedStyle(document.documentElement);
  element.width = Math.round(wide * ratio);
  element.height = Math.round(high * ratio);
  const pen = element.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = `12px ${getComputedStyle(document.body).fontFamily}`;
  return { pen, wide, high, colour: (name) => style.getPropertyValue(name).trim() };
}

function dragged(element, done) {
  let from = null;
  element.addEventListener("pointerdown", (event) => { from = [event.offsetX, event.offsetY]; element.setPointerCapture(event.pointerId); });
  element.addEventListener("pointerup", (event) => { if (from) done(from, [event.offsetX, event.offsetY]); from = null; });
}

function short(value) {
  return Number.isFinite(value) ? String(Number(value.toPrecision(4))) : value > 0 ? "∞" : value < 0 ? "−∞" : "–";
}
