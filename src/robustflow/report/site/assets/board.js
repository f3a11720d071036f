"use strict";
// The leaderboard: makes the lines of the page's data, sorts, hides and counts them.
const { data, make, settingChip } = window.robustflow;
const form = document.getElementById("controls");

function cellOf(entry, key, hidden) {
  const text = entry.values?.[key] || "–";
  const best = entry.best?.includes(key);
  const kind = best ? "best" : entry.derived?.includes(key) ? "derived" : "";
  const interval = entry.intervals?.[key];
  return make("td", { class: kind, hidden }, best ? make("b", {}, text) : text, interval ? make("small", {}, interval) : null);
}

function lineOf(entry, columns, head) {
  const link = make("a", { href: `#model=${entry.page}` }, entry.name || "(no name)");
  const name = make("th", { scope: "row" }, link, entry.remark ? make("small", {}, entry.remark) : null);
  const cells = columns.map((key, index) => cellOf(entry, key, head[index + 2].hidden));
  const attributes = { "data-setting": entry.setting, "data-page": entry.page, "data-doubted": entry.doubted ?? false };
  return make("tr", attributes, name, make("td", {}, settingChip(entry.setting)), ...cells);
}

document.querySelectorAll("div.board").forEach((element, index) => {
  const { columns, groups } = data.boards[index];
  const head = [...element.querySelectorAll("thead th")];
  element.querySelectorAll("tbody").forEach((body, group) => {
    body.append(...groups[group].map((entry) => lineOf(entry, columns, head)));
  });
});

const boards = [...document.querySelectorAll("div.board")].map((element) => ({
  element,
  label: element.querySelector("h3").textContent,
  tools: form.querySelector(`.of-board[data-board="${element.dataset.board}"]`),
  head: [...element.querySelectorAll("thead th")],
  bodies: [...element.querySelectorAll("tbody")].map((body) => ({
    body,
    heading: body.rows[0],
    lines: [...body.rows].slice(1),
  })),
  start: Number(element.querySelector("table").dataset.start),
  view: "overview",
  metric: "",
}));
const search = document.getElementById("search");
const count = document.getElementById("count");

for (const board of boards) {
  board.sort = board.start;
  board.down = false;
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
}

function cellKey(line, index, text) {
  const shown = line.cells[index].textContent;
  if (text) return shown.toLowerCase();
  const number = parseFloat(shown);
  return Number.isNaN(number) ? null : number;
}

// Within its group only: lines of different groups were measured on different frames. What is missing comes last, and
// after it models that are doubted, whose numbers are not ranked.
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
      const [s, t] = [a, b].map((line) => Number("doubted" in line.dataset));
      if (s !== t && !text) return s - t;
      const [x, y] = [keys.get(a), keys.get(b)];
      if (x === null || y === null) return (x === null) - (y === null);
      return sign * (text ? x.localeCompare(y) : x - y);
    });
    body.append(...lines);
  }
}

function showColumns(board) {
  board.head.forEach((heading, index) => {
    if (index < 2) return;
    const { views, metric } = heading.dataset;
    const hidden = !views.split(" ").includes(board.view) || (metric !== undefined && metric !== board.metric);
    if (heading.hidden === hidden) return;
    heading.hidden = hidden;
    for (const { lines } of board.bodies) for (const line of lines) line.cells[index].hidden = hidden;
  });
  if (board.head[board.sort].hidden) {
    board.sort = Math.max(0, board.head.findIndex((heading, index) => index > 1 && !heading.hidden));
    board.down = false;
    sortLines(board);
  }
}

function current() {
  const chosen = form.querySelector("input[name=benchmark]:checked");
  return boards[chosen === null ? 0 : Number(chosen.value)];
}

function settingOf(board) {
  return board.tools.querySelector("fieldset input:checked")?.value ?? "";
}

function showLines() {
  const board = current();
  const wanted = search.value.trim().toLowerCase();
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
  count.textContent = `${visible} of ${all} rows`;
}

function update() {
  const board = current();
  for (const other of boards) {
    other.element.hidden = other !== board;
    other.tools.hidden = other !== board;
  }
  const [view, metric] = ["view", "metric"].map((part) => board.tools.querySelector(`[data-part=${part}]`));
  if (view !== null) {
    metric.disabled = view.value === "overview";
    [board.view, board.metric] = [view.value, metric.value];
    showColumns(board);
  }
  showLines();
}

function remember() {
  const board = current();
  const state = new URLSearchParams();
  if (board !== boards[0]) state.set("benchmark", board.label);
  if (settingOf(board)) state.set("setting", settingOf(board));
  if (board.view !== "overview") {
    state.set("columns", board.view);
    state.set("metric", board.metric);
  }
  if (search.value) state.set("search", search.value);
  if (board.sort !== board.start || board.down) state.set("sort", `${board.sort}${board.down ? "-" : ""}`);
  window.robustflow.remember(state);
}

function choose(inputs, value) {
  for (const input of inputs) if (input.value === value) input.checked = true;
}

window.robustflow.listeners.push((state) => {
  const index = boards.findIndex((board) => board.label === state.get("benchmark"));
  choose(form.querySelectorAll("input[name=benchmark]"), String(Math.max(0, index)));
  const board = current();
  choose(board.tools.querySelectorAll("fieldset input"), state.get("setting") ?? "");
  for (const [part, key] of [["view", "columns"], ["metric", "metric"]]) {
    const select = board.tools.querySelector(`[data-part=${part}]`);
    const values = select === null ? [] : [...select.options].map((option) => option.value);
    if (values.length) select.value = values.includes(state.get(key)) ? state.get(key) : values[0];
  }
  search.value = state.get("search") ?? "";
  update();
  const [, column, down] = /^(\d{1,4})(-?)$/.exec(state.get("sort") ?? "") ?? [];
  if (column !== undefined && board.head[column] && !board.head[column].hidden) {
    [board.sort, board.down] = [Number(column), down === "-"];
    sortLines(board);
  }
});

form.addEventListener("input", () => {
  update();
  remember();
});
form.addEventListener("submit", (event) => event.preventDefault());
update();
