// Elements of the page, made from text alone: what a study names is never read as HTML.

export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (name === "style") Object.entries(value).forEach(([key, own]) => element.style.setProperty(key, own));
    else if (name in element && !name.startsWith("aria") && name !== "list") element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

// The same of a drawing (SVG).
export function s(tag, attributes, words = "") {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.textContent = words;
  return element;
}

// Classes of a cell shaded by a share: from where on words read better in the other colour, on light and on dark pages.
// Each limit is where black and white both have a contrast of 4.5 on the shade; it differs for shades against (orange).
export function shade(share, against = false) {
  return `${share >= (against ? 0.97 : 0.93) ? " over" : ""}${share >= (against ? 0.64 : 0.62) ? " over-dark" : ""}${against ? " against" : ""}`;
}

// What the server answers; a fault is an error with its sentence.
export async function ask(path) {
  return answered(await fetch(path, { headers: { accept: "application/json" } }));
}

export async function change(path, content = {}) {
  return answered(await fetch(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(content) }));
}

async function answered(response) {
  const text = await response.text();
  let content = {};
  try { content = JSON.parse(text); } catch { content = { fault: text || response.statusText }; }
  if (!response.ok) throw new Error(content.fault || `the server answered ${response.status}`);
  return content;
}

export function tell(words, kind = "") {
  const place = document.getElementById("told"), line = h("p", { class: kind }, words);
  place.replaceChildren(line);
  setTimeout(() => line.remove(), 9000);
}

// A time as an engineer says it: of today the hour, else the day too.
export function when(iso) {
  const time = new Date(iso);
  if (isNaN(time)) return "";
  const hour = time.toTimeString().slice(0, 5), today = new Date().toDateString() === time.toDateString();
  return today ? hour : `${time.toLocaleDateString("sv")} ${hour}`;  // year, month, day, as local as the hour
}

export function lasting(seconds) {
  const s = Math.max(0, Math.round(seconds));
  return s < 60 ? `${s} s` : s < 3600 ? `${Math.floor(s / 60)} min ${s % 60} s` : `${Math.floor(s / 3600)} h ${Math.floor(s / 60) % 60} min`;
}

export function panel(title, ...children) {
  return h("section", { class: "panel" }, title ? h("h2", {}, title) : null, ...children);
}

export function table(heads, rows) {
  return h("div", { class: "wide" }, h("table", {},
    h("thead", {}, h("tr", {}, heads.map((head) => h("th", { scope: "col", class: head.words ? "words" : "" }, head.title ?? head)))),
    h("tbody", {}, rows)));
}

// A figure of the report, drawn by the server from the tables; words appear under the mouse.
export function figure(path, name, label) {
  const place = h("figure", { class: "paper", "aria-label": label }, h("p", { class: "soft" }, "Drawing …"));
  fetch(path).then(async (response) => {
    const text = await response.text();
    if (!response.ok) throw new Error(JSON.parse(text).fault);
    const drawn = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
    drawn.setAttribute("role", "img");
    drawn.setAttribute("aria-label", label);
    place.replaceChildren(document.importNode(drawn, true), h("figcaption", {}, label));
    place.dataset.drawn = name;
  }).catch((fault) => place.replaceChildren(h("p", { class: "soft" }, fault.message)));
  return place;
}
