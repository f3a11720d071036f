"use strict";

// Show a preview. Text from the server or from files is only ever set as textContent; picture URLs are the server's own
// data.
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

// Show the numbers of one model, or of two on the same frames, each with its `label`.
function showNumbers(results) {
  const [result] = results;
  $("numbers").replaceChildren(...NUMBERS.filter(([name]) => result.numbers[name] !== null).map(([name, label, unit]) => {
    const box = element("div");
    box.append(element("dt", label));
    results.forEach((one, index) => {
      const value = element("dd");
      value.append(element("data", figure(one.numbers[name]), { value: one.numbers[name], id: `number-${name}${index ? "-second" : ""}` }));
      if (unit) value.append(" ", element("small", unit));
      if (results.length > 1) value.append(" ", element("small", one.label));
      box.append(value);
    });
    return box;
  }));
  const unknown = results.filter((one) => one.invalid).map((one) => `${one.invalid} pixels predicted by ${one.label} are NaN or infinite and are left out.`);
  if (unknown.length) complain(unknown.join(" "));
  $("save").disabled = false;
  $("call").textContent = result.call;
  $("call").hidden = false;
  $("radius").textContent = `${result.radius.toPrecision(3)} px`;
}

function clearResults() {
  for (const id of ["numbers", "pictures", "sweep-rows"]) $(id).replaceChildren();
  $("call").hidden = $("sweep-box").hidden = $("save").disabled = true;
  $("radius").textContent = "–";
}

const SENT_ONCE = ["frame1", "frame2", "truth_flow"];

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

function showPictures(results) {
  const [result, second] = results;
  const error = result.truth ? "End-point error of the corrupted flow (grey: unknown)" : "Difference of the two flows";
  const colours = second && second.radius !== result.radius ? `; full colour from ${second.radius.toPrecision(3)} px` : "";
  const whose = (caption, index) => (second ? `${caption}, ${results[index].label}${index ? colours : ""}` : caption);
  const captions = {
    frame1: "Frame 1", frame2: "Frame 2", corrupted1: "Corrupted frame 1", corrupted2: "Corrupted frame 2",
  };
  const pictures = { ...result.pictures };
  const predicted = [["clean_flow", "Flow on the clean frames"], ["flow", "Flow on the corrupted frames"], ["error", error]];
  for (const [name, caption] of predicted) {
    if (name === "error") captions.truth_flow = "Ground truth (black: unknown)";
    captions[name] = whose(caption, 0);
    if (!second) continue;
    captions[`${name}_second`] = whose(caption, 1);
    pictures[`${name}_second`] = second.pictures[name];
  }
  const before = Object.fromEntries([...$("pictures").children].map((one) => [one.dataset.name, one]));
  const keep = result.pictures.frame1 ? {} : Object.fromEntries(SENT_ONCE.map((name) => [name, before[name]]));
  const figures = [];
  for (const [name, caption] of Object.entries(captions)) {
    const address = pictures[name];
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

// Save one PNG with the numbers, the call that makes the frames, and all pictures with their captions.
function save() {
  const [room, line, gap] = [640, 26, 12];
  const shown = [...$("pictures").children].map((one) => [one.querySelector("img"), one.querySelector("figcaption").textContent]);
  const numbers = [...$("numbers").children].map((box) => {
    const [label, ...values] = [...box.children].map((one) => one.textContent);
    return `${label}: ${values.join(", ")}`;
  });
  const head = [$("shown").textContent, $("status").textContent, ...numbers, $("call").textContent, `Full colour of the flow from ${$("radius").textContent}`];
  const columns = shown.length > 8 ? 3 : 2;
  const tall = Math.round((room * shown[0][0].height) / shown[0][0].width) + line + gap;
  const canvas = element("canvas", "", { width: columns * (room + gap) + gap, height: head.length * line + gap + Math.ceil(shown.length / columns) * tall });
  const context = canvas.getContext("2d");
  context.fillStyle = "#ffffff";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = "#1b1f26";
  context.font = "17px sans-serif";
  head.forEach((text, index) => context.fillText(text, gap, (index + 1) * line - 6, canvas.width - 2 * gap));
  shown.forEach(([image, caption], index) => {
    const [left, top] = [gap + (index % columns) * (room + gap), head.length * line + gap + Math.floor(index / columns) * tall];
    context.drawImage(image, left, top, room, tall - line - gap);
    context.fillText(caption, left, top + tall - gap - 6, room);
  });
  canvas.toBlob((blob) => {
    const link = element("a", "", { href: URL.createObjectURL(blob), download: "robustflow.png" });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  });
}
