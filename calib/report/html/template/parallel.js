"use strict";
// Designs as lines over parallel axes. Dragging along an axis chooses a range, a click on it takes the range away.

for (const figure of document.querySelectorAll("figure.parallel")) brush(figure);

function brush(figure) {
  const { axes, rows } = JSON.parse(figure.querySelector("script").textContent);
  const place = figure.querySelector(".drawing"), words = figure.querySelector(".facts");
  const canvas = place.appendChild(document.createElement("canvas")), pen = canvas.getContext("2d");
  const TOP = 110, BOTTOM = 26, SIDE = 46, RIGHT = 96, LEAST = 0.015, ROOM = 56;
  const ranges = axes.map(() => null);
  const scaled = (axis, value) => (axis.log ? Math.log(value) : value);
  const share = (axis, value) => {
    const low = scaled(axis, axis.low), high = scaled(axis, axis.high);
    return high > low ? (scaled(axis, value) - low) / (high - low) : 0.5;
  };
  const value = (axis, at) => {
    const low = scaled(axis, axis.low), between = low + at * (scaled(axis, axis.high) - low);
    return axis.log ? Math.exp(between) : between;
  };
  const told = (number) => String(Number(number.toPrecision(4)));
  const heights = rows.map((row) => row.map((number, k) => share(axes[k], number)));
  const inside = (row) => ranges.every((range, k) => !range || (range[0] <= row[k] && row[k] <= range[1]));
  let width = 0, height = 0;
  const x = (k) => SIDE + (axes.length > 1 ? (k * (width - SIDE - RIGHT)) / (axes.length - 1) : 0);
  const y = (at) => TOP + (1 - at) * (height - TOP - BOTTOM);

  function lines(some, colour, strength) {
    pen.strokeStyle = colour;
    pen.globalAlpha = Math.min(0.8, Math.max(0.08, strength / Math.max(1, some.length)));
    for (const row of some) {
      pen.beginPath();
      row.forEach((at, k) => pen.lineTo(x(k), y(at)));
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    width = Math.max(place.clientWidth, axes.length * ROOM);
    height = Math.round(Math.min(520, Math.max(360, 0.45 * width)));
    Object.assign(canvas, { width: width * ratio, height: height * ratio });
    Object.assign(canvas.style, { width: width + "px", height: height + "px" });
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, width, height);
    const chosen = heights.filter(inside), others = heights.filter((row) => !inside(row));
    lines(others, "#b5b5b5", 60);
    lines(chosen, "#0072b2", 120);
    axes.forEach((axis, k) => {
      pen.fillStyle = pen.strokeStyle = "#1a1a1a";
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(x(k), y(0));
      pen.lineTo(x(k), y(1));
      pen.stroke();
      pen.font = "11px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.fillText(told(axis.high), x(k), TOP - 6);
      pen.fillText(told(axis.low), x(k), height - BOTTOM + 14);
      if (ranges[k]) {
        pen.fillStyle = "rgba(0, 114, 178, 0.35)";
        const box = [x(k) - 7, y(ranges[k][1]), 14, y(ranges[k][0]) - y(ranges[k][1])];
        pen.fillRect(...box);
        pen.strokeRect(...box);
      }
      if (axis.measured !== null) {
        const at = share(axis, axis.measured);
        pen.fillStyle = "#d55e00";
        if (at >= 0 && at <= 1) pen.fillRect(x(k) - 9, y(at) - 1.5, 18, 3);
      }
      pen.save();
      pen.translate(x(k) - 4, TOP - 20);
      pen.rotate(-Math.PI / 5);
      pen.fillStyle = "#1a1a1a";
      pen.textAlign = "left";
      pen.font = "12px system-ui, sans-serif";
      pen.fillText(axis.name.length > 22 ? axis.name.slice(0, 21) + "…" : axis.name, 0, 0);
      pen.restore();
    });
    const parts = axes.flatMap((axis, k) => (ranges[k]
      ? [`${axis.name} ${told(value(axis, ranges[k][0]))} to ${told(value(axis, ranges[k][1]))}`] : []));
    words.textContent = parts.length
      ? `${chosen.length} of ${rows.length} designs: ${parts.join("; ")}` : `${rows.length} designs`;
    figure.dataset.drawn = chosen.length;
  }

  const at = (event) => {
    const box = canvas.getBoundingClientRect(), k = axes.map((_, i) => Math.abs(event.clientX - box.left - x(i)));
    const up = 1 - (event.clientY - box.top - TOP) / (height - TOP - BOTTOM);
    return { k: k.indexOf(Math.min(...k)), up: Math.min(1, Math.max(0, up)) };
  };
  let begun = null;
  canvas.addEventListener("pointerdown", (event) => {
    begun = at(event);
    if (event.isTrusted) canvas.setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!begun) return;
    const { up } = at(event), far = Math.abs(up - begun.up) >= LEAST;
    ranges[begun.k] = far ? [Math.min(up, begun.up), Math.max(up, begun.up)] : null;
    draw();
  });
  canvas.addEventListener("pointerup", (event) => {
    if (begun && Math.abs(at(event).up - begun.up) < LEAST) {
      ranges[begun.k] = null;
      draw();
    }
    begun = null;
  });
  canvas.addEventListener("pointercancel", () => { begun = null; });
  figure.querySelector(".reset").addEventListener("click", () => {
    ranges.fill(null);
    draw();
  });
  new ResizeObserver(() => { if (place.clientWidth) draw(); }).observe(place);
  draw();
}
