"use strict";
// Show faults in the page: readers do not see the console.
function showFault(words) {
  const place = document.getElementById("faults");
  place.hidden = false;
  place.textContent = [place.textContent, "A figure could not be drawn: " + words].filter(Boolean).join(" ");
}
window.addEventListener("error", (event) => showFault(event.message));
window.addEventListener("unhandledrejection", (event) => showFault(String(event.reason)));

// Print tables that are folded on the screen.
let folded = [];
window.addEventListener("beforeprint", () => {
  folded = [...document.querySelectorAll("details:not([open])")];
  folded.forEach((part) => { part.open = true; });
});
window.addEventListener("afterprint", () => folded.forEach((part) => { part.open = false; }));

// A link to a folded section unfolds it.
function unfold() {
  const part = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  const folded = part && part.querySelector(":scope > details");
  if (folded) {
    folded.open = true;
    part.scrollIntoView();
  }
}
window.addEventListener("hashchange", unfold);
document.addEventListener("click", (event) => {
  if (event.target.closest("nav a")) setTimeout(unfold);
});
unfold();
