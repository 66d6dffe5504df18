// Parameters on the model: where each acts, its limits, its prior and its fitted value, and how well it is identified.
import { afterFailure } from "./app.js";
import { ask, figure, h, panel, s } from "./dom.js";
import { viewer } from "./space.js";

const WORDS = { parameters: "Fitted values between the limits", profiles: "Profile likelihood of each parameter", posterior_correlation: "Posterior correlation",
  selection: "Which parameters matter", sensitivity: "Sensitivity of the responses" };

export class Parameters {
  constructor(pane, place) {
    Object.assign(this, { pane, place, results: null, picked: "", seen: "" });
    this.failed = h("div", {});
    this.body = h("div", { class: "stack" });
    place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body));
  }

  async look(live) {
    if (!this.known || live?.results !== this.results) {
      const [known, found] = await Promise.all([ask(this.pane.of("")), ask(this.pane.of("parameters"))]);
      if (!this.pane.shown) return;
      this.results = live?.results ?? null;
      Object.assign(this, { known, found: found.parameters });
      this.pane.knows(known);
    }
    this.failed.replaceChildren(afterFailure(this.pane) ?? "");
    const now = JSON.stringify([this.found, Boolean(this.pane.running)]);
    if (now === this.seen) return;
    this.seen = now;
    if (this.found) this.fill(); else this.empty();
  }

  fill() {
    const { found, pane } = this, fitted = found.rows.some((one) => one.value !== null);
    this.picked = found.rows.some((one) => one.name === this.picked) ? this.picked : found.rows[0]?.name ?? "";
    this.detail = h("div", {});
    this.space = found.layers.length ? viewer({ ...found.scene, stages: [], layers: found.layers }) : null;
    const head = ["parameter", "limits, prior and fitted value", "nominal", fitted ? "fitted" : "prior sd", fitted ? "identified" : "selected"];
    this.rows = h("tbody", {}, found.rows.map((one) => h("tr", { class: "pick", tabIndex: 0, "data-name": one.name, "aria-selected": String(one.name === this.picked),
      onclick: () => this.choose(one.name), onkeydown: (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); this.choose(one.name); } } },
    h("th", { scope: "row" }, one.name), h("td", { class: "scale" }, scale(one)), h("td", {}, one.nominal_words), h("td", {}, fitted ? one.value_words : one.prior_words), h("td", {}, mark(fitted ? one.identified : one.selected)))));
    this.body.replaceChildren(h("div", { class: "grid search rows" },
      h("div", { class: "stack" },
        panel(found.case ? `Parameters, fitted in case ${found.case}` : "Parameters",
          h("div", { class: "wide" }, h("table", { class: "parameters" }, h("thead", {}, h("tr", {}, head.map((words) => h("th", { scope: "col" }, words)))), this.rows)),
          h("ul", { class: "legend" }, h("li", { class: "soft" }, h("i", { class: "band" }), "prior ± 1 sd"), h("li", { class: "soft" }, h("i", { class: "tick" }), "nominal"),
            fitted ? h("li", { class: "soft" }, h("i", { class: "dot" }), "fitted, with its 95 % interval") : null),
          fitted ? null : h("div", { class: "act" }, pane.button("calibrate", "Calibrate", "main"), pane.quickly())),
        found.figures.slice(0, 1).map((name) => this.drawn(name))),
      h("div", { class: "stack" }, this.detail, this.space ? h("section", { class: "panel", id: "space" }, h("h2", {}, "Where it acts"), this.space) : null)),
    h("div", { class: "grid even" }, found.figures.slice(1).map((name) => this.drawn(name)), this.others(fitted)));
    this.pick(this.picked);
  }

  // What else can be known of the parameters, with the command for it.
  others(fitted) {
    return this.known.analyses.filter((one) => one.state !== "done" && (one.verb === "sensitivity" || (one.verb === "intervals" && fitted))).map((one) =>
      panel(one.title, h("p", { class: "soft" }, one.stale || `Not run: ${one.what}.`), h("div", { class: "act" }, this.pane.button(one.verb, `Run calib ${one.verb}`), this.pane.quickly())));
  }

  drawn(name) {
    return panel(WORDS[name], figure(this.pane.of(`figure/${name}`), name, WORDS[name]));
  }

  choose(name) {
    this.pick(name);
    this.pane.picked({ parameter: name });
  }

  // A parameter was picked beside this study.
  follow({ parameter }) {
    if (this.found?.rows.some((one) => one.name === parameter)) this.pick(parameter);
  }

  pick(name) {
    const { found } = this, one = found.rows.find((row) => row.name === name);
    this.picked = name;
    for (const row of this.rows.children) row.setAttribute("aria-selected", String(row.dataset.name === name));
    if (!one) return;
    const rows = [["what it is", one.description], ["source", one.source], ["search limits", `${one.limits} ${one.unit === "-" ? "" : one.unit}`], ["prior", `${one.nominal_words} ± ${one.prior_words}`],
      ["fitted", one.value === null ? "" : `${one.value_words} ± ${one.std_words}`], ["shift from the prior", one.pull ? `${one.pull} times its expected deviation${one.pulled ? ": beyond its limit" : ""}` : ""],
      ["correlated with", one.partners.join(", ")], ["verdict", one.sentence], ["sensitivity", one.why]];
    this.detail.replaceChildren(h("section", { class: "panel", id: "parameter" }, h("h2", {}, one.name),
      h("dl", { class: "pairs" }, rows.filter(([, value]) => value).flatMap(([what, value]) => [h("dt", {}, what), h("dd", { class: "num" }, value)]))));
    const choice = this.space?.querySelector("select.layer");
    if (!choice) return;
    const known = [...choice.options].some((option) => option.value === name);
    this.space.parentElement.querySelector("h2").textContent = known ? "Where it acts" : `Where parameters act (${name} has no place of its own)`;
    if (known && choice.value !== name) {
      choice.value = name;
      choice.dispatchEvent(new Event("change"));
    }
  }

  empty() {
    this.body.replaceChildren(h("section", { class: "panel empty" },
      h("h2", {}, "The parameters are not listed yet"),
      h("p", {}, "The first analysis writes every parameter with its limits, its prior and its place on the model; a comparison takes seconds."),
      h("div", { class: "act" }, this.pane.button("compare", "Compare", "main"))));
  }
}

