"use strict";
// The page's data, and elements built from it. Untrusted data becomes text or an attribute value, never markup.
const data = JSON.parse(document.getElementById("data").textContent);

// make("td", { class: "best", hidden: true }, "4.20", child, ...): attributes that are false, null or "" are left out.
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== "") element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== ""));
  return element;
}

function settingChip(setting) {
  const [words, kind] = data.settings[setting] ?? [setting, "set-other"];
  return make("span", { class: `chip ${kind}` }, words);
}

// The texts of a line; a dash stands for a missing number.
function textsOf(line) {
  return line.texts.split("\t").map((text) => (text === "-" ? "–" : text));
}

// A cell with its interval; `shown` replaces its text, for example by a link.
function cellOf(line, index, attributes = {}, shown = textsOf(line)[index]) {
  const best = line.best?.includes(index);
  const kind = best ? "best" : line.derived?.includes(index) ? "derived" : "";
  const interval = line.intervals?.[index];
  const content = [best ? make("b", {}, shown) : shown, interval ? make("small", {}, interval) : null];
  return make("td", { class: kind, ...attributes }, ...content);
}

function scroll(label, content, role = "group") {
  return make("div", { class: "scroll", role, "aria-label": label, tabindex: "0" }, content);
}

window.robustflow = { data, make, settingChip, textsOf, cellOf, scroll, listeners: [], highlight() {}, showSection() {} };
