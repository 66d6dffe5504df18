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
