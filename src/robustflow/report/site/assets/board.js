"use strict";
// The leaderboard: builds the lines from the page's data; sorts, filters and counts them; and shows the section of one
// benchmark.
const { data, make, settingChip } = window.robustflow;
const chooser = document.getElementById("chooser");
const narrow = matchMedia("(max-width: 40rem)").matches;

function cellOf(entry, key, hidden) {
  const text = entry.values?.[key] || "–";
  const best = entry.best?.includes(key);
  const kind = best ? "best" : entry.derived?.includes(key) ? "derived" : "";
  const interval = entry.intervals?.[key];
  return make("td", { class: kind, hidden }, best ? make("b", {}, text) : text, interval ? make("small", {}, interval) : null);
}

function lineOf(entry, columns, head) {
  const link = make("a", { href: `#model=${entry.page}` }, entry.name || "(no name)");
  const small = make("small", { class: "of-narrow" }, settingChip(entry.setting));
  const name = make("th", { scope: "row" }, link, small, entry.remark ? make("small", {}, entry.remark) : null);
  const cells = columns.map((key, index) => cellOf(entry, key, head[index + 2].hidden));
  const attributes = { "data-setting": entry.setting, "data-page": entry.page, "data-excluded": entry.excluded ?? false };
  return make("tr", attributes, name, make("td", {}, settingChip(entry.setting)), ...cells);
}

document.querySelectorAll("div.board").forEach((element, index) => {
  const { columns, groups } = data.boards[index];
  const head = [...element.querySelectorAll("thead th")];
  element.querySelectorAll("tbody").forEach((body, group) => {
    body.append(...groups[group].map((entry) => lineOf(entry, columns, head)));
  });
});

const boards = [...document.querySelectorAll("div.board")].map((element, index) => ({
  element,
  label: element.closest("section").querySelector("h2").textContent,
  parts: document.querySelectorAll(`section.benchmark[data-board="${index}"], nav [data-board="${index}"]`),
  tools: element.querySelector(".controls"),
  view: element.querySelector("[data-part=view]"),
  metric: element.querySelector("[data-part=metric]"),
  search: element.querySelector("[data-part=search]"),
  count: element.querySelector(".count"),
  head: [...element.querySelectorAll("thead th")],
  bodies: [...element.querySelectorAll("tbody")].map((body) => ({
    body,
    heading: body.rows[0],
    lines: [...body.rows].slice(1),
  })),
  start: Number(element.querySelector("table").dataset.start),
}));

for (const board of boards) {
  board.sort = board.start;
  board.down = false;
  const views = board.view === null ? [] : [...board.view.options].map((option) => option.value);
  board.usual = narrow && views.includes("compact") ? "compact" : "overview";
  if (board.view !== null) board.view.value = board.usual;
  board.tools.open = !narrow;
  board.head.forEach((heading, index) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => {
      board.down = board.sort === index && !board.down;
      board.sort = index;
      sortLines(board);
      remember();
    });
  });
  board.tools.addEventListener("input", () => {
    update(board);
    remember();
  });
}

// Excludes text that is only for screen readers or narrow screens.
function textOf(cell) {
  return (cell.querySelector("a") ?? cell).textContent;
}

function cellKey(line, index, text) {
  const shown = textOf(line.cells[index]);
  if (text) return shown.toLowerCase();
  const number = parseFloat(shown);
  return Number.isNaN(number) ? null : number;
}

// Sort within a group only: lines of different groups were measured on different frames. Missing values come last,
// followed by models that are not ranked.
function sortLines(board) {
  const { sort, down } = board;
  const text = board.head[sort].dataset.kind === "text";
  const sign = down ? -1 : 1;
  board.head.forEach((heading, index) => {
    if (index === sort) heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    else heading.removeAttribute("aria-sort");
  });
  for (const { body, lines } of board.bodies) {
    const keys = new Map(lines.map((line) => [line, cellKey(line, sort, text)]));
    lines.sort((a, b) => {
      const [s, t] = [a, b].map((line) => Number("excluded" in line.dataset));
      if (s !== t && !text) return s - t;
      const [x, y] = [keys.get(a), keys.get(b)];
      if (x === null || y === null) return (x === null) - (y === null);
      return sign * (text ? x.localeCompare(y) : x - y);
    });
    body.append(...lines);
  }
}

