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

// The explanation of a setting; "" for settings named in a file.
function settingMeaning(setting) {
  return data.settings[setting]?.[2] ?? "";
}

window.robustflow = { data, make, settingChip, settingMeaning, listeners: [], highlight() {}, showSection() {} };
