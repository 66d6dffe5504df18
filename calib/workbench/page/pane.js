// One study as a view shows it: what the view asks of the server, what runs on the study, and the commands it gives.
import { select, words } from "./app.js";
import { change, h, tell } from "./dom.js";

const SLOW = 250;  // milliseconds between two readings of the same view

export class Pane {
  // `page`: that it belongs to; `place`: its element; `shown`: key of the study, part of its results, and test.
  constructor(page, place, shown, View) {
    Object.assign(this, { page, ...shown });
    this.head = h("header", { hidden: true });
    this.trouble = h("div", {}, h("p", { class: "soft" }, "Reading …"));
    this.body = h("div", {});
    place.append(this.head, this.trouble, this.body);
    this.view = new View(this, this.body);
  }

  // What the server is asked for about the study that is shown.
  of(what, more = {}) {
    const asked = new URLSearchParams({ part: this.part, test: this.test, ...more });
    return `study/${this.key}${what ? `/${what}` : ""}?${asked}`;
  }

  // The address of another view of the same study, or of another study beside this one.
  address(view, beside = "") {
    return this.page.address({ key: this.key, part: this.part, view, beside, beside_part: undefined });
  }

  // -- what changes --------------------------------------------------------------------------------------------------

  get live() {
    return this.page.live;
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

  get shown() {
    return this.page.panes.includes(this);
  }

  refresh() {
    clearTimeout(this.due);
    this.due = setTimeout(() => this.look(), this.looked && Date.now() - this.looked < SLOW ? SLOW : 0);
  }

  // One reading at a time, or an older answer could come last.
  async look() {
    this.again = true;
    if (this.looking) return;
    this.looking = true;
    while (this.again && this.shown) {
      this.again = false;
      this.looked = Date.now();
      let fault = "";
      try {
        await this.view.look(this.live.studies[this.key]);
      } catch (failure) {
        fault = failure.message;
      }
      this.trouble.replaceChildren(fault ? h("p", { class: "note bad", role: "alert" }, fault) : "");
    }
    this.looking = false;
  }

  // What a view has read of the study: the page's head and side, and a head of its own beside another, show a part of it.
  knows(known) {
    this.known = known;
    const { page } = this, own = page.panes[0] === this ? "part" : "beside_part";
    const { parts } = known, part = parts.includes(this.wanted) ? this.wanted : parts.includes(this.part) || !parts.length ? this.part : parts[0];
    if (part !== this.part) {
      page.go({ [own]: part });
      return;
    }
    this.trouble.replaceChildren("");
    page.draw();
    this.head.hidden = page.panes.length < 2;
    this.head.replaceChildren(h("h2", { title: known.path }, known.name),
      known.parts.length > 1 ? select("", known.parts, this.part, words, (part) => page.go({ [own]: part })) : "",
      h("a", { class: "button", href: this.address(page.asked.view) }, "Show alone"));
  }

  // What is picked here is picked beside it as well, where there is such a thing.
  picked(what) {
    for (const pane of this.page.panes) if (pane !== this) pane.view.follow?.(what);
  }

  // -- commands ------------------------------------------------------------------------------------------------------

  async run(verb) {
    await this.give(verb, this.page.quick && this.page.quickVerbs.includes(verb) ? { quick: true } : {});
  }

  async give(verb, options) {
    await this.ordered("run", { verb, options }, `Started: calib ${verb}`);
    if (this.page.quickVerbs.includes(verb)) this.wanted = options.quick ? "quick" : "";  // where its results will be
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
    const box = h("input", { type: "checkbox", checked: this.page.quick, onchange: () => { this.page.quick = box.checked; this.page.refresh(); } });
    return h("label", { class: "small soft", title: "Small searches, to see whether a study works; their results stand apart" }, box, " quick run");
  }
}
