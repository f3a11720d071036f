"use strict";

// Settings, requests and uploads; results.js shows the responses.
const PAGE = Math.random().toString(36).slice(2);
const PAUSE_MS = 250;
const STAGES = {
  starting: "Waiting for the model…", "loading the model": "Loading the model…", corrupting: "Corrupting…",
  "predicting the clean frames": "Predicting the clean frames…",
  "predicting the corrupted frames": "Predicting the corrupted frames…", drawing: "Drawing…",
};

let choices = null;
let source = null;      // {source, name, pairs}
let framesShown = "";   // which pair the clean frames on the page are of
let running = null;     // AbortController of what is under way
let timer = 0;

function say(text) { $("status").textContent = text; }

function busy(on) {
  $("busy").hidden = !on;
  $("results").setAttribute("aria-busy", String(on));
}

// ---- settings

function addLayer(name = "fog", severity = 3) {
  const item = element("li");
  const select = element("select", "", { "aria-label": "Corruption" });
  for (const [family, names] of Object.entries(choices.families)) {
    const group = element("optgroup", "", { label: family });
    for (const one of names) group.append(element("option", one.replaceAll("_", " "), { value: one }));
    select.append(group);
  }
  select.value = name;
  const level = element("output", String(severity));
  const range = element("input", "", { type: "range", min: 1, max: 5, step: 1, "aria-label": "Severity" });
  range.value = severity;
  range.addEventListener("input", () => { level.textContent = range.value; });
  const head = element("label", "Severity ");
  head.append(level, range);
  item.append(select, head);
  if ($("layers").children.length) {
    const remove = element("button", "Remove", { type: "button", "aria-label": `Remove corruption ${$("layers").children.length + 1}` });
    remove.addEventListener("click", () => { item.remove(); $("add").disabled = false; $("add").focus(); later(); });
    item.append(remove);
  }
  $("layers").append(item);
  $("add").disabled = $("layers").children.length >= 4;
  return item;
}

function layers() {
  return [...$("layers").children].map((item) => ({
    name: item.querySelector("select").value,
    severity: Number(item.querySelector("input").value),
  }));
}

// The one or two chosen models: {model, checkpoint, label}.
function models() {
  const chosen = ["", "second"].filter((which) => $(which || "model").value).map((which) => ({
    model: $(which || "model").value, checkpoint: $(which ? `${which}-checkpoint` : "checkpoint").value.trim(),
  }));
  for (const one of chosen) one.label = one.checkpoint ? `${one.model} (${one.checkpoint.split("/").pop()})` : one.model;
  return chosen;
}

function request(chosen, withFrames, { model, checkpoint } = models()[0]) {
  return {
    page: PAGE, source: source.source, index: Number($("pair").value) - 1, model, checkpoint,
    layers: chosen, seed: Number($("seed").value) || 0, frames: withFrames,
  };
}

// After a failed upload, remove the previous pair and its results, and do not send the file again.
function forget() {
  source = null;
  framesShown = "";
  clearResults();
  for (const id of ["frame1", "frame2", "truth", "clip"]) $(id).value = "";
  $("shown").textContent = "No frames: choose different ones, or the demo pair.";
  $("pair-field").hidden = true;
  $("use-demo").hidden = false;
  $("sweep").disabled = true;
}

function use(found) {
  source = found;
  framesShown = "";
  $("shown").textContent = found.name;
  $("pair").max = found.pairs;
  $("pair").value = 1;
  $("pair-number").textContent = "1";
  $("pair-field").hidden = found.pairs < 2;
  $("use-demo").hidden = found.source === choices.demo.source;
  later(0);
}

// ---- the server

// Kept in this tab only: a cookie would be sent to servers on other ports too.
const given = new URLSearchParams(location.search).get("token");
if (given) {
  sessionStorage.setItem("token", given);
  history.replaceState(null, "", "/");
}

function ask(path, options = {}) {
  const headers = { ...options.headers, "X-Token": sessionStorage.getItem("token") || "" };
  return fetch(path, { ...options, headers });
}

