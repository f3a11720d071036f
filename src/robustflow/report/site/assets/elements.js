"use strict";
// The page's data, and elements made of it. What comes from outside becomes text or an attribute's value, never markup.
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

// What a setting means, "" for one that a file names.
function settingMeaning(setting) {
  return data.settings[setting]?.[2] ?? "";
}

window.robustflow = { data, make, settingChip, settingMeaning, listeners: [], highlight() {}, showSection() {} };
