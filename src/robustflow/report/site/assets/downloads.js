"use strict";
// Export the numbers in the page as files, and search the findings of the audit. Text that a spreadsheet would run as a
// formula is prefixed with an apostrophe.
const { data } = window.robustflow;
const COLUMNS = ["benchmark", "setting", "model", "metric", "corruption", "value", "sample_set", "note", "origin"];

// Means over corruption classes are omitted because they can be computed from the other values.
function records() {
  return data.boards.flatMap(({ name, exported, sections }) =>
    sections.flatMap(({ lines }) => lines).flatMap((line) => {
      const texts = line.texts.split("\t");
      const rest = [line.frames ?? "", line.note ?? "", line.source];
      return exported
        .filter(([index]) => texts[index] !== "-")
        .map(([index, metric, corruption]) => [name, line.setting, line.name, metric, corruption, texts[index], ...rest]);
    }),
  );
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

// The text of a cell, without what narrow screens show beside the name.
function shownText(cell) {
  const copy = cell.cloneNode(true);
  for (const part of copy.querySelectorAll(".of-narrow")) part.remove();
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

// Checks with a hit are opened.
for (const audit of document.querySelectorAll(".audit")) {
  const box = audit.querySelector("input");
  box.addEventListener("input", () => {
    const wanted = box.value.trim().toLowerCase();
    let found = 0;
    for (const check of audit.querySelectorAll("details")) {
      let here = 0;
      for (const row of check.querySelectorAll("tbody tr")) {
        row.hidden = !row.textContent.toLowerCase().includes(wanted);
        here += !row.hidden;
      }
      check.hidden = here === 0;
      check.open = wanted !== "" && here > 0;
      found += here;
    }
    audit.querySelector("output").textContent = wanted === "" ? "" : `${found} finding${found === 1 ? "" : "s"}`;
  });
}
