"use strict";
// The leaderboards: built from the page's data; sorted, filtered and counted; one benchmark is shown at a time.
const { data, make, settingChip, textsOf, cellOf, scroll } = window.robustflow;
const chooser = document.getElementById("chooser");
const narrow = matchMedia("(max-width: 40rem)").matches;

function headingOf({ label, help = "", unit = "", views = [], metric = "" }, index, start) {
  const [hidden, sorted] = [!views.includes("overview"), index === start ? "ascending" : ""];
  const attributes = { scope: "col", title: help, "data-views": views.join(" "), "data-metric": views.includes("overview") ? "" : metric };
  return make("th", { ...attributes, hidden, "aria-sort": sorted }, label, unit ? " " : "", unit ? make("small", {}, unit) : null);
}

function rowOf(entry, columns, shown) {
  const link = make("a", { href: `#model=${entry.page}` }, entry.name || "(no name)");
  const group = shown.find((index) => columns[index].label === "Group" && textsOf(entry)[index] !== "–");
  const letters = group === undefined ? null : make("span", { class: "of-narrow" }, ` group ${textsOf(entry)[group]}`);
  const small = make("small", { class: "of-narrow" }, settingChip(entry.setting));
  const name = make("th", { scope: "row" }, link, letters, small, entry.remark ? make("small", {}, entry.remark) : null);
  const cells = shown.map((index) => cellOf(entry, index, { hidden: !columns[index].views.includes("overview") }));
  const attributes = { "data-setting": entry.setting, "data-page": entry.page, "data-excluded": entry.excluded ?? false };
  return make("tr", attributes, name, make("td", {}, settingChip(entry.setting)), ...cells);
}

function chips(settings, number) {
  const chip = (value, label, checked) => {
    const input = Object.assign(make("input", { type: "radio", name: `setting-${number}`, checked }), { value });
    return make("label", {}, input, make("span", {}, label));
  };
  const all = settings.map((name) => chip(name, data.settings[name][0], false));
  return make("fieldset", { class: "chips" }, make("legend", {}, "Setting"), chip("", "All", true), ...all);
}

function choice(label, options) {
  const list = make("select", {}, ...options.map(([value, text]) => make("option", { value }, text)));
  return [make("label", { class: "field" }, `${label} `, list), list];
}

// Build a leaderboard into its element; return its parts.
function build(element, index) {
  const { columns, sections, start, remarks, title } = data.boards[index];
  const shown = columns.flatMap((column, at) => (column.views ? [at] : []));
  const used = new Set(sections.flatMap(({ lines }) => lines.map((line) => line.setting)));
  const settings = Object.keys(data.settings).filter((name) => used.has(name));
  const views = Object.entries(data.views).filter(([view]) => shown.some((at) => columns[at].views.includes(view)));
  const metrics = [...new Set(shown.filter((at) => !columns[at].views.includes("overview")).map((at) => columns[at].metric))];
  const [viewField, view] = choice("Columns", views);
  const [metricField, metric] = choice("Metric", metrics.map((name) => [name, data.metrics[name]]));
  metric.dataset.part = "metric";
  const search = make("input", { type: "search", autocomplete: "off", spellcheck: "false", placeholder: "model" });
  const count = make("output", { class: "count", role: "status", "aria-live": "polite" });
  const several = views.length > 1;
  const fields = [settings.length > 1 ? chips(settings, index) : null, several ? viewField : null, several ? metricField : null];
  fields.push(make("label", { class: "field grow" }, "Search ", search), count);
  const tools = make("details", { class: "controls needs-script" }, make("summary", {}, "Filter and columns"), make("div", {}, ...fields));
  const texts = ["Model", "Setting"].map((text, at) =>
    make("th", { scope: "col", "data-kind": "text", "data-views": at ? "overview classes" : "" }, text),
  );
  const head = [...texts, ...shown.map((at) => headingOf(columns[at], at, start))];
  const bodies = sections.map(({ title: heading, lines }) => {
    const mixed = sections.length > 1 && lines[0].frames !== "paper";
    const apart = mixed ? make("em", {}, " different frames: not comparable with the other groups") : null;
    const group = make("th", { scope: "rowgroup", colspan: head.length }, make("span", {}, heading, apart));
    const rows = lines.map((line) => rowOf(line, columns, shown));
    const body = make("tbody", {}, make("tr", { class: "group" }, group), ...rows);
    return { body, heading: body.rows[0], lines: rows };
  });
  const caption = make("caption", { class: "aside" }, `${title}: lower errors are better.`);
  const table = make("table", {}, caption, make("thead", {}, make("tr", {}, ...head)), ...bodies.map(({ body }) => body));
  const meanings = settings.filter((name) => data.settings[name][2]).map((name) => `${data.settings[name][0]}: ${data.settings[name][2]}`);
  const below = [meanings.join("; "), ...remarks].map((text) => (text ? make("p", { class: "aside" }, text) : null));
  element.append(tools, scroll(`Leaderboard of ${title}`, table, "region"), ...below.filter((part) => part !== null));
  return {
    element, tools, search, count, head, bodies,
    view: several ? view : null,
    metric: several ? metric : null,
    label: title,
    parts: document.querySelectorAll(`section.benchmark[data-board="${index}"], nav [data-board="${index}"]`),
    start: Math.max(0, shown.indexOf(start) + 2),
    usual: narrow && views.some(([name]) => name === "compact") ? "compact" : "overview",
  };
}

