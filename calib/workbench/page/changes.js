// Changes of study.toml: each is shown as a difference first, then made, and can be taken back.
import { change, h, tell } from "./dom.js";

export class Changes {
  // `done` is called after a change was made or taken back.
  constructor(pane, done) {
    Object.assign(this, { pane, done });
    this.element = h("div", { id: "diff" });
  }

  async propose(edit, test) {
    try {
      const shown = await change(this.pane.of("edit", { test }), { edit });
      const make = h("button", { type: "button", class: "main", id: "make", onclick: () => this.make(edit, shown.digest, test) }, shown.words);
      this.element.replaceChildren(h("pre", { "aria-label": "what changes in study.toml" }, shown.diff.map((line) =>
        h("span", { class: line.startsWith("+") ? "plus" : line.startsWith("-") ? "minus" : "soft" }, `${line}\n`))),
      h("div", { class: "act" }, make, h("button", { type: "button", onclick: () => this.element.replaceChildren() }, "Leave it")));
      make.scrollIntoView({ block: "nearest" });
      make.focus();
    } catch (fault) {
      tell(fault.message, "bad");
    }
  }

  async make(edit, digest, test) {
    await this.changed("edit", test, { edit, digest, make: true });
    this.element.replaceChildren();
  }

  async changed(what, test, content) {
    try {
      tell((await change(this.pane.of(what, { test }), content)).words);
      this.done();
    } catch (fault) {
      tell(fault.message, "bad");
    }
  }

  // The button that takes the latest change back; null without one.
  undo(words, test) {
    return words ? h("button", { type: "button", id: "undo", onclick: () => this.changed("undo", test) }, `Undo: ${words}`) : null;
  }
}
