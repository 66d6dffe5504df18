// The page: which study and view are shown, what runs, and what has changed since.
import { ask, change, h, lasting, tell } from "./dom.js";
import { Correlation } from "./correlation.js";
import { Designs } from "./designs.js";
import { Measurement } from "./measurement.js";
import { Missing } from "./missing.js";
import { Overview, StudyList } from "./overview.js";
import { Parameters } from "./parameters.js";
import { Search } from "./search.js";
import { WhatIf } from "./what_if.js";

const VIEWS = [
  ["overview", "Overview", Overview], ["search", "Search", Search], ["missing", "Missing physics", Missing],
  ["correlation", "Correlation", Correlation], ["what-if", "What if", WhatIf], ["designs", "Designs", Designs], ["measurement", "Measurement", Measurement], ["parameters", "Parameters", Parameters],
];
const SLOW = 250;  // milliseconds between two readings of the same view

class Page {
  constructor() {
    this.studies = [];
    this.live = { studies: {} };
    this.seen = "";
    this.quick = localStorage.getItem("calib-quick") === "yes";
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
      this.route();
    } catch (fault) {
      document.getElementById("view").replaceChildren(h("p", { class: "note bad" }, fault.message));
    }
  }

  // -- the address --------------------------------------------------------------------------------------------------

  route() {
    const [path, asked] = location.hash.slice(1).split("?"), [key, view] = path.split("/").filter(Boolean);
    const given = new URLSearchParams(asked);
    const known = this.studies.find((one) => one.key === key);
    if (!known && this.single && this.studies.length) return this.go(this.studies[0].key, "overview");
    if (!known) return this.list();
    const part = given.get("part") ?? known.part ?? "", test = given.get("test") ?? "";
    const [name, , View] = VIEWS.find(([own]) => own === view) ?? VIEWS[0];
    const place = `${key}/${name}/${part}/${test}`;
    Object.assign(this, { key, part, test, name });
    if (this.place !== place) {
      this.place = place;
      this.view?.close?.();
      document.getElementById("view").replaceChildren();
      this.view = new View(this, document.getElementById("view"));
      document.getElementById("view").scrollTop = 0;
    }
    this.refresh();
  }

  list() {
    Object.assign(this, { key: "", name: "", place: "list" });
    this.view?.close?.();
    this.view = new StudyList(this, document.getElementById("view"));
    this.draw();
    this.view.draw(this.studies);
  }

  go(key, view = this.name || "overview", more = {}) {
    const given = new URLSearchParams({ ...(more.part === undefined ? {} : { part: more.part }), ...(more.test ? { test: more.test } : {}) });
    const address = `#/${key}/${view}${given.size ? `?${given}` : ""}`;
    if (location.hash === address) this.route(); else location.hash = address;
  }

  address(view) {
    return `#/${this.key}/${view}?${new URLSearchParams({ part: this.part, ...(this.test ? { test: this.test } : {}) })}`;
  }

  // What the server is asked for about the study that is shown.
  of(what, more = {}) {
    const asked = new URLSearchParams({ part: this.part, test: this.test, ...more });
    return `study/${this.key}${what ? `/${what}` : ""}?${asked}`;
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

  get runs() {
    return this.live.studies[this.key]?.runs ?? [];
  }

  get running() {
    return this.runs.find((one) => one.state === "running");
  }

  // The last command, where it did not succeed; the server leaves it out once anything has been run since.
  get failed() {
    const last = this.runs.at(-1);
    return last && (last.state === "failed" || last.state === "stopped") ? last : null;
  }

  refresh() {
    this.draw();
    if (!this.view?.look || !this.key) {
      if (this.place === "list") this.view.runs();
      return;
    }
    clearTimeout(this.due);
    this.due = setTimeout(() => this.look(), this.looked && Date.now() - this.looked < SLOW ? SLOW : 0);
  }

  // One reading of a view at a time, or an older answer could come last.
  async look() {
    const view = this.view;
    view.again = true;
    if (view.looking) return;
    view.looking = true;
    while (view.again && view === this.view) {
      view.again = false;
      this.looked = Date.now();
      let fault = "";
      try {
        await view.look(this.live.studies[this.key]);
      } catch (failure) {
        fault = failure.message;
      }
      if (view !== this.view) break;
      this.faulty?.remove();
      if (fault) {
        this.faulty = h("p", { class: "note bad", role: "alert" }, fault);
        document.getElementById("view").prepend(this.faulty);
      }
    }
    view.looking = false;
  }

  // -- commands ------------------------------------------------------------------------------------------------------

  async run(verb) {
    await this.give(verb, this.quick && this.quickVerbs.includes(verb) ? { quick: true } : {});
  }

  async give(verb, options) {
    await this.ordered("run", { verb, options }, `Started: calib ${verb}`);
    if (options.quick && this.part !== "quick") this.wanted = "quick";
  }

  async add(effects) {
    await this.ordered("add", { effects, quick: this.part.startsWith("quick") }, `Adding ${effects.join(" and ")}: the extended study is written, then calibrated`);
  }

  async stop(pid) {
    await this.ordered("stop", { pid }, "Stopping; the same command resumes it");
  }

  async ordered(what, content, words) {
    try {
      await change(this.of(what), content);
      tell(words);
    } catch (fault) {
      tell(fault.message, "bad");
    }
  }

  button(verb, words, kind = "") {
    return h("button", { type: "button", class: kind, disabled: Boolean(this.running), onclick: () => this.run(verb) }, words);
  }

  quickly() {
    const box = h("input", { type: "checkbox", checked: this.quick, onchange: () => {
      this.quick = box.checked;
      localStorage.setItem("calib-quick", box.checked ? "yes" : "no");
    } });
    return h("label", { class: "small soft", title: "Small searches, to see whether a study works; their results stand apart" }, box, " quick run");
  }

  // -- head and side -------------------------------------------------------------------------------------------------

  theme(name) {
    document.documentElement.dataset.theme = name;
    localStorage.setItem("calib-theme", name);
  }

  draw() {
    const now = JSON.stringify([this.runs.map(({ tail, ...run }) => run), this.gone, this.place, this.studies.length, this.known]);
    if (now === this.seen) return;
    this.seen = now;
    const study = this.studies.find((one) => one.key === this.key);
    document.title = study ? `${study.title ?? study.name} – calib` : "calib";
    document.getElementById("top").replaceChildren(...this.top(study));
    document.getElementById("side").replaceChildren(...this.side(study));
  }

  top(study) {
    const run = this.running;
    return [
      h("a", { class: "mark", href: "#/" }, "calib"),
      h("span", { class: "title", title: study?.path ?? "" }, study ? study.title ?? study.name : "Studies"),
      study && this.known?.synthetic ? h("span", { class: "chip warn" }, "synthetic measurement") : null,
      study && this.part ? h("span", { class: "chip" }, this.part === "quick" ? "quick run" : this.part) : null,
      h("span", { class: "grow" }),
      this.gone ? h("span", { class: "chip bad", role: "alert" }, "The server has ended. Commands go on; open the page again with: calib open") : null,
      run ? h("div", { class: "run", id: "running" },
        bar(run.done, run.total),
        h("span", { class: "num", title: run.command }, run.stopping ? "stopping …" : run.words || run.verb),
        run.left ? h("span", { class: "soft num" }, `${run.left} left`) : null,
        h("button", { type: "button", class: "stop", disabled: run.stopping, onclick: () => this.stop(run.pid) }, "Stop")) : null,
    ].filter(Boolean);
  }

  side(study) {
    const dark = document.documentElement.dataset.theme === "dark";
    const mode = h("button", { type: "button", onclick: () => {
      this.theme(dark ? "light" : "dark");
      this.seen = "";
      this.draw();
      this.view?.themed?.();
    } }, dark ? "Light" : "Dark");
    const links = study ? VIEWS.map(([name, title]) =>
      h("a", { href: this.address(name), "aria-current": name === this.name ? "page" : null }, title)) : [];
    const parts = this.known?.parts ?? [], tests = this.known?.tests ?? [];
    const select = (label, values, now, words, chosen) => h("label", {}, label,
      h("select", { onchange: (event) => chosen(event.target.value) }, values.map((one) => h("option", { value: one, selected: one === now }, words(one)))));
    return [
      ...links,
      study && parts.length > 1 ? select("Results", parts, this.part, (one) => one || "full run", (part) => this.go(this.key, this.name, { part, test: this.test })) : null,
      study && tests.length ? select("Test", ["", ...tests], this.test, (one) => one || "all together", (test) => this.go(this.key, this.name, { part: this.part, test })) : null,
      this.studies.length > 1 ? h("h2", {}, "Studies") : null,
      ...(this.studies.length > 1 ? this.studies.slice(0, 30).map((one) =>
        h("a", { class: "study", href: `#/${one.key}/${this.name || "overview"}`, title: `${one.name}: ${one.path}`, "aria-current": one.key === this.key ? "true" : null }, one.name)) : []),
      h("span", { class: "grow" }),
      h("label", {}, h("span", { class: "soft" }, "Colours"), mode),
    ].filter(Boolean);
  }

  // What a view has read of the study: head and side show a part of it.
  knows(known) {
    this.known = known;
    if (this.wanted !== undefined && known.parts.includes(this.wanted)) {
      const part = this.wanted;
      delete this.wanted;
      this.go(this.key, this.name, { part, test: this.test });
    }
    this.draw();
  }
}