// The sort column is always shown.
function showColumns(board) {
  const view = board.view?.value ?? "overview";
  const metric = board.metric?.value;
  if (board.metric !== null) board.metric.closest("label").hidden = ["overview", "compact"].includes(view);
  board.element.classList.toggle("compact", view === "compact");
  board.head.forEach((heading, index) => {
    if (index === 0) return;
    const hidden = !heading.dataset.views.split(" ").includes(view) || (heading.dataset.metric ?? metric) !== metric;
    if (heading.hidden === hidden && index > 1) return;
    heading.hidden = hidden;
    for (const { lines } of board.bodies) for (const line of lines) line.cells[index].hidden = hidden;
  });
  if (board.head[board.sort].hidden) {
    const start = board.head[board.start].hidden ? board.head.findIndex((heading, index) => index > 1 && !heading.hidden) : board.start;
    board.sort = Math.max(0, start);
    board.down = false;
    sortLines(board);
  }
}

function current() {
  const chosen = chooser?.querySelector("input:checked");
  return boards[chosen ? Number(chosen.value) : 0];
}

function settingOf(board) {
  return board.tools.querySelector("fieldset input:checked")?.value ?? "";
}

function showLines(board) {
  const wanted = board.search.value.trim().toLowerCase();
  const setting = settingOf(board);
  let visible = 0;
  let all = 0;
  for (const { heading, lines } of board.bodies) {
    let here = 0;
    for (const line of lines) {
      const fits = (setting === "" || line.dataset.setting === setting) && cellKey(line, 0, true).includes(wanted);
      line.hidden = !fits;
      here += fits;
    }
    heading.hidden = here === 0;
    visible += here;
    all += lines.length;
  }
  board.count.textContent = `${visible} of ${all} rows`;
}

function update(board) {
  showColumns(board);
  showLines(board);
}

// Show one benchmark at a time: its table, sentences, figures, pictures and checks. A model's page shows
// all benchmarks, because the model may have been measured on several.
function showSection(all = false) {
  const shown = current();
  boards.forEach((board) => {
    for (const part of board.parts) part.hidden = board !== shown && !(all && part.matches("section"));
  });
  const number = String(boards.indexOf(shown));
  for (const part of document.querySelectorAll("[data-only]")) part.hidden = part.dataset.only !== number;
}
window.robustflow.showSection = showSection;

function remember() {
  const board = current();
  const state = new URLSearchParams();
  const view = board.view?.value ?? board.usual;
  if (board !== boards[0]) state.set("benchmark", board.label);
  if (settingOf(board)) state.set("setting", settingOf(board));
  if (view !== board.usual) state.set("columns", view);
  if (board.metric !== null && !board.metric.closest("label").hidden) state.set("metric", board.metric.value);
  if (board.search.value) state.set("search", board.search.value);
  if (board.sort !== board.start || board.down) state.set("sort", `${board.sort}${board.down ? "-" : ""}`);
  window.robustflow.remember(state);
}

function choose(inputs, value) {
  for (const input of inputs) if (input.value === value) input.checked = true;
}

function select(list, value, usual) {
  if (list === null) return;
  list.value = [...list.options].some((option) => option.value === value) ? value : usual;
}

window.robustflow.listeners.push((state) => {
  const index = boards.findIndex((board) => board.label === state.get("benchmark"));
  choose(chooser?.querySelectorAll("input") ?? [], String(Math.max(0, index)));
  showSection();
  const board = current();
  choose(board.tools.querySelectorAll("fieldset input"), state.get("setting") ?? "");
  select(board.view, state.get("columns"), board.usual);
  select(board.metric, state.get("metric"), board.metric?.options[0].value);
  board.search.value = state.get("search") ?? "";
  update(board);
  const [, column, down] = /^(\d{1,4})(-?)$/.exec(state.get("sort") ?? "") ?? [];
  if (column !== undefined && board.head[column] && !board.head[column].hidden) {
    [board.sort, board.down] = [Number(column), down === "-"];
    sortLines(board);
  }
});

chooser?.addEventListener("input", () => {
  showSection();
  remember();
});
chooser?.addEventListener("submit", (event) => event.preventDefault());
for (const board of boards) update(board);
showSection();
