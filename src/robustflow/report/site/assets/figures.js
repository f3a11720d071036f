"use strict";
// Marks of the figures: tooltips on hover or focus, highlighting of a model in all figures, and links to its model page.
const charts = [...document.querySelectorAll(".plot")];
const tip = document.getElementById("tip");
const ofModel = new Map();
for (const element of document.querySelectorAll(".plot [data-page], .board tr[data-page]")) {
  const { page } = element.dataset;
  if (!ofModel.has(page)) ofModel.set(page, []);
  ofModel.get(page).push(element);
}
let lit = null;
let pinned = null;

function light(page) {
  if (page === lit) return;
  for (const element of ofModel.get(lit) ?? []) element.classList.remove("on");
  for (const element of ofModel.get(page) ?? []) element.classList.add("on");
  lit = page;
  for (const chart of charts) chart.classList.toggle("dim", page !== null && chart.querySelector(".on") !== null);
}

function say(mark) {
  tip.hidden = mark === null;
  light(mark?.dataset.page ?? pinned);
  if (mark === null) return;
  tip.textContent = mark.dataset.label;
  const box = mark.getBoundingClientRect();
  const wide = document.documentElement.clientWidth;
  const left = Math.min(Math.max(8, box.x + box.width / 2 - tip.offsetWidth / 2), wide - tip.offsetWidth - 8);
  const above = box.y - tip.offsetHeight - 8;
  tip.style.left = `${left}px`;
  tip.style.top = `${above > 4 ? above : box.bottom + 8}px`;
}

function follow(mark) {
  if (mark.dataset.page) location.hash = `model=${mark.dataset.page}`;
}

for (const chart of charts) {
  const marks = [...chart.querySelectorAll(".mark")];
  if (marks.length === 0) continue;
  // A figure with focusable marks is no longer a single image.
  chart.setAttribute("role", "group");
  marks.forEach((mark, index) => {
    mark.setAttribute("role", "img");
    mark.setAttribute("aria-label", mark.dataset.label);
    mark.setAttribute("tabindex", index === 0 ? "0" : "-1");
  });
  const go = (from, to) => {
    const next = marks[Math.max(0, Math.min(marks.length - 1, to))];
    marks[from].setAttribute("tabindex", "-1");
    next.setAttribute("tabindex", "0");
    next.focus();
  };
  chart.addEventListener("keydown", (event) => {
    const at = marks.indexOf(event.target);
    const steps = { ArrowRight: at + 1, ArrowDown: at + 1, ArrowLeft: at - 1, ArrowUp: at - 1, Home: 0, End: marks.length };
    if (at < 0) return;
    if (event.key === "Enter") follow(marks[at]);
    else if (event.key === "Escape") say(null);
    else if (event.key in steps) go(at, steps[event.key]);
    else return;
    event.preventDefault();
  });
  chart.addEventListener("focusin", (event) => say(event.target.closest(".mark")));
  chart.addEventListener("focusout", () => say(null));
  chart.addEventListener("pointerover", (event) => say(event.target.closest(".mark")));
  chart.addEventListener("pointerleave", () => say(null));
  chart.addEventListener("click", (event) => {
    const mark = event.target.closest(".mark");
    if (mark !== null) follow(mark);
  });
}
// Two drawings of the same curves, of which one is shown: a shared scale for all panels, or a separate scale for each.
for (const choice of document.querySelectorAll("input[data-apart]")) {
  choice.addEventListener("change", () => {
    const drawings = document.querySelectorAll(`[data-scale="${choice.dataset.apart}"]`);
    drawings.forEach((drawing, index) => { drawing.hidden = choice.checked !== (index === 1); });
  });
}
for (const table of document.querySelectorAll(".board table")) {
  table.addEventListener("pointerover", (event) => light(event.target.closest("tr[data-page]")?.dataset.page ?? pinned));
  table.addEventListener("pointerleave", () => light(pinned));
}

// A model's page only shows figures that include the model, highlighted, from all benchmarks.
window.robustflow.highlight = (page) => {
  pinned = page;
  light(page);
  for (const part of document.querySelectorAll(".figures-of")) {
    for (const figure of part.querySelectorAll("figure.drawn")) {
      figure.hidden = page !== null && figure.querySelector(`[data-page="${page}"]`) === null;
    }
    for (const group of part.querySelectorAll(".figure-group")) {
      const here = group.querySelector("figure.drawn:not([hidden])") !== null;
      group.hidden = !here;
      if (page !== null && here) group.open = true;
    }
    part.hidden = page !== null && part.querySelector("figure.drawn:not([hidden])") === null;
  }
};
