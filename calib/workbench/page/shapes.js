// A measured shape beside a mode of the model and both over each other, moving together in the report's viewer.
/* global Stage, THREE */
import { h } from "./dom.js";

const PERIOD = 2000;  // milliseconds
const PLACES = [["measured", "Measured"], ["model", "Model"], ["both", "Over each other"]];

export class Shapes {
  // `names`: which of the pictures; all of them for a pair, the last alone where values move.
  constructor(scene, names = PLACES.map(([name]) => name)) {
    Object.assign(this, { scene, names, request: 0, stages: [] });
    this.element = h("div", { class: "shapes" });
    this.play = h("button", { type: "button", "aria-pressed": "false", onclick: () => (this.request ? this.pause() : this.start()) }, "Play");
    this.facts = h("span", { class: "soft small" });
    for (const [name, title] of PLACES.filter(([own]) => names.includes(own))) {
      const place = h("div", { class: "drawing", role: "img", tabIndex: 0, "aria-label": title });
      this.element.append(h("figure", { class: `viewer ${name}` }, place, h("figcaption", { class: "soft small" }, title)));
    }
    this.element.append(h("div", { class: "act" }, this.play, h("button", { type: "button", onclick: () => this.stages.forEach((one) => one.controls.reset()) }, "Reset view"), this.facts));
    this.hidden = () => { if (document.hidden) this.pause(); };
    document.addEventListener("visibilitychange", this.hidden);
  }

  // Stages are made once the element stands in the page: they need its size.
  make() {
    const places = [...this.element.querySelectorAll(".drawing")];
    for (const place of places) {
      const context = document.createElement("canvas").getContext("webgl2", { antialias: true });
      if (!context) {
        place.textContent = "This browser cannot draw in space (WebGL).";
        continue;
      }
      const stage = new Stage(place, this.scene, context);
      stage.controls.addEventListener("change", () => this.follow(stage));
      this.stages.push(stage);
    }
  }

  // All pictures show the same view.
  follow(leader) {
    if (this.following) return;
    this.following = true;
    for (const stage of this.stages) {
      if (stage === leader) continue;
      stage.camera.position.copy(leader.camera.position);
      stage.camera.zoom = leader.camera.zoom;
      stage.controls.target.copy(leader.controls.target);
      stage.camera.updateProjectionMatrix();
      stage.controls.update();
      stage.ask();
    }
    this.following = false;
  }

  show(stage, mode, motion) {
    const own = this.scene.stages.find((one) => one.name === `${stage} calibration`)?.modes.find((one) => one.name === mode);
    if (!own) return null;
    this.own = own;
    const nothing = { step: 1, numbers: "" };
    const modes = { measured: { ...own, motion: null }, model: { ...own, motion, at: [], measured: nothing }, both: { ...own, motion } };
    const draw = () => {
      if (!this.stages.length) this.make();
      this.stages.forEach((one, k) => {
        one.model.mode(modes[this.names[k]]);
        one.model.move(1);
        one.named = -1;
        one.name(-1);
        one.draw();
      });
      this.element.dataset.drawn = mode;
    };
    if (this.stages.length) draw(); else queueMicrotask(() => requestAnimationFrame(draw));
    return this.element;
  }

  start() {
    this.play.textContent = "Pause";
    this.play.setAttribute("aria-pressed", "true");
    let began = null;
    const step = (now) => {
      this.request = requestAnimationFrame(step);
      began ??= now;
      const phase = Math.cos(2 * Math.PI * (now - began) / PERIOD);
      for (const one of this.stages) { one.model.move(phase); one.draw(); }
    };
    this.request = requestAnimationFrame(step);
  }

  pause() {
    cancelAnimationFrame(this.request);
    this.request = 0;
    this.play.textContent = "Play";
    this.play.setAttribute("aria-pressed", "false");
  }

  close() {
    this.pause();
    document.removeEventListener("visibilitychange", this.hidden);
    for (const stage of this.stages) stage.renderer.dispose();
    for (const stage of this.stages) stage.renderer.forceContextLoss();
    this.stages = [];
  }
}
