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
if (which !== null) {
  which.addEventListener("input", show);
  severity.addEventListener("input", show);
  show();
}
