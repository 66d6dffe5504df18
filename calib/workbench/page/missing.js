// What the model lacks, as a dialogue: ranked effects with their evidence, why, where, what to look for; add one.
import { afterFailure, bar } from "./app.js";
import { ask, figure, h, panel, s, table } from "./dom.js";
import { space } from "./space.js";

const LONGEST = 12;  // effects that are listed unfolded

export class Missing {
  constructor(pane, place) {
    Object.assign(this, { pane, place, seen: "", results: null, picked: "" });
    this.failed = h("div", {});
    this.family = h("div", {});
    this.body = h("div", { class: "stack" });
    this.place.replaceChildren(h("div", { class: "stack" }, this.failed, this.body));
  }

  async look(live) {
    const all = JSON.stringify(Object.entries(this.pane.live.studies).map(([key, one]) => [key, one.results]));
    if (!this.known || live?.results !== this.results) {
      const known = await ask(this.pane.of("missing"));
      if (!this.pane.shown) return;
      this.results = live?.results ?? null;
      this.known = known;
      this.pane.knows(known);
    }
    if (this.all !== all) {
      this.versions = (await ask(this.pane.of("versions"))).versions;
      this.all = all;
    }
    this.draw();
  }

  draw() {
    const { known } = this, found = known.explanation;
    this.failed.replaceChildren(afterFailure(this.pane) ?? "");
    const now = JSON.stringify([found, known.analyses, Boolean(this.pane.running), found && this.has(found.to_add)?.key]);
    if (now !== this.seen) {
      this.seen = now;
      if (!found) this.body.replaceChildren(this.empty());
      else this.fill(found);
    }
    if (found) this.growth();
  }

  fill(found) {
    this.picked = found.effects.some((one) => one.name === this.picked) ? this.picked : found.chosen[0] ?? found.effects[0]?.name ?? "";
    this.ranks = h("ol", { class: "rank", id: "effects" });
    this.detail = h("div", { class: "stack", id: "detail" });
    const kept = this.body.querySelector("#space");
    this.body.replaceChildren(
      h("div", { class: "grid even" }, this.verdict(found), this.family),
      h("div", { class: "grid side" },
        h("div", { class: "stack" }, panel(`Possible causes, ${found.effects.length} tested`, this.ranks), this.faults(found)),
        h("div", { class: "stack" }, this.detail, kept ?? this.inSpace(), this.reason(found), this.further(found))));
    this.list(found);
    this.show(found);
  }

  verdict(found) {
    const { pane } = this, names = found.to_add, named = names.length > 0;
    const words = named ? `Add ${names.join(" and ")}` : "";
    const have = this.has(names);
    return h("section", { class: "panel", id: "verdict" }, h("div", { class: "answer" },
      h("p", {}, h("span", { class: `chip ${named ? "good" : ""}` }, found.words)),
      h("p", { class: "found" }, found.answer.found ?? found.sentences[0]),
      found.answer.sure ? h("p", { class: "soft" }, found.answer.sure) : null,
      found.answer.then ? h("p", {}, h("strong", {}, "Next: "), found.answer.then) : null,
      h("div", { class: "act" },
        named && !have ? h("button", { type: "button", class: "main", id: "add", disabled: Boolean(pane.running), onclick: () => pane.add(names) }, words) : null,
        named && have ? h("a", { class: "button", href: `#/${have.key}/overview` }, `Open the study with ${names.join(" and ")}`) : null,
        named && !have ? h("span", { class: "soft small" }, `Writes an extended study among the results and calibrates it${this.calibrated ? "" : ", after this study, so that you see how far the errors fall"}; this study stays as it is.`) : null,
        found.composed ? pane.button("propose", "Compose effects that nobody listed") : null),
      h("details", {}, h("summary", { class: "soft" }, "Every sentence of the explanation"), h("div", { class: "stack" },
        [...found.sentences, ...found.notes].map((words) => h("p", { class: "small" }, words))))));
  }

  // The version of this study that has these effects.
  has(names) {
    const own = (this.versions ?? []).find((one) => one.key === this.pane.key);
    const all = JSON.stringify([...(own?.effects ?? []), ...names].sort());
    return (this.versions ?? []).find((one) => one.key !== this.pane.key && JSON.stringify([...one.effects].sort()) === all && one.errors.length);
  }

