"use strict";
// Search among the findings of the audit; checks with a hit open.
const box = document.getElementById("search-findings");
const hits = document.getElementById("count-findings");
box?.addEventListener("input", () => {
  const wanted = box.value.trim().toLowerCase();
  let found = 0;
  for (const check of document.querySelectorAll(".findings")) {
    let here = 0;
    for (const row of check.querySelectorAll("[data-finding]")) {
      row.hidden = !row.textContent.toLowerCase().includes(wanted);
      here += !row.hidden;
    }
    check.hidden = here === 0;
    check.open = wanted !== "" && here > 0;
    found += here;
  }
  hits.textContent = wanted === "" ? "" : `${found} finding${found === 1 ? "" : "s"}`;
});