async function answer(response) {
  let found = {};
  try { found = await response.json(); } catch { /* not ours: the status says it */ }
  if (!response.ok) throw new Error(found.error || `the server answered ${response.status}; is it still running?`);
  return found;
}

async function preview(wanted, signal, onStage) {
  const response = await ask("/preview", {
    method: "POST", body: JSON.stringify(wanted), headers: { "Content-Type": "application/json" }, signal,
  });
  if (!response.ok) return answer(response);
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  let result = null;
  for (;;) {
    const { done, value } = await reader.read();
    text += value || "";
    const lines = text.split("\n");
    text = lines.pop();
    for (const message of lines.map((line) => JSON.parse(line))) {
      if (message.stage) onStage(STAGES[message.stage] || message.stage);
      if (message.error) throw new Error(message.error);
      if (message.outdated) throw new DOMException("outdated", "AbortError");
      if (message.result) result = message.result;
    }
    if (done && result) return result;
    if (done) throw new Error("the server's response is incomplete; is it still running?");
  }
}

function later(pause = PAUSE_MS) {
  clearTimeout(timer);
  if (running) running.abort();
  running = null;
  if (source !== null) timer = setTimeout(() => whole(show), pause);
}

async function whole(work) {
  if (running) running.abort();
  const mine = running = new AbortController();
  busy(true);
  complain("");
  try {
    await work(mine.signal);
  } catch (error) {
    if (error.name === "AbortError" || running !== mine) return;
    say("No result.");
    if (source && framesShown !== shownBy()) clearResults();  // they are another model's, or another pair's
    complain(error instanceof TypeError ? "the server cannot be reached; is it still running?" : error.message);
  } finally {
    if (running === mine) { running = null; busy(false); }
  }
}

// Identify what the pictures on the page would show.
function shownBy() {
  return JSON.stringify([source.source, $("pair").value, $("model").value, $("checkpoint").value.trim()]);
}

function offerCheckpoints(which = "") {
  const offer = choices.models.find((model) => model.name === $(which || "model").value);
  const field = which ? `${which}-checkpoint` : "checkpoint";
  $(`${field}-field`).hidden = !offer?.takes_checkpoint;
  $(field).value = "";
  $(`${field}s`).replaceChildren(...(offer?.checkpoints || []).map((name) => element("option", "", { value: name })));
}

async function show(signal) {
  const chosen = layers();
  const pair = shownBy();
  const [first, second] = models();
  const results = [{ label: first.label, ...await preview(request(chosen, framesShown !== pair), signal, say) }];
  if (signal.aborted) return;
  showPictures(results);
  framesShown = pair;
  showNumbers(results);
  if (second) {
    results.push({ label: second.label, ...await preview(request(chosen, false, second), signal, (stage) => say(`${second.label}: ${stage}`)) });
    if (signal.aborted) return;
    showPictures(results);
    showNumbers(results);
  }
  const what = chosen.map((layer) => `${layer.name.replaceAll("_", " ")} ${layer.severity}`).join(" + ");
  const seconds = results.map((result) => result.seconds.toFixed(2)).join(" and ");
  say(`${results.map((result) => result.label).join(" and ")}, ${what}: predicted in ${seconds} s.`);
  $("sweep").disabled = chosen.length > 1;
  $("sweep-box").hidden = true;
}

async function sweep(signal) {
  const [first] = layers();
  $("sweep-rows").replaceChildren();
  for (let severity = 1; severity <= 5; severity += 1) {
    for (const model of models()) {
      const result = await preview(request([{ name: first.name, severity }], false, model), signal, (stage) => say(`Severity ${severity} of 5: ${stage}`));
      const row = element("tr");
      row.append(element("th", models().length > 1 ? `${severity}, ${model.label}` : String(severity), { scope: "row" }));
      for (const name of ["epe", "cre", "rcre"]) row.append(element("td", figure(result.numbers[name])));
      $("sweep-rows").append(row);
      $("sweep-box").hidden = false;
    }
  }
  say(`${first.name.replaceAll("_", " ")}: all five severities measured.`);
}