  list(found) {
    const most = Math.max(...found.effects.map((one) => one.bar), 1);
    const entry = (one) => h("li", { class: one.unseen ? "unseen" : "" }, h("button", { type: "button", "aria-pressed": String(one.name === this.picked), onclick: () => {
      this.picked = one.name;
      for (const own of this.ranks.querySelectorAll("button")) own.setAttribute("aria-pressed", String(own.dataset.name === one.name));
      this.show(found);
    }, "data-name": one.name },
    h("span", { class: "name" }, one.title),
    one.credible ? h("span", { class: "chip good" }, one.probability) : h("span", { class: "soft num" }, one.unseen ? "not visible" : one.probability),
    h("span", { class: "evidence num" }, h("span", { class: "meter", "aria-hidden": "true" }, h("i", { style: { width: `${Math.max(0, 100 * one.bar / most)}%` } })),
      h("span", {}, `evidence ${one.evidence}`))));
    const first = found.effects.slice(0, LONGEST), rest = found.effects.slice(LONGEST);
    this.ranks.replaceChildren(...first.map(entry), rest.length ? h("li", {}, h("details", {}, h("summary", { class: "soft" }, `${rest.length} more`), h("ol", { class: "rank" }, rest.map(entry)))) : "");
  }

  show(found) {
    const one = found.effects.find(({ name }) => name === this.picked), { pane } = this;
    if (!one) { this.detail.replaceChildren(); return; }
    const chosen = found.chosen.includes(one.name);
    const rows = [["evidence (log Bayes factor)", one.evidence], ["probability in the list", one.probability], ["score z", one.z], ["magnitude (95 %)", one.magnitude],
      ["smallest visible", one.least], ["not explained by parameters", one.absorbed], ["the model without it", one.lacks], ["what to look for", one.look_for],
      ["acts at", one.acts && `${one.acts}. ${found.axes}`], ["remark", one.remark]];
    this.detail.replaceChildren(h("section", { class: "panel" },
      h("div", { class: "head" }, h("h2", {}, one.title), chosen ? h("span", { class: "chip good" }, "named") : null, h("span", { class: "grow" }),
        !found.to_add.includes(one.name) ? h("button", { type: "button", disabled: Boolean(pane.running), onclick: () => pane.add([one.name]) }, `Try it: add ${one.name}`) : null),
      h("dl", { class: "pairs" }, rows.filter(([, value]) => value).flatMap(([what, value]) => [h("dt", {}, what), h("dd", { class: "num" }, value)])),
      found.shown.includes(one.name) ? null : h("p", { class: "soft small" }, "Its change pattern is not drawn: the figure compares that of a cause found, or of a close candidate, with the residual.")));
  }

  reason(found) {
    if (!found.shown.length) return null;
    return panel("Why: the residual beside the change pattern", figure(this.pane.of("figure/why_this_effect"), "why_this_effect",
      `Residual and change pattern, mode by mode and sensor by sensor, in standard deviations. ${found.why.join(". ")}.`));
  }

  // What would narrow the answer most.
  further(found) {
    if (!found.measurements.length) return null;
    return panel("What to measure next", h("p", { class: "soft" }, "Computed with the model, averaged over what is not known of parameters and magnitudes; the ranges hold in 8 of 10 cases."),
      table([{ title: "measurement", words: true }, { title: "for", words: true }, "score", "range"], found.measurements.map((one) => h("tr", {},
        h("th", { scope: "row", class: "words", style: { "white-space": "normal" } }, one.what), h("td", { class: "words" }, one.effect), h("td", {}, one.gain), h("td", { class: "soft" }, one.range)))));
  }

  inSpace() {
    const place = h("section", { class: "panel", id: "space" }, h("h2", {}, "Where it sits"), h("p", { class: "soft" }, "Reading …"));
    space(this.pane.of("scene"), "effects").then((drawn) => {
      if (drawn) place.replaceChildren(h("h2", {}, "Where it sits"), drawn);
      else place.remove();
    }).catch((fault) => place.replaceChildren(h("h2", {}, "Where it sits"), h("p", { class: "soft" }, fault.message)));
    return place;
  }

  faults(found) {
    const parts = [];
    if (found.faults.length) parts.push(panel("Errors of the measurement", h("p", { class: "soft" }, found.faults_words),
      table([{ title: "what it would be", words: true }, "score", "limit"], found.faults.map((one) => h("tr", {}, h("th", { scope: "row", class: "words", style: { "white-space": "normal" } }, one.told),
        h("td", { class: one.beyond ? "warn" : "" }, one.score), h("td", { class: "soft" }, one.limit))))));
    if (found.places.length) parts.push(panel("Where else to look", h("p", { class: "soft" }, "Local changes of stiffness or mass with the largest scores: places to inspect, not causes."),
      table([{ title: "local change", words: true }, "score"], found.places.map((one) => h("tr", {},
        h("th", { scope: "row", class: "words", style: { "white-space": "normal" } }, one.name, h("span", { class: "at num" }, one.at)), h("td", {}, one.score))))));
    return h("div", { class: "stack" }, parts);
  }