export function bar(done, total) {
  const share = total ? Math.min(1, done / total) : 0;
  return h("span", { class: total ? "bar" : "bar unknown", role: "progressbar", "aria-label": "progress", "aria-valuenow": total ? Math.round(100 * share) : null },
    h("i", { style: total ? { width: `${100 * share}%` } : {} }));
}

// What the last command said where it failed, and how to go on.
export function afterFailure(page) {
  const run = page.failed;
  if (!run) return null;
  const stopped = run.state === "stopped", at = run.words ? `, at: ${run.words}` : "";
  return h("div", { class: stopped ? "note" : "note bad", id: "after" },
    h("p", {}, h("strong", {}, `calib ${run.verb} ${stopped ? "was stopped" : "failed"}${at}. `), run.sentence || (stopped ? "Nothing is lost: the same command goes on where it stood." : "")),
    run.tail && !run.sentence ? h("pre", {}, run.tail.split("\n").slice(-12).join("\n")) : null,
    run.again === null ? null : h("div", { class: "act" },
      h("button", { type: "button", class: "main", disabled: Boolean(page.running), onclick: () => page.give(run.verb, run.again) }, stopped ? "Resume" : "Again"),
      h("span", { class: "soft small" }, `started ${lasting(Date.now() / 1000 - run.began)} ago`)));
}

window.calib = new Page();