const boards = [...document.querySelectorAll("div.board")].map(build);

for (const board of boards) {
  board.sort = board.start;
  board.down = false;
  if (board.view !== null) board.view.value = board.usual;
  board.tools.open = !narrow;
  board.head.forEach((heading, index) => {
    const button = make("button", { type: "button" }, ...heading.childNodes);
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

// The text or number of a cell without what only screen readers or narrow screens show; null if it is missing. Group
// letters are texts in a column of numbers.
function cellKey(line, index, text) {
  const cell = line.cells[index];
  const shown = (cell.querySelector("a") ?? cell.firstChild ?? cell).textContent;
  if (text) return shown.toLowerCase();
  const number = parseFloat(shown);
  if (!Number.isNaN(number)) return number;
  return shown === "–" ? null : shown;
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
      return sign * (typeof x === "string" ? x.localeCompare(y) : x - y);
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
    const first = board.head.findIndex((heading, index) => index > 1 && !heading.hidden);
    board.sort = Math.max(0, board.head[board.start].hidden ? first : board.start);
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

function update(board) {
  showColumns(board);
  const wanted = board.search.value.trim().toLowerCase();
  const setting = settingOf(board);
  let [visible, all] = [0, 0];
  for (const { heading, lines } of board.bodies) {
    let here = 0;
    for (const line of lines) {
      line.hidden = !((setting === "" || line.dataset.setting === setting) && cellKey(line, 0, true).includes(wanted));
      here += !line.hidden;
    }
    heading.hidden = here === 0;
    visible += here;
    all += lines.length;
  }
  board.count.textContent = `${visible} of ${all} rows`;
}

// Show one benchmark at a time: its table, figures, pictures and checks. A model's page shows all benchmarks, because the
// model may have been measured on several.
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
  if (list !== null) list.value = [...list.options].some((option) => option.value === value) ? value : usual;
}

window.robustflow.listeners.push((state) => {
  const index = boards.findIndex((board) => board.label === state.get("benchmark"));
  choose(chooser?.querySelectorAll("input") ?? [], String(Math.max(0, index)));
  showSection();
  const board = current();
  choose(board.tools.querySelectorAll("fieldset input"), state.get("setting") ?? "");
  select(board.view, state.get("columns"), board.usual);
  select(board.metric, state.get("metric"), board.metric?.options[0]?.value);
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