  // Versions of the model with their errors on used and held-out data, and one that is being added.
  growth() {
    const { pane } = this, versions = this.versions ?? [];
    const adding = Object.entries(pane.live.studies).flatMap(([key, one]) => one.runs.map((run) => [key, run]))
      .find(([key, run]) => run.state === "running" && (versions.some((one) => one.key === key && key !== pane.key) || run.options?.effects));
    const now = JSON.stringify([versions, adding?.[1]?.words, adding?.[1]?.left, pane.key]);
    if (now === this.grown) return;
    this.grown = now;
    const calibrated = versions.filter((one) => one.errors.length);
    if (!calibrated.length || (versions.length < 2 && !adding)) { this.family.replaceChildren(); return; }
    const run = adding?.[1];
    this.family.replaceChildren(h("section", { class: "panel", id: "versions" },
      h("div", { class: "head" }, h("h2", {}, "Errors over the versions of the model"), h("span", { class: "grow" }),
        run ? h("span", { class: "soft num" }, run.words || run.verb) : null, run ? bar(run.done, run.total) : null),
      errors(calibrated),
      h("ul", { class: "tree" }, versions.map((one) => h("li", { style: { "padding-left": `${1.4 * depth(one, versions)}rem` } },
        h("a", { href: `#/${one.key}/overview` }, one.name), h("span", { class: "soft" }, ` ${one.effects.length ? `with ${one.effects.join(" and ")}` : "without effects"}${one.fault ? `, cannot be read: ${one.fault}` : one.errors.length ? "" : ", not calibrated"}`),
        " ", one.key === pane.key ? h("span", { class: "chip" }, "shown") : h("a", { href: pane.address("overview", one.key) }, "show beside"))))));
  }

  get calibrated() {
    return this.known.analyses.find((one) => one.verb === "calibrate")?.state === "done";
  }

  empty() {
    const { pane } = this, done = this.calibrated;
    const knows = this.known.analyses.some((one) => one.verb === "explain"), runs = this.pane.running?.verb === "explain";
    if (runs) {
      return h("section", { class: "panel empty" }, h("h2", {}, "It is being looked for"),
        h("p", {}, "Every possible cause of the study's list is tested, local changes of every part, and errors of the measurement. The answer stands here as soon as it is known."));
    }
    return h("section", { class: "panel empty" },
      h("h2", {}, knows ? "Nothing has been looked for yet" : "The study names no possible causes"),
      h("p", {}, knows ? "“Find what is missing” tests every possible cause of the study's list, local changes of every part, and errors of the measurement, and says which of them the data support, or that none can be named."
        : "A list of possible causes stands in study.toml as effects = \"FILE.py:FUNCTION\"; then what the model lacks can be named."),
      h("div", { class: "act" }, pane.button("explain", "Find what is missing", knows ? "main" : ""), done ? null : h("span", { class: "soft small" }, "A calibration first makes it faster: its fit is the start.")));
  }
}

function depth(one, versions) {
  let steps = 0;
  for (let own = one; own?.parent && steps < 9; steps += 1) own = versions.find(({ key }) => key === own.parent);
  return steps;
}

// A bar for each version in each group of data, in standard deviations, and a line where a correct model would be.
function errors(versions) {
  const groups = [...new Map(versions.flatMap((one) => one.errors.map((own) => [own.group, own.words]))).entries()];
  const most = Math.max(...versions.flatMap((one) => one.errors.map((own) => Math.max(own.rms, own.expected ?? 0))));
  const wide = 640, label = 202, row = 21, gap = 16, high = groups.length * (versions.length * row + gap) + 4;
  const x = (value) => label + value / most * (wide - label - 190);
  const words = groups.map(([group, name]) => `${name}: ${versions.map((one) => `${one.name} ${one.errors.find((own) => own.group === group)?.text ?? "unknown"}`).join(", ")}`).join("; ");
  const drawn = s("svg", { class: "errors", viewBox: `0 0 ${wide} ${high}`, role: "img", "aria-label": `Rms errors in standard deviations. ${words}` });
  groups.forEach(([group, name], g) => {
    const top = g * (versions.length * row + gap) + 4;
    drawn.append(s("text", { x: 0, y: top + row / 2 + 4 }, name));
    versions.forEach((one, v) => {
      const own = one.errors.find((error) => error.group === group), y = top + v * row;
      if (!own) return;
      const colour = one.effects.length ? "var(--c2)" : "var(--c0)";
      drawn.append(s("rect", { x: label, y: y + 3, width: Math.max(1, x(own.rms) - label), height: row - 6, rx: 2, style: `fill: ${colour}` }));
      if (own.expected !== null) drawn.append(s("line", { class: "expected", x1: x(own.expected), x2: x(own.expected), y1: y + 1, y2: y + row - 1 }));
      const at = Math.max(x(own.rms), x(own.expected ?? 0)) + 8;
      drawn.append(s("text", { class: "value", x: at, y: y + row / 2 + 4 }, `${own.text} σ`));
      drawn.append(s("text", { x: at + 52, y: y + row / 2 + 4 }, one.effects.length ? `with ${one.effects.join(" and ")}` : "without effects"));
    });
  });
  return h("div", {}, drawn, h("p", { class: "soft small" }, "Root mean square of the errors over their standard deviation. Dark line: what a correct model would show with this noise."));
}