function mark(value) {
  if (value === null) return h("span", { class: "soft" }, "–");
  return h("span", { class: value ? "good" : "warn" }, value ? "● yes" : "○ no");
}

// The search limits from end to end; within them the prior, the nominal value, and the fitted value with its interval.
function scale(one) {
  const drawn = s("svg", { viewBox: "0 0 200 16", class: "range", role: "img", "aria-label": `${one.limits}; nominal ${one.nominal_words}${one.value === null ? "" : `; fitted ${one.value_words}`}` });
  if (one.lower === null || one.upper === null || one.upper <= one.lower) return drawn;
  const x = (value) => 4 + 192 * Math.max(0, Math.min(1, (value - one.lower) / (one.upper - one.lower)));
  drawn.append(s("line", { x1: 4, x2: 196, y1: 8, y2: 8, class: "axis" }));
  if (one.prior_sd !== null) {
    const [a, b] = [x(one.nominal - one.prior_sd), x(one.nominal + one.prior_sd)];
    drawn.append(s("rect", { x: a, width: Math.max(1, b - a), y: 3, height: 10, class: "prior" }));
  }
  drawn.append(s("line", { x1: x(one.nominal), x2: x(one.nominal), y1: 1, y2: 15, class: "nominal" }));
  if (one.value !== null) {
    if (one.low !== null) drawn.append(s("line", { x1: x(one.low), x2: x(one.high), y1: 8, y2: 8, class: "interval" }));
    drawn.append(s("circle", { cx: x(one.value), cy: 8, r: 4, class: "value" }));
  }
  return drawn;
}
