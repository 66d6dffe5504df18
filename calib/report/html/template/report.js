"use strict";
// Show faults in the page: readers do not see the console.
function showFault(words) {
  const place = document.getElementById("faults");
  place.hidden = false;
  place.textContent = [place.textContent, "A figure could not be drawn: " + words].filter(Boolean).join(" ");
}
window.addEventListener("error", (event) => showFault(event.message));
window.addEventListener("unhandledrejection", (event) => showFault(String(event.reason)));

// Nothing leaves the page: by default Plotly offers to send a figure's data to a server.
const CONFIG = {
  responsive: true, displaylogo: false, scrollZoom: false, showSendToCloud: false, plotlyServerURL: "",
  modeBarButtonsToRemove: ["select2d", "lasso2d"],
};

// WebGL figures do not print, so a PNG of each is kept for printing.
function keepForPaper(figure, place) {
  const size = { format: "png", width: 900, height: place.clientHeight };
  return Plotly.toImage(place, size).then((url) => {
    const paper = figure.querySelector("img.paper") || figure.insertBefore(new Image(), place.nextSibling);
    paper.className = "paper";
    paper.alt = place.getAttribute("aria-label");
    paper.src = url;
  });
}

function drawPlot(figure, content) {
  const place = figure.querySelector(".drawing");
  return Plotly.newPlot(place, content.data, content.layout, CONFIG);
}

// Lines of a mesh as one trace with gaps: pairs of points, and a gap after each.
function along(points, pairs) {
  const axes = [[], [], []];
  for (const [a, b] of pairs) {
    for (let k = 0; k < 3; k++) axes[k].push(points[a][k], points[b][k], null);
  }
  return axes;
}

function split(points) {
  return [0, 1, 2].map((k) => points.map((p) => p[k]));
}

function moved(points, motion, factor) {
  return points.map((p, i) => p.map((x, k) => x + factor * motion[i][k]));
}

function frameOf(stage, mode, phase) {
  const factor = mode.scale * phase;
  const tips = moved(mode.places, mode.measured, factor);
  const shell = moved(stage.points, mode.motion, factor);
  const model = mode.paired ? along(shell, stage.lines) : [[], [], []];
  const threads = along(mode.places.concat(tips), mode.places.map((_, i) => [i, i + tips.length]));
  return [model, threads, split(tips), split(mode.paired ? shell : [])];
}

function trace(axes, more) {
  return { type: "scatter3d", x: axes[0], y: axes[1], z: axes[2], hoverinfo: "skip", ...more };
}

function drawShapes(figure, content) {
  const place = figure.querySelector(".drawing");
  const modes = figure.querySelector("select.mode"), stages = figure.querySelector("select.stage");
  const play = figure.querySelector("button.play"), facts = figure.querySelector("span.facts");
  const colours = content.colours;
  content.stages.forEach((stage, k) => stages.add(new Option(stage.name, k)));
  stages.value = 0;  // its section is about the model before calibration
  stages.parentElement.hidden = content.stages.length === 1;
  content.stages[0].modes.forEach((mode, k) => modes.add(new Option(mode.name, k)));
  let started = null, request = null, held = false;

  const chosen = () => {
    const stage = content.stages[stages.value];
    return [stage, stage.modes[modes.value]];
  };
  const show = (phase) => {
    const parts = frameOf(...chosen(), phase);
    const axis = (k) => parts.map((part) => part[k]);
    return Plotly.restyle(place, { x: axis(0), y: axis(1), z: axis(2) }, [1, 2, 3, 4]);
  };
  const step = (now) => {
    started = started ?? now;
    // One period in two seconds, starting at the largest motion. A new frame would undo a rotation by the mouse.
    const drawn = held ? Promise.resolve() : show(Math.cos(Math.PI * (now - started) / 1000));
    drawn.then(() => {
      if (request !== null) request = requestAnimationFrame(step);
    });
  };
  const pause = () => {
    if (request !== null) cancelAnimationFrame(request);
    request = started = null;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  };
  const choose = () => {
    const [stage, mode] = chosen();
    facts.textContent = mode.words;
    place.setAttribute("aria-label", "Mode shape " + stage.name + ": " + mode.words);
    const parts = frameOf(stage, mode, 1);
    const camera = place.layout ? place.layout.scene.camera : stage.view.camera;
    const data = [
      trace(along(stage.points, stage.lines), { mode: "lines", line: { color: colours.rest, width: 2 }, name: "model at rest" }),
      trace(parts[0], { mode: "lines", line: { color: colours.model, width: 4 }, name: "model" }),
      trace(parts[1], { mode: "lines", line: { color: colours.measured, width: 3 }, showlegend: false }),
      trace(parts[2], { mode: "markers", marker: { color: colours.measured, size: 4 }, name: "measured" }),
      {
        ...trace(parts[3], { color: colours.model, opacity: 0.25, flatshading: true }), type: "mesh3d",
        i: stage.triangles[0], j: stage.triangles[1], k: stage.triangles[2],
      },
    ];
    const layout = {
      height: content.height, margin: { l: 0, r: 0, t: 30, b: 0 }, scene: { ...stage.view, camera }, font: content.font,
      legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom" },
    };
    return Plotly.react(place, data, layout, CONFIG);
  };
  for (const choice of [modes, stages]) {
    choice.addEventListener("change", () => choose().then(() => keepForPaper(figure, place)));
  }
  play.addEventListener("click", () => {
    if (request !== null) {
      pause();
      return;
    }
    play.textContent = "Pause";
    play.setAttribute("aria-pressed", "true");
    request = requestAnimationFrame(step);
  });
  place.addEventListener("pointerdown", () => { held = true; }, true);
  for (const end of ["pointerup", "pointercancel"]) window.addEventListener(end, () => { held = false; }, true);
  window.addEventListener("beforeprint", pause);
  return choose();
}

for (const figure of document.querySelectorAll("figure[data-kind]")) {
  const content = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
  const draw = figure.dataset.kind === "plot" ? drawPlot : drawShapes;
  draw(figure, content).then(() => {
    const place = figure.querySelector(".drawing");
    figure.dataset.drawn = "yes";
    if (figure.dataset.kind === "plot" && !content.layout.scene) return null;
    place.on("plotly_relayout", () => keepForPaper(figure, place));
    return keepForPaper(figure, place);
  });
}

// Print tables that are folded on the screen.
let folded = [];
window.addEventListener("beforeprint", () => {
  folded = [...document.querySelectorAll("details:not([open])")];
  folded.forEach((part) => { part.open = true; });
});
window.addEventListener("afterprint", () => folded.forEach((part) => { part.open = false; }));
