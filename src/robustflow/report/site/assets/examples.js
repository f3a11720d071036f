"use strict";
// The slider over example pictures: one corruption at one severity beside the clean frame.
const which = document.getElementById("slider-corruption");
const severity = document.getElementById("slider-severity");
const pictures = [...document.querySelectorAll("#slider [data-severity]")];
function show() {
  let there = false;
  for (const picture of pictures) {
    picture.hidden = picture.dataset.corruption !== which.value || picture.dataset.severity !== severity.value;
    there ||= !picture.hidden;
  }
  document.getElementById("slider-absent").hidden = there;
  document.getElementById("slider-shown").textContent = severity.value;
  severity.setAttribute("aria-valuetext", `${which.selectedOptions[0].textContent}, severity ${severity.value}`);
}
// A corruption is first shown at a severity that was run: the one nearest to where the slider stands.
function choose() {
  const run = pictures.filter((p) => p.dataset.corruption === which.value).map((p) => Number(p.dataset.severity));
  const away = (level) => Math.abs(level - Number(severity.value));
  if (run.length) severity.value = run.reduce((best, level) => (away(level) < away(best) ? level : best));
  show();
}
if (which !== null) {
  which.addEventListener("input", choose);
  severity.addEventListener("input", show);
  choose();
}