// ---- uploads

async function upload(files) {
  const form = new FormData();
  let bytes = 0;
  for (const [name, file] of Object.entries(files)) { form.append(name, file); bytes += file.size; }
  await whole(async (signal) => {
    if (bytes > choices.max_bytes) throw new Error(`more than ${Math.floor(choices.max_bytes / 2 ** 20)} MB; choose smaller files or a shorter clip`);
    say("Reading the files…");
    let found;
    try {
      found = await answer(await ask("/upload", { method: "POST", body: form, signal }));
    } catch (error) {
      if (error.name !== "AbortError") forget();
      throw error;
    }
    use(found);
  });
}

function chosenFrames() {
  const files = Object.fromEntries(["frame1", "frame2", "truth"].map((id) => [id, $(id).files[0]]).filter(([, file]) => file));
  if (!files.frame1 || !files.frame2) return complain("choose both frames first");
  return upload(files);
}

function dropped(files) {
  files.sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));  // frame 9 before frame 10
  const flows = files.filter((file) => /\.(flo|pfm)$/i.test(file.name));
  const videos = $("clip").accept.split(",");
  const clips = files.filter((file) => videos.some((suffix) => file.name.toLowerCase().endsWith(suffix)));
  const pictures = files.filter((file) => !flows.includes(file) && !clips.includes(file));
  if (clips.length === 1 && files.length === 1) return upload({ clip: clips[0] });
  if (pictures.length === 2 && flows.length <= 1) {
    return upload({ frame1: pictures[0], frame2: pictures[1], ...(flows.length ? { truth: flows[0] } : {}) });
  }
  return complain("drop two frames, optionally with ground truth (.flo or .pfm), or one clip");
}

// ---- start

function listen() {
  $("controls").addEventListener("submit", (event) => event.preventDefault());
  $("layers").addEventListener("input", () => later());
  $("model").addEventListener("input", () => offerCheckpoints());
  $("second").addEventListener("input", () => offerCheckpoints("second"));
  for (const id of ["checkpoint", "second-checkpoint"]) $(id).addEventListener("change", () => later(0));
  $("save").addEventListener("click", save);
  for (const id of ["model", "second", "seed"]) $(id).addEventListener("input", () => later());
  $("pair").addEventListener("input", () => { $("pair-number").textContent = $("pair").value; later(); });
  $("add").addEventListener("click", () => { addLayer("jpeg_compression", 3).querySelector("select").focus(); later(); });
  $("use-demo").addEventListener("click", () => { $("drop").querySelector("summary").focus(); use(choices.demo); });
  $("use-frames").addEventListener("click", chosenFrames);
  $("clip").addEventListener("change", () => { if ($("clip").files[0]) upload({ clip: $("clip").files[0] }); });
  $("sweep").addEventListener("click", () => { clearTimeout(timer); whole(sweep); });
  $("theme").addEventListener("click", () => {
    const dark = getComputedStyle(document.documentElement).colorScheme === "dark" || (!document.documentElement.dataset.theme && matchMedia("(prefers-color-scheme: dark)").matches);
    document.documentElement.dataset.theme = dark ? "light" : "dark";
    $("theme").textContent = dark ? "Dark" : "Light";
  });
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => { event.preventDefault(); $("drop").classList.add("over"); });
  }
  document.addEventListener("dragleave", () => $("drop").classList.remove("over"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    $("drop").classList.remove("over");
    dropped([...event.dataTransfer.files]);
  });
}

(async () => {
  say("Loading…");
  try {
    choices = await answer(await ask("/choices"));
    for (const id of ["model", "second"]) {
      for (const { name } of choices.models) $(id).append(element("option", name, { value: name }));
    }
    offerCheckpoints();
    $("wheel").src = choices.wheel;
    $("scale").src = choices.error_scale;
    if (matchMedia("(prefers-color-scheme: dark)").matches) $("theme").textContent = "Light";
    addLayer();
    listen();
    use(choices.demo);
  } catch (error) {
    say("Nothing to show.");
    complain(error.message);
  }
})();
