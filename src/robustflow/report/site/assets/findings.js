"use strict";
// Search the findings of an audit; checks with a hit are opened.
for (const audit of document.querySelectorAll(".audit")) {
  const box = audit.querySelector(".search-findings");
  const hits = audit.querySelector(".count-findings");
  box.addEventListener("input", () => {
    const wanted = box.value.trim().toLowerCase();
    let found = 0;
    for (const check of audit.querySelectorAll(".findings")) {
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
}
