"use strict";

// What a preview shows. Text of the server and of files is only ever set as textContent; addresses of pictures are the
// server's own data.
const $ = (id) => document.getElementById(id);
const NUMBERS = [
  ["epe", "EPE", "px"], ["epe_clean", "clean EPE", "px"], ["cre", "CRE", "px"],
  ["crer", "CREr", ""], ["rcre", "RCRE", "px"], ["fl", "Fl-all", "%"],
];

function element(tag, text, attributes = {}) {
  const made = document.createElement(tag);
  if (text) made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

function complain(text) {
  $("error").textContent = text;
  $("error").hidden = !text;
}

function figure(value) { return value === null ? "–" : value.toFixed(3); }

function showNumbers(result) {
  $("numbers").replaceChildren(...NUMBERS.filter(([name]) => result.numbers[name] !== null).map(([name, label, unit]) => {
    const box = element("div");
    const value = element("dd");
    value.append(element("data", figure(result.numbers[name]), { value: result.numbers[name], id: `number-${name}` }));
    if (unit) value.append(" ", element("small", unit));
    box.append(element("dt", label), value);
    return box;
  }));
  const unknown = result.invalid ? ` ${result.invalid} predicted pixels are NaN or infinite and left out.` : "";
  if (unknown) complain(unknown.trim());
  $("call").textContent = result.call;
  $("call").hidden = false;
  $("radius").textContent = `${result.radius.toPrecision(3)} px`;
}

function clearResults() {
  for (const id of ["numbers", "pictures", "sweep-rows"]) $(id).replaceChildren();
  $("call").hidden = $("sweep-box").hidden = true;
  $("radius").textContent = "–";
}

function picture(name) {
  const box = element("figure", "", { "data-name": name });
  const enlarge = element("button", "", { type: "button", "aria-pressed": "false", title: "Larger or smaller" });
  enlarge.append(element("img"));
  enlarge.addEventListener("click", () => {
    enlarge.setAttribute("aria-pressed", String(box.classList.toggle("wide")));
    box.scrollIntoView({ block: "nearest" });
  });
  box.append(enlarge, element("figcaption"));
  return box;
}

function showPictures(result) {
  const error = result.truth ? "End-point error of the corrupted flow (grey: unknown)" : "Difference of the two flows";
  const captions = {
    frame1: "Frame 1", frame2: "Frame 2", corrupted1: "Corrupted frame 1", corrupted2: "Corrupted frame 2",
    clean_flow: "Flow on the clean frames", flow: "Flow on the corrupted frames",
    truth_flow: "Ground truth (black: unknown)", error,
  };
  const before = Object.fromEntries([...$("pictures").children].map((one) => [one.dataset.name, one]));
  const keep = result.pictures.frame1 ? {} : before;
  const figures = [];
  for (const [name, caption] of Object.entries(captions)) {
    const address = result.pictures[name];
    if (!address) { if (keep[name]) figures.push(keep[name]); continue; }
    const box = before[name] || picture(name);
    const image = box.querySelector("img");
    [image.width, image.height] = result.size;
    image.alt = caption;
    image.src = address;
    box.querySelector("figcaption").textContent = caption;
    figures.push(box);
  }
  $("pictures").replaceChildren(...figures);
}
