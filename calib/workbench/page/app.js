// The page: which study and view are shown, one or two side by side, and what has changed since.
import { ask, h, lasting } from "./dom.js";
import { Correlation } from "./correlation.js";
import { Designs } from "./designs.js";
import { Measurement } from "./measurement.js";
import { Missing } from "./missing.js";
import { Overview, StudyList } from "./overview.js";
import { Pane } from "./pane.js";
import { Parameters } from "./parameters.js";
import { Search } from "./search.js";
import { WhatIf } from "./what_if.js";

const VIEWS = [
  ["overview", "Overview", Overview], ["search", "Search", Search], ["missing", "Missing physics", Missing],
  ["correlation", "Correlation", Correlation], ["what-if", "What if", WhatIf], ["designs", "Designs", Designs], ["measurement", "Measurement", Measurement], ["parameters", "Parameters", Parameters],
];

class Page {
  constructor() {
    this.studies = [];
    this.live = { studies: {} };
    this.panes = [];
    this.asked = {};
    this.quick = false;
    this.theme(localStorage.getItem("calib-theme") || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
    addEventListener("hashchange", () => this.route());
    this.connect();
    this.begin();
  }

  async begin() {
    try {
      const found = await ask("studies");
      this.studies = found.studies;
      this.single = found.single;
      this.quickVerbs = found.quick;
      this.kinds = found.kinds;
      this.route();
    } catch (fault) {
      document.getElementById("view").replaceChildren(h("p", { class: "note bad" }, fault.message));
    }
  }

  // -- the address --------------------------------------------------------------------------------------------------

  route() {
    const [path, asked] = location.hash.slice(1).split("?"), [key, view] = path.split("/").filter(Boolean);
    const given = new URLSearchParams(asked), test = given.get("test") ?? "", find = (own) => this.studies.find((one) => one.key === own);
    const known = find(key), beside = find(given.get("beside"));
    if (!known && this.single && this.studies.length) return this.go({ key: this.studies[0].key, view: "overview", beside: "" });
    if (!known) return this.list();
    const [name, , View] = VIEWS.find(([own]) => own === view) ?? VIEWS[0];
    const part = given.get("part") ?? known.part ?? "", besidePart = given.get("beside_part") ?? beside?.part ?? "";
    if (key !== this.asked.key || part !== this.asked.part) this.quick = part.startsWith("quick");  // as what is shown was made
    this.asked = { key, view: name, part, test, beside: beside?.key ?? "", beside_part: besidePart };
    const shown = [{ key, part, test }, ...(beside ? [{ key: beside.key, part: besidePart, test }] : [])];
    const place = JSON.stringify([name, shown]);
    if (this.place !== place) {
      this.place = place;
      this.close();
      const view = document.getElementById("view"), sections = shown.map(() => h("section", { class: "pane" }));
      view.replaceChildren(h("div", { class: beside ? "panes two-panes" : "panes" }, sections));
      view.scrollTop = 0;
      this.panes = shown.map((one, k) => new Pane(this, sections[k], one, View));
    }
    this.refresh();
  }

  list() {
    if (!this.studyList) {  // what is being typed there stays
      this.close();
      Object.assign(this, { asked: {}, place: "list", panes: [] });
      this.studyList = new StudyList(this, document.getElementById("view"));
    }
    this.draw();
    this.studyList.draw(this.studies);
  }

  close() {
    this.studyList = null;
    for (const pane of this.panes) pane.view.close?.();
  }

  // The address of what is shown, with some of it exchanged.
  address(more) {
    const { key, view, ...rest } = { ...this.asked, ...more };
    const given = new URLSearchParams(Object.entries(rest).filter(([name, value]) => value !== undefined && (value || name === "part")));
    return `#/${key}/${view || "overview"}${given.size ? `?${given}` : ""}`;
  }

  go(more) {
    const address = this.address(more);
    if (location.hash === address) this.route(); else location.hash = address;
  }

  // -- what changes --------------------------------------------------------------------------------------------------

  connect() {
    const address = new URL("live", location.href.split("#")[0]);
    address.protocol = "ws:";
    const socket = new WebSocket(address);
    socket.onopen = () => this.lost(false);
    socket.onmessage = (event) => {
      const before = Object.keys(this.live.studies).join();
      this.live = JSON.parse(event.data);
      if (before && before !== Object.keys(this.live.studies).join()) this.begin();
      else this.refresh();
    };
    socket.onclose = () => {
      this.lost(true);
      setTimeout(() => this.connect(), 1500);
    };
  }

  lost(gone) {
    this.gone = gone;
    this.draw();
  }

  refresh() {
    this.draw();
    this.studyList?.runs();
    for (const pane of this.panes) pane.refresh();
  }

  // -- head and side -------------------------------------------------------------------------------------------------

  theme(name) {
    document.documentElement.dataset.theme = name;
    localStorage.setItem("calib-theme", name);
  }

  get study() {
    return this.studies.find((one) => one.key === this.asked.key);
  }

  draw() {
    const busy = this.panes.find((pane) => pane.running), first = this.panes[0];
    const now = JSON.stringify([busy?.running, this.gone, this.place, this.studies.map((one) => one.key), first?.known]);
    if (now === this.seen) return;
    this.seen = now;
    const { study } = this;
    document.title = study ? `${study.title ?? study.name} – calib` : "calib";
    document.getElementById("top").replaceChildren(...this.top(study, busy));
    document.getElementById("side").replaceChildren(...this.side(study, first?.known));
  }

  top(study, busy) {
    const run = busy?.running, { part } = this.asked;
    return [
      h("a", { class: "mark", href: "#/" }, "calib"),
      h("span", { class: "title", title: study?.path ?? "" }, study ? study.title ?? study.name : "Studies"),
      study && this.panes[0]?.known?.synthetic ? h("span", { class: "chip warn" }, "synthetic measurement") : null,
      study && part ? h("span", { class: "chip" }, words(part)) : null,
      h("span", { class: "grow" }),
      this.gone ? h("span", { class: "chip bad", role: "alert" }, "The server has ended. Commands go on; open the page again with: calib open") : null,
      run ? h("div", { class: "run", id: "running" },
        bar(run.done, run.total),
        h("span", { class: "num", title: run.command }, run.stopping ? "stopping …" : run.words || run.verb),
        run.left ? h("span", { class: "soft num" }, `${run.left} left`) : null,
        h("button", { type: "button", class: "stop", disabled: run.stopping, onclick: () => busy.stop(run.pid) }, "Stop")) : null,
    ].filter(Boolean);
  }

  side(study, known) {
    const dark = document.documentElement.dataset.theme === "dark", { asked } = this;
    const mode = h("button", { type: "button", onclick: () => {
      this.theme(dark ? "light" : "dark");
      this.seen = "";
      this.draw();
      for (const pane of this.panes) pane.view.themed?.();
    } }, dark ? "Light" : "Dark");
    const links = study ? VIEWS.map(([view, title]) =>
      h("a", { href: this.address({ view }), "aria-current": view === asked.view ? "page" : null }, title)) : [];
    const parts = known?.parts ?? [], tests = known?.tests ?? [], others = this.studies.filter((one) => one.key !== asked.key);
    const several = this.studies.length > 1;
    return [
      ...links,
      study && parts.length > 1 ? select("Results", parts, asked.part, words, (part) => this.go({ part })) : null,
      study && tests.length ? select("Test", ["", ...tests], asked.test, (one) => one || "all together", (test) => this.go({ test })) : null,
      study && several ? select("Beside", ["", ...others.map((one) => one.key)], asked.beside, (own) => others.find((one) => one.key === own)?.name ?? "nothing",
        (beside) => this.go({ beside, beside_part: undefined })) : null,
      several ? h("h2", {}, "Studies") : null,
      ...(several ? this.studies.slice(0, 30).map((one) =>
        h("a", { class: "study", href: `#/${one.key}/${asked.view || "overview"}`, title: `${one.name}: ${one.path}`, "aria-current": one.key === asked.key ? "true" : null },
          one.name.split("_").flatMap((word, k) => (k ? ["_", h("wbr"), word] : [word])))) : []),
      h("span", { class: "grow" }),
      h("label", {}, h("span", { class: "soft" }, "Colours"), mode),
    ].filter(Boolean);
  }
}

export function select(label, values, now, words, chosen) {
  return h("label", {}, label, h("select", { onchange: (event) => chosen(event.target.value) }, values.map((one) => h("option", { value: one, selected: one === now }, words(one)))));
}

// The name of a part of the results.
export function words(part) {
  return part === "quick" ? "quick run" : part || "full run";
}

export function bar(done, total) {
  const share = total ? Math.min(1, done / total) : 0;
  return h("span", { class: total ? "bar" : "bar unknown", role: "progressbar", "aria-label": "progress", "aria-valuenow": total ? Math.round(100 * share) : null },
    h("i", { style: total ? { width: `${100 * share}%` } : {} }));
}

// What the last command said where it failed, and how to go on.
export function afterFailure(pane) {
  const run = pane.failed;
  if (!run) return null;
  const added = run.options?.effects, again = run.again ? () => pane.give(run.verb, run.again) : added ? () => pane.add(added) : null;
  const stopped = run.state === "stopped", at = run.words ? `, at: ${run.words}` : "";
  return h("div", { class: stopped ? "note" : "note bad", id: "after" },
    h("p", {}, h("strong", {}, `calib ${run.verb} ${stopped ? "was stopped" : "failed"}${at}. `), run.sentence || (stopped ? "Nothing is lost: the same command goes on where it stood." : "")),
    run.tail && !run.sentence ? h("pre", {}, run.tail.split("\n").slice(-12).join("\n")) : null,
    again === null ? null : h("div", { class: "act" },
      h("button", { type: "button", class: "main", disabled: Boolean(pane.running), onclick: again }, stopped ? "Resume" : "Again"),
      h("span", { class: "soft small" }, `started ${lasting(Date.now() / 1000 - run.began)} ago`)));
}

window.calib = new Page();
