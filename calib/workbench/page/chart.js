// Curves over a common axis, drawn on a canvas: some thousand points of several cases stay fluid.
import { h } from "./dom.js";

const ROOM = { left: 58, right: 14, top: 12, bottom: 34 };

export const COLOURS = ["--c0", "--c1", "--c2", "--c3", "--c4", "--c5"];

export class Chart {
  constructor(label, xWords, yWords) {
    Object.assign(this, { xWords, yWords, series: [], at: null });
    this.canvas = h("canvas", { role: "img", "aria-label": label, tabIndex: 0 });
    this.tip = h("div", { class: "tip", hidden: true });
    this.element = h("div", { class: "chart" }, this.canvas, this.tip);
    new ResizeObserver(() => this.draw()).observe(this.element);
    this.canvas.addEventListener("pointermove", (event) => this.point(event.offsetX));
    this.canvas.addEventListener("pointerleave", () => this.point(null));
    this.canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!step || !this.scale) return;
      event.preventDefault();
      const at = this.places.indexOf(this.named ?? this.places.at(-1));
      this.named = this.places[Math.max(0, Math.min(this.places.length - 1, at + step))];
      this.draw();
    });
  }

  // `series`: name, colour (a variable of the style), points [x, y], dashed.
  show(series, words) {
    this.series = series;
    this.places = [...new Set(series.flatMap((one) => one.points.map(([x]) => x)))].sort((a, b) => a - b);
    this.canvas.setAttribute("aria-label", words);
    this.draw();
  }

  point(x) {
    const s = this.scale;
    const at = x === null || !s ? NaN : s.x0 + (x - ROOM.left) / s.wide * (s.x1 - s.x0);
    this.named = at >= s?.x0 && at <= s?.x1 ? this.places.reduce((best, own) => (Math.abs(own - at) < Math.abs(best - at) ? own : best)) : null;
    this.draw();
  }

  draw() {
    const ratio = devicePixelRatio || 1, wide = this.element.clientWidth, high = this.element.clientHeight;
    if (!wide || !high) return;
    const { canvas } = this, pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
      canvas.width = Math.round(wide * ratio);
      canvas.height = Math.round(high * ratio);
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, wide, high);
    pen.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    const all = this.series.flatMap((one) => one.points).filter(([, y]) => y !== null);
    if (!all.length) { this.scale = null; this.tip.hidden = true; return; }
    const log = all.every(([, y]) => y > 0);
    let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const [x, y] of all) { x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y); }
    if (x1 === x0) x1 = x0 + 1;
    const to = (y) => (log ? Math.log10(y) : y);
    let [low, up] = [to(y0), to(y1)];
    const margin = (up - low || Math.abs(up) || 1) * 0.06;
    [low, up] = [low - margin, up + margin];
    const scale = this.scale = { x0, x1, wide: wide - ROOM.left - ROOM.right, high: high - ROOM.top - ROOM.bottom };
    const px = (x) => ROOM.left + (x - x0) / (x1 - x0) * scale.wide, py = (y) => ROOM.top + (up - to(y)) / (up - low) * scale.high;
    pen.lineWidth = 1;
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const y of log ? decades(low, up) : ticks(low, up)) {
      pen.strokeStyle = colour("--rule");
      line(pen, [[ROOM.left, py(y)], [wide - ROOM.right, py(y)]]);
      pen.fillStyle = colour("--soft");
      pen.fillText(short(y), ROOM.left - 7, py(y));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const x of ticks(x0, x1).filter(Number.isInteger)) pen.fillText(short(x), px(x), high - ROOM.bottom + 6);
    pen.fillText(this.xWords, ROOM.left + scale.wide / 2, high - 14);
    pen.save();
    pen.translate(11, ROOM.top + scale.high / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(this.yWords, 0, -6);
    pen.restore();
    pen.strokeStyle = colour("--line");
    line(pen, [[ROOM.left, ROOM.top], [ROOM.left, high - ROOM.bottom], [wide - ROOM.right, high - ROOM.bottom]]);
    for (const one of this.series) {
      pen.strokeStyle = colour(one.colour);
      pen.lineWidth = one.dashed ? 1 : 2.2;
      pen.setLineDash(one.dashed ? [4, 3] : []);
      let part = [];
      for (const [x, y] of [...one.points, [0, null]]) {
        if (y !== null) part.push([px(x), py(y)]);
        else { if (part.length === 1) dot(pen, part[0], colour(one.colour)); line(pen, part); part = []; }
      }
      pen.setLineDash([]);
    }
    this.tell(px, py, pen, colour, wide);
  }

  tell(px, py, pen, colour, wide) {
    const { named, tip } = this;
    tip.hidden = named === null || named === undefined;
    if (tip.hidden) return;
    pen.strokeStyle = colour("--soft");
    pen.lineWidth = 1;
    line(pen, [[px(named), ROOM.top], [px(named), ROOM.top + this.scale.high]]);
    const lines = [`${this.xWords} ${named}`];
    for (const one of this.series) {
      const found = one.points.find(([x, y]) => x === named && y !== null);
      if (!found) continue;
      dot(pen, [px(named), py(found[1])], colour(one.colour));
      lines.push(`${one.name}  ${found[1].toPrecision(4)}`);
    }
    tip.textContent = lines.join("\n");
    const left = px(named) + 12;
    Object.assign(tip.style, { top: "16px", left: `${left + tip.offsetWidth > wide ? px(named) - 12 - tip.offsetWidth : left}px` });
  }
}

function line(pen, points) {
  if (points.length < 2) return;
  pen.beginPath();
  points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

function dot(pen, [x, y], colour) {
  pen.fillStyle = colour;
  pen.beginPath();
  pen.arc(x, y, 3.5, 0, 2 * Math.PI);
  pen.fill();
}

function ticks(low, up) {
  const rough = (up - low) / 6, size = 10 ** Math.floor(Math.log10(rough)), step = [1, 2, 5, 10].map((k) => k * size).find((s) => s >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= up; k += 1) found.push(Number((k * step).toPrecision(12)));
  return found;
}

function decades(low, up) {
  const steps = up - low > 3 ? [1] : up - low > 1.2 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9], found = [];
  for (let k = Math.floor(low); k <= up; k += 1) for (const s of steps) {
    const y = s * 10 ** k;
    if (Math.log10(y) >= low && Math.log10(y) <= up) found.push(y);
  }
  if (found.length >= 2) return found;
  return ticks(10 ** low, 10 ** up);
}

function short(value) {
  return String(Number(value.toPrecision(3)));
}
