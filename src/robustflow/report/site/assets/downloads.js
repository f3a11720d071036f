"use strict";
// Makes files of the numbers in the page. A text that a spreadsheet would run as a formula gets an apostrophe before it.
const data = JSON.parse(document.getElementById("data").textContent);
const COLUMNS = ["benchmark", "setting", "model", "metric", "corruption", "value", "sample_set", "note"];

function records() {
  const all = [];
  for (const [benchmark, setting, model, metric, sampleSet, note, ...values] of data.lines) {
    values.forEach((value, index) => {
      if (value === null) return;
      all.push([benchmark, setting, model, metric, data.corruptions[index], value, sampleSet, note]);
    });
  }
  return all;
}

function cell(text, index) {
  const safe = COLUMNS[index] !== "value" && /^[=+\-@]/.test(text) ? `'${text}` : text;
  return /[",\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}

function csv() {
  return [COLUMNS, ...records()].map((record) => record.map(cell).join(",")).join("\n") + "\n";
}

function json() {
  const named = records().map((record) =>
    Object.fromEntries(record.map((value, index) => [COLUMNS[index], COLUMNS[index] === "value" ? Number(value) : value])),
  );
  return JSON.stringify(named, null, 1) + "\n";
}

function save(text, name, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

function shownTable() {
  const lines = [];
  for (const row of document.querySelectorAll(".board:not([hidden]) tr:not(.group)")) {
    if (!row.hidden) lines.push([...row.cells].filter((one) => !one.hidden).map((one) => one.textContent.trim()).join("\t"));
  }
  return lines.join("\n") + "\n";
}

const copied = document.getElementById("copied");
const actions = {
  csv: () => save(csv(), "robustflow.csv", "text/csv"),
  json: () => save(json(), "robustflow.json", "application/json"),
  copy: async () => {
    try {
      await navigator.clipboard.writeText(shownTable());
      copied.textContent = "Copied.";
    } catch {
      copied.textContent = "This browser does not let the page copy; download the CSV.";
    }
  },
};
for (const button of document.querySelectorAll("[data-download]")) {
  button.addEventListener("click", actions[button.dataset.download]);
}
