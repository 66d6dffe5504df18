// The state of a study: what was run, what was found, and the next command as a button.
import { afterFailure } from "./app.js";
import { ask, change, figure, h, panel, when } from "./dom.js";

const STATES = { done: ["●", "good", "done"], stale: ["◐", "warn", "out of date"], never: ["○", "soft", "not run"], running: ["▶", "", "running"] };

export class Overview {
  constructor(pane, place) {
    Object.assign(this, { pane, place, seen: "", results: null });
  }

  async look(live) {
    if (live && live.results === this.results && this.known) return this.draw(this.known);
    const known = await ask(this.pane.of(""));
    if (!this.pane.shown) return;
    this.results = live?.results ?? null;
    this.known = known;
    this.pane.knows(known);
    this.draw(known);
  }

  draw(known) {
    const { pane } = this;
    const now = JSON.stringify([known, pane.running?.verb, pane.page.quick, pane.failed?.pid, pane.failed?.state]);
    if (now === this.seen) return;
    this.seen = now;
    this.place.replaceChildren(h("div", { class: "stack" },
      afterFailure(pane),
      h("div", { class: "grid two" },
        h("div", { class: "stack" }, this.answer(known), this.steps(known)),
        h("div", { class: "stack" }, this.figures(known), this.notes(known)))));
  }

  answer(known) {
    const { pane } = this, { summary } = known, next = known.next.verb;
    if (pane.running && known.analyses.every((one) => one.state !== "done")) {
      return h("section", { class: "panel" }, h("div", { class: "answer" },
        h("p", { class: "found" }, `calib ${pane.running.verb} runs.`), h("p", {}, "What it finds stands here as soon as it is done; above are its progress and a button that stops it.")));
    }
    if (!summary) {
      return h("section", { class: "panel" }, h("div", { class: "answer" },
        h("p", { class: "found" }, "Nothing has been run yet."),
        h("p", {}, "Begin with the comparison: it tells in seconds how far the model is from the measurement, and whether the data contradict themselves. ",
          "“Run everything” compares, finds the parameters that matter, fits them, and looks for what the model lacks."),
        h("div", { class: "act" }, pane.button("compare", "Compare", "main"), pane.button("run", "Run everything"), pane.quickly())));
    }
    const named = { run: "Run everything", compare: "Compare", sensitivity: "Find what matters", calibrate: "Calibrate", explain: "Find what is missing",
      propose: "Compose effects", intervals: "Intervals", again: "Failed points again", report: "Write the report" };
    return h("section", { class: "panel", id: "answer" }, h("div", { class: "answer" },
      h("p", { class: "found" }, summary.found),
      summary.sure ? h("p", { class: "soft" }, summary.sure) : null,
      summary.then ? h("p", {}, h("strong", {}, "Next: "), summary.then) : null,
      h("div", { class: "act" },
        next === "add" ? h("a", { class: "button main", href: pane.address("missing") }, "See and add what is missing") :
        next === "added" ? h("a", { class: "button main", href: pane.address("missing") }, "See the errors with what was added") :
          next ? pane.button(next, named[next] ?? next, "main") : null,
        next && next !== "added" ? pane.quickly() : null,
        known.report ? h("a", { class: "button", href: pane.of("report"), target: "_blank", rel: "noopener" }, "Report") : null)),
      h("dl", { class: "facts" }, summary.facts.map(([what, number]) => h("div", {}, h("dt", {}, what), h("dd", {}, number)))),
      summary.origin ? h("p", { class: "soft small" }, summary.origin) : null);
  }

  steps(known) {
    const { pane } = this, runs = pane.running?.verb;
    return panel("Analyses", known.analyses.map((one) => {
      const running = runs === one.verb, [mark, kind, words] = STATES[running ? "running" : one.state], found = (running ? "" : one.stale) || one.found || one.what;
      return h("div", { class: "step" },
        h("span", { class: `state ${kind}`, "aria-hidden": "true" }, mark),
        h("h3", {}, one.title, " ", h("span", { class: "soft small" }, `${words}${one.when ? `, ${when(one.when)}` : ""}${one.quick ? ", quick run" : ""}`)),
        h("p", { class: "clip soft", title: found }, found),
        h("div", { class: "act" }, pane.button(one.verb, one.state === "never" ? "Run" : "Again")));
    }), h("div", { class: "act" }, pane.button("run", "Run everything"), pane.quickly(), h("code", { class: "soft small" }, `calib run ${known.path}${pane.page.quick ? " --quick" : ""}`)));
  }

  figures(known) {
    const own = known.figure;
    if (!own) return null;
    const path = this.pane.of(`figure/${own.name}`, own.test ? { test: own.test } : {});
    return panel(own.test ? `Model against measurement, ${own.test}` : "Model against measurement", figure(path, own.name, own.words));
  }

  notes(known) {
    return known.notes.length ? panel("To know", h("div", { class: "stack" }, known.notes.map((words) => h("p", { class: "note" }, words)))) : null;
  }
}

export class StudyList {
  constructor(page, place) {
    Object.assign(this, { page, place, rows: h("div", {}) });
    place.replaceChildren(h("div", { class: "stack" }, this.rows, Object.keys(page.kinds).length ? this.form() : ""));
  }

  // Writes a new study with `calib new` in the folder of the page, and opens it.
  form() {
    const { page } = this, refused = h("p", { class: "bad", role: "alert" });
    const name = h("input", { type: "text", required: true, maxLength: 80, "aria-label": "name of the new folder", placeholder: "name of the folder" });
    const kind = h("select", { "aria-label": "kind of model" }, Object.entries(page.kinds).map(([option, words]) => h("option", { value: option }, words)));
    const write = h("button", { type: "submit", class: "main" }, "Write it");
    return panel("New study", h("p", { class: "soft" }, "An example with its own model and data, to put yours in their place: calib new."),
      h("form", { class: "act", id: "new", onsubmit: async (event) => {
        event.preventDefault();
        write.disabled = true;
        refused.textContent = "";
        try {
          const found = await change("new", { name: name.value, kind: kind.value });
          await page.begin();
          page.go({ key: found.key });
        } catch (fault) {
          refused.textContent = fault.message;
        }
        write.disabled = false;
      } }, name, kind, write), refused);
  }

  draw(studies) {
    this.studies = studies;
    const row = (one) => {
      const run = (this.page.live.studies[one.key]?.runs ?? []).find((own) => own.state === "running");
      return h("div", { class: "step", style: one.parent ? { "margin-left": "1.6rem" } : {} },
        h("span", { class: "state", "aria-hidden": "true" }, one.fault ? "✕" : run ? "▶" : one.stale?.length ? "◐" : one.done?.length ? "●" : "○"),
        h("h3", {}, h("a", { href: `#/${one.key}/overview` }, one.title ?? one.name), " ",
          h("span", { class: "soft small" }, run ? run.words || `${run.verb} runs` : one.fault ? "cannot be read" : one.stale?.length ? "out of date" : one.done?.length ? one.done.join(", ") : "not run")),
        h("p", { class: "soft clip" }, one.fault ?? (one.found || one.path)));
    };
    this.rows.replaceChildren(panel("Studies", studies.length ? studies.map(row) : h("p", { class: "soft" }, "There is no study in this folder yet.")));
  }

  runs() {
    this.draw(this.studies);
  }
}
