"use strict";
// The page of a model: its numbers under every corruption, facts about the run, and a breakdown of its error.
const { data, make, settingChip, settingMeaning } = window.robustflow;
const STEPS = 10;

// The attributes of a shaded cell, from its ratio to its column's strongest value; cold colours below zero.
function heat(text, top) {
  const value = parseFloat(text);
  if (!(top > 0) || Number.isNaN(value)) return {};
  const step = Math.min(STEPS, Math.round((STEPS * Math.abs(value)) / top));
  return { class: value < 0 ? "cold" : "hot", style: `--heat: ${5 * step}%` };
}

function scroll(label, table) {
  return make("div", { class: "scroll", role: "group", "aria-label": label, tabindex: "0" }, table);
}

function tableOf(head, columns, lines, cellOf) {
  const heading = make("tr", {}, ...[head, ...columns].map((text) => make("th", { scope: "col" }, text)));
  const rows = lines.map(([label, cells]) => make("tr", {}, make("th", { scope: "row" }, label), ...cells.map(cellOf)));
  return make("table", {}, make("thead", {}, heading), make("tbody", {}, ...rows));
}

// A cell links to the picture of its frames, flow and error if there is one.
function heatTable(table, name, id, panels) {
  const cell = ([text, note, label], index) => {
    const panel = panels.findIndex((one) => one.cell[0] === label && one.cell[1] === table.columns[index]);
    const title = `${label}, severity ${table.columns[index]}: frames, flow and error`;
    const shown = panel < 0 ? text : make("a", { href: `#model=${id}&panel=${panel}`, title }, text);
    return make("td", heat(text, table.tops[index]), shown, note ? make("small", {}, note) : null);
  };
  const lines = table.lines.map(([label, texts, notes]) => [
    data.labels[label],
    (texts ? texts.split(" ") : []).map((text, index) => [text, notes ? notes[index] : "", data.labels[label]]),
  ]);
  const made = tableOf("Corruption", table.columns, lines, cell);
  return make("figure", { class: "heat" }, make("figcaption", {}, table.title), scroll(`${table.title} of ${name}`, made));
}

function scoresOf({ benchmark, setting, note, scores }) {
  const head = make("p", {}, `${benchmark} `, settingChip(setting), note ? make("em", {}, ` ${note}`) : null);
  const meaning = settingMeaning(setting);
  const tiles = scores.map(([label, text, interval]) =>
    make("div", {}, make("dt", {}, label), make("dd", {}, text, interval ? make("small", {}, interval) : null)),
  );
  return make("div", { class: "scores" }, head, make("dl", {}, ...tiles), meaning ? make("p", { class: "aside" }, `${data.settings[setting][0]}: ${meaning}.`) : null);
}

function panelOf({ title, numbers, picture, size: [width, height] }, id, index) {
  const alt = `Frames, corrupted frames, flow and error map side by side. ${numbers}`;
  const image = make("img", { src: picture, width, height, alt });
  return make("figure", { class: "panel", id: `panel-${id}-${index}`, tabindex: "-1" }, make("figcaption", {}, numbers ? `${title}: ${numbers}` : title), scroll(title, image));
}

window.robustflow.modelPage = (id, primary) => {
  const page = data.models[id];
  const name = page.name || "(no name)";
  const parts = [
    make("p", { class: "back" }, make("a", { href: "#board" }, "← Leaderboard")),
    make("h2", { class: "name", id: `title-${id}`, tabindex: "-1" }, name),
    make("div", { class: "all-scores" }, ...page.tiles.map(scoresOf)),
    ...page.sentences.map((sentence) => make("p", {}, sentence)),
    make("div", { class: "tables" }, ...page.tables.map((table) => heatTable(table, name, id, page.panels))),
  ];
  if (page.anatomy !== null) {
    const { title, columns, lines, remarks } = page.anatomy;
    parts.push(make("h3", {}, "Anatomy of the error"));
    parts.push(scroll(title, tableOf("Part", columns, lines, (text) => make("td", {}, text))));
    parts.push(...remarks.map((remark) => make("p", { class: "aside" }, remark)));
  }
  if (page.panels.length) {
    parts.push(make("h3", {}, "Predictions"), make("div", { class: "panels" }, ...page.panels.map((panel, index) => panelOf(panel, id, index))));
  }
  const facts = page.facts.map(([label, text]) => make("div", {}, make("dt", {}, label), make("dd", {}, text)));
  parts.push(make("h3", {}, "About this result"), make("dl", { class: "facts" }, ...facts));
  const attributes = { class: "model", id: `model-${id}`, "data-page": id, "data-primary": primary, "aria-labelledby": `title-${id}` };
  return make("article", attributes, ...parts);
};
