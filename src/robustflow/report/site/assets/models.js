"use strict";
// The page of a model: tables of its means, its numbers under every corruption and its error, and facts about the run.
const { data, make, settingChip, textsOf, cellOf, scroll } = window.robustflow;
const STEPS = 10;

// The attributes of a shaded cell, from its ratio to its column's strongest value; cold colours below zero.
function heat(text, top) {
  const value = parseFloat(text);
  if (!(top > 0) || Number.isNaN(value)) return {};
  const step = Math.min(STEPS, Math.round((STEPS * Math.abs(value)) / top));
  return { class: value < 0 ? "cold" : "hot", style: `--heat: ${5 * step}%` };
}

function linesOf(table) {
  return table.sections.flatMap((section) => section.lines);
}

function tableOf({ head, columns, ...table }, cell) {
  const labels = [head, ...columns.map((column) => column.label)];
  const heading = make("tr", {}, ...labels.map((label) => make("th", { scope: "col" }, label)));
  const rows = linesOf(table).map((line) =>
    make("tr", {}, make("th", { scope: "row" }, line.name), ...columns.map((column, index) => cell(line, index, column))),
  );
  return make("table", {}, make("thead", {}, heading), make("tbody", {}, ...rows));
}

// A cell links to the picture of its frames, flow and error if there is one.
function shadedTable(table, name, id, panels) {
  const cell = (line, index, { label, top }) => {
    const text = textsOf(line)[index];
    const panel = panels.findIndex((one) => one.corruption === line.name && String(one.severity) === label);
    const title = `${line.name}, severity ${label}: frames, flow and error`;
    const link = panel < 0 ? text : make("a", { href: `#model=${id}&panel=${panel}`, title }, text);
    return cellOf(line, index, heat(text, top), link);
  };
  const shown = scroll(`${table.title} of ${name}`, tableOf(table, cell));
  return make("figure", { class: "heat" }, make("figcaption", {}, table.title), shown);
}

function scoresOf({ title, columns, sections: [{ lines: [line] }] }) {
  const setting = data.settings[line.name];
  const head = make("p", {}, `${title} `, settingChip(line.name), line.note ? make("em", {}, ` ${line.note}`) : null);
  const texts = textsOf(line);
  const tiles = columns.map(({ label }, index) => {
    const interval = line.intervals?.[index];
    return make("div", {}, make("dt", {}, label), make("dd", {}, texts[index], interval ? make("small", {}, interval) : null));
  });
  const meaning = setting?.[2] ? make("p", { class: "aside" }, `${setting[0]}: ${setting[2]}.`) : null;
  return make("div", { class: "scores" }, head, make("dl", {}, ...tiles), meaning);
}

function panelOf({ title, numbers, tiles }, id, index) {
  const pictures = tiles.map(([caption, src]) =>
    make("figure", {}, make("img", { src, alt: `${caption}. ${title}` }), make("figcaption", {}, caption)),
  );
  const caption = make("figcaption", {}, numbers ? `${title}: ${numbers}` : title);
  const attributes = { class: "panel", id: `panel-${id}-${index}`, tabindex: "-1" };
  return make("figure", attributes, caption, make("div", { class: "tiles" }, ...pictures));
}

window.robustflow.modelPage = (id, primary) => {
  const page = data.models[id];
  const name = page.name || "(no name)";
  const of = (kind) => page.tables.filter((table) => table.kind === kind);
  const parts = [
    make("p", { class: "back" }, make("a", { href: "#board" }, "← Leaderboard")),
    make("h2", { class: "name", id: `title-${id}`, tabindex: "-1" }, name),
    make("div", { class: "all-scores" }, ...of("scores").map(scoresOf)),
    make("div", { class: "tables" }, ...of("shaded").map((table) => shadedTable(table, name, id, page.panels))),
  ];
  if (page.panels.length) {
    const panels = page.panels.map((panel, index) => panelOf(panel, id, index));
    parts.push(make("h3", {}, "Predictions"), make("div", { class: "panels" }, ...panels));
  }
  for (const table of of("facts")) {
    const facts = linesOf(table).map((line) => make("div", {}, make("dt", {}, line.name), make("dd", {}, line.texts)));
    parts.push(make("h3", {}, table.title), make("dl", { class: "facts" }, ...facts));
  }
  const attributes = { class: "model", id: `model-${id}`, "data-page": id, "data-primary": primary, "aria-labelledby": `title-${id}` };
  return make("article", attributes, ...parts);
};
