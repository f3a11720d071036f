"use strict";
// Meaning of the URL fragment: `model=ID` is a model's page (with `panel=N` at one of its pictures), `key=value&...`
// the state of the leaderboard, anything else an ordinary anchor. Changes to the leaderboard replace the current history
// entry; opening a model adds a new one.
const overview = document.querySelectorAll("[data-overview]");
const { data, modelPage } = window.robustflow;
const primary = document.getElementById("primary");
const place = document.getElementById("model");
const title = document.title;
let shown = null;
if (primary.dataset.page) primary.append(modelPage(primary.dataset.page, true));

function parsed() {
  const text = location.hash.slice(1);
  return text.includes("=") ? new URLSearchParams(text) : null;
}

function open(wanted) {
  const id = wanted !== null && wanted !== undefined && Object.hasOwn(data.models, wanted) ? wanted : null;
  const isPrimary = id !== null && id === primary.dataset.page;
  for (const part of overview) part.hidden = id !== null;
  primary.hidden = id !== null && !isPrimary;
  const page = id === null ? null : isPrimary ? primary.firstElementChild : modelPage(id, false);
  place.replaceChildren(...(page === null || isPrimary ? [] : [page]));
  document.documentElement.classList.toggle("one-model", page !== null);
  document.title = page === null ? title : `${page.querySelector("h2").textContent} – ${title}`;
  const left = shown;
  shown = id;
  window.robustflow.showSection(shown !== null);
  window.robustflow.highlight(shown);
  if (page !== null && left !== id) {
    window.scrollTo({ top: 0, behavior: "instant" });
    page.querySelector("h2").focus({ preventScroll: true });
  }
  return left;
}

function follow() {
  const state = parsed();
  const left = open(state?.get("model"));
  const panel = state?.has("panel") ? document.getElementById(`panel-${shown}-${state.get("panel")}`) : null;
  if (panel !== null) {
    panel.scrollIntoView({ behavior: "instant" });
    panel.focus({ preventScroll: true });
  }
  if (state !== null && !state.has("model")) {
    for (const listener of window.robustflow.listeners) listener(state);
  }
  if (state === null && location.hash.length > 1) document.getElementById(location.hash.slice(1))?.scrollIntoView();
  if (left !== null && shown === null) {
    const rows = [...document.querySelectorAll("section.benchmark:not([hidden]) .board tr[data-page]")];
    rows.find((row) => row.dataset.page === left && !row.hidden)?.querySelector("a").focus();
  }
}

// The board's script calls this after each change.
window.robustflow.remember = (state) => {
  if (shown !== null) return;
  const text = state.toString();
  history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
};

const theme = document.getElementById("theme");
const themes = ["auto", "light", "dark"];
function setTheme(name) {
  if (name === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = name;
  theme.textContent = `Theme: ${name}`;
  theme.dataset.name = name;
}
theme.addEventListener("click", () => {
  const next = themes[(themes.indexOf(theme.dataset.name) + 1) % themes.length];
  setTheme(next);
  try {
    localStorage.setItem("robustflow-theme", next);
  } catch {
    // A page opened from disk may have no storage; the choice is then lost when the page is closed.
  }
});
let kept = null;
try {
  kept = localStorage.getItem("robustflow-theme");
} catch {
  kept = null;
}
setTheme(themes.includes(kept) ? kept : "auto");

for (const part of document.querySelectorAll(".needs-script")) part.hidden = false;
window.addEventListener("hashchange", follow);
document.addEventListener("DOMContentLoaded", follow);
