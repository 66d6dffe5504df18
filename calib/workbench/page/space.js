// The model in space: the report's own viewer, with the controls that it needs.
import { ask, h } from "./dom.js";

export async function space(path, layer = "") {
  const { scene } = await ask(path);
  return scene ? viewer(scene, layer) : null;
}

export function viewer(scene, layer = "") {
  const label = (words, name) => h("label", {}, words, " ", h("select", { class: name }));
  const figure = h("figure", { class: "viewer" },
    h("div", { class: "controls" }, label("Show", "layer"), label("Mode", "mode"), label("Model", "stage"),
      h("button", { type: "button", class: "play", "aria-pressed": "false" }, "Play"), h("button", { type: "button", class: "reset" }, "Reset view")),
    h("div", { class: "drawing", role: "img", tabIndex: 0, "aria-label": "" }),
    h("p", { class: "facts", "aria-live": "polite" }), h("p", { class: "key", "aria-hidden": "true" }), h("img", { class: "paper", alt: "" }),
    h("p", { class: "soft small" }, "Drag to turn it; the wheel zooms with Ctrl or after a click. With the keyboard: arrows turn, + and − zoom, N and P name the dots."));
  // The viewer of the report stands in the page's global scope.
  // eslint-disable-next-line no-undef
  drawViewer(figure, scene);
  const choice = figure.querySelector("select.layer");
  if (layer && [...choice.options].some((one) => one.value === layer)) {
    choice.value = layer;
    choice.dispatchEvent(new Event("change"));
  }
  return figure;
}
