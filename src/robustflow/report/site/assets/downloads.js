"use strict";
// Export the numbers in the page as files. Text that a spreadsheet would run as a formula is prefixed with an apostrophe.
const { data } = window.robustflow;
const COLUMNS = ["benchmark", "setting", "model", "metric", "corruption", "value", "sample_set", "note", "origin"];

// Means over corruption classes are omitted because they can be computed from the other values.
function records() {
  const all = [];
  for (const { benchmark, numbers, groups } of data.boards) {
    for (const entry of groups.flat()) {
      numbers.forEach(([metric, corruption], index) => {
        const value = entry.values?.[index];
        if (!value) return;
        all.push([benchmark, entry.setting, entry.name, metric, corruption, value, entry.frames ?? "", entry.note ?? "", entry.source]);
      });
    }
  }
  return all;
}

function cell(text, index) {
  const safe = COLUMNS[index] !== "value" && /^[=+\-@]/.test(text.normalize("NFKC")) ? `'${text}` : text;
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

// The text of a cell, without the chip that narrow screens show below the name.
function shownText(cell) {
  const copy = cell.cloneNode(true);
  copy.querySelector(".of-narrow")?.remove();
  return copy.textContent.trim();
}

function shownTable() {
  const lines = [];
  for (const row of document.querySelectorAll("section.benchmark:not([hidden]) .board tr:not(.group)")) {
    if (!row.hidden) lines.push([...row.cells].filter((one) => !one.hidden).map(shownText).join("\t"));
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
      copied.textContent = "This browser does not allow copying; download the CSV instead.";
    }
  },
};
for (const button of document.querySelectorAll("[data-download]")) {
  button.addEventListener("click", actions[button.dataset.download]);
}
