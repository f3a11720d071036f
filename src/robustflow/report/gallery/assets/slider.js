"use strict";
// The picture slider: one or all corruptions at a severity (for a clip, at a frame) next to the clean picture.
const FRAMES_PER_SECOND = 6;

function start(root) {
  const data = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const which = root.querySelector("#slider-corruption");
  const severity = root.querySelector("#slider-severity");
  const frame = root.querySelector("#slider-frame");
  const play = root.querySelector("#slider-play");
  const frameShown = root.querySelector("#slider-frame-shown");
  const pictures = root.querySelector(".slider-pictures");
  const clean = pictures.querySelector("figure:not([data-corruption]) img");
  const figures = [...pictures.querySelectorAll("[data-corruption]")];

  function put(image, address, alt) {
    if (image.getAttribute("src") !== address) image.src = address;
    image.alt = alt;
  }

  function show() {
    const at = frame === null ? 0 : Number(frame.value);
    const number = String(at + data.first_frame);
    const ofFrame = frame === null ? "" : `, frame ${number}`;
    put(clean, data.clean[at], `The clean frame${frame === null ? "" : ` ${number}`}`);
    pictures.classList.toggle("together", which.value === "all");
    for (const figure of figures) {
      figure.hidden = which.value !== "all" && which.value !== figure.dataset.corruption;
      if (figure.hidden) continue;
      const [name, shots] = data.corruptions[figure.dataset.corruption];
      const shot = shots.find((one) => one.severity === Number(severity.value));
      const image = figure.querySelector("img");
      image.hidden = shot === undefined;
      figure.querySelector(".absent").hidden = shot !== undefined;
      figure.querySelector("figcaption span").textContent = shot === undefined ? "" : shot.caption;
      if (shot !== undefined) put(image, shot.pictures[at], `${name} at severity ${severity.value}${ofFrame}`);
    }
    root.querySelector("#slider-shown").textContent = severity.value;
    severity.setAttribute("aria-valuetext", `${which.selectedOptions[0].textContent}, severity ${severity.value}`);
    if (frame !== null) {
      frameShown.textContent = number;
      frame.setAttribute("aria-valuetext", `frame ${number}`);
    }
  }

  // Show a corruption at the available severity nearest to the slider's position.
  function choose() {
    if (which.value !== "all") {
      const levels = data.corruptions[which.value][1].map((shot) => shot.severity);
      const away = (level) => Math.abs(level - Number(severity.value));
      if (levels.length) severity.value = levels.reduce((best, level) => (away(level) < away(best) ? level : best));
    }
    show();
  }

  let timer = null;
  function stop() {
    clearInterval(timer);
    timer = null;
    play.textContent = "Play";
    frameShown.setAttribute("aria-live", "polite");
  }
  function toggle() {
    if (timer !== null) return stop();
    play.textContent = "Pause";
    frameShown.setAttribute("aria-live", "off"); // screen readers should not read out six numbers per second
    timer = setInterval(() => {
      frame.value = (Number(frame.value) + 1) % data.clean.length;
      show();
    }, 1000 / FRAMES_PER_SECOND);
  }

  which.addEventListener("input", choose);
  severity.addEventListener("input", show);
  if (frame !== null) {
    frame.addEventListener("input", () => {
      stop();
      show();
    });
    play.addEventListener("click", toggle);
  }
  for (const part of root.querySelectorAll(".slider-controls, .slider-pictures")) part.hidden = false;
  choose();
}

document.querySelectorAll("[data-slider]").forEach(start);
