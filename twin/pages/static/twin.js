import { byId, date, element, facts, live, number, word } from "./common.js";

const name = new URLSearchParams(location.search).get("name") ?? "";
const path = encodeURIComponent(name);
byId("name").textContent = document.title = name;
byId("events-link").href = `/pages/events?twin=${path}`;

function showGate(twin) {
  byId("gate").className = `gate ${word(twin.gate)}`;
  byId("gate-word").textContent = word(twin.gate);
  byId("gate-because").textContent = twin.gate.because;
  facts(byId("facts"), [
    ["plant", `${twin.state}${twin.because ? `: ${twin.because}` : ""}`],
    ["since", date(twin.since)],
    ["verified", date(twin.gate.verified_at)],
    ["verification", twin.verifying ? "under way" : "none under way"],
    ["model", twin.model],
    ["telemetry", `${number(twin.age, 2)} s old`],
    ["excitation", number(twin.excitation, 2)],
    ...Object.entries(twin.faults).map(([what, why]) => [`fault: ${what}`, why]),
  ]);
}

// A band for what was verified and a bar for the estimate, both ±2 sd, on one scale.
function parameterRow([key, p]) {
  const middle = p.verified?.value ?? p.value ?? 0;
  const half = Math.max(3 * (p.verified?.sd ?? 0), Math.abs((p.value ?? middle) - middle) * 1.3,
    2.5 * (p.sd ?? 0), Math.abs(middle) * 1e-3, 1e-12);
  const at = (value) => 50 + (48 * (value - middle)) / half;
  const svg = element("svg", { viewBox: "0 0 100 10", preserveAspectRatio: "none" });
  svg.append(element("rect", { x: 0, y: 4.5, width: 100, height: 1, class: "track" }));
  let far = false;
  if (p.verified) {
    const wide = 2 * p.verified.sd;
    far = p.value !== null && Math.abs(p.value - middle) > wide;
    svg.append(element("rect", { x: at(middle - wide), y: 0, height: 10, class: "band",
      width: Math.max(0.5, at(middle + wide) - at(middle - wide)) }));
  }
  if (p.value !== null) {
    const wide = 2 * (p.sd ?? 0);
    svg.append(element("rect", { x: at(p.value - wide), y: 3, height: 4,
      class: far ? "bar far" : "bar", width: Math.max(0.8, at(p.value + wide) - at(p.value - wide)) }));
  }
  const text = `${number(p.value)}${p.sd === null ? "" : ` ± ${number(p.sd, 2)}`} ${p.unit}`;
  return element("div", { class: "row", "data-parameter": key },
    element("span", {}, key), svg, element("span", {}, text));
}

function driftRow([key, test]) {
  const most = 1.5 * (test.threshold ?? 1);
  const share = Math.min(1, Math.abs(test.statistic ?? 0) / most);
  const x = (100 * (test.threshold ?? 0)) / most;
  const over = Math.abs(test.statistic ?? 0) > (test.threshold ?? Infinity);
  const svg = element("svg", { viewBox: "0 0 100 10", preserveAspectRatio: "none" },
    element("rect", { x: 0, y: 3, width: 100, height: 4, class: "track" }),
    element("rect", { x: 0, y: 3, width: 100 * share, height: 4, class: over ? "bar far" : "bar" }),
    element("line", { x1: x, x2: x, y1: 0, y2: 10, class: "limit" }));
  return element("div", { class: "row", "data-test": key }, element("span", {}, key), svg,
    element("span", {}, `${number(test.statistic, 3)} of ${number(test.threshold, 3)}`));
}

function trace(times, values, low, high, top, height) {
  const first = times[0];
  const span = times[times.length - 1] - first || 1;
  let pen = "M";
  let text = "";
  times.forEach((time, k) => {
    if (values[k] === null) {
      pen = "M";
      return;
    }
    const x = (1000 * (time - first)) / span;
    const y = top + height * (1 - (values[k] - low) / (high - low || 1));
    text += `${pen}${x.toFixed(1)} ${y.toFixed(1)}`;
    pen = "L";
  });
  return text || "M0 0";
}

const bounds = (values) => {
  const known = values.filter((v) => v !== null);
  return known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
};

function plot([key, c]) {
  const [low, high] = bounds([...c.measured, ...c.predicted]);
  const most = Math.max(...bounds(c.residual).map(Math.abs)) || 1;
  const svg = element("svg", { viewBox: "0 0 1000 200", preserveAspectRatio: "none",
    role: "img", "aria-label": `${key}: measured, predicted and residual` });
  if (c.time.length) {
    svg.append(
      element("path", { d: trace(c.time, c.measured, low, high, 4, 120), class: "line measured" }),
      element("path", { d: trace(c.time, c.predicted, low, high, 4, 120), class: "line predicted" }),
      element("path", { d: trace(c.time, c.residual, -most, most, 140, 56), class: "line residual" }),
    );
  }
  const seconds = c.time.length ? c.time[c.time.length - 1] - c.time[0] : 0;
  return element("figure", { "data-channel": key }, element("figcaption", { class: "key" },
    `${key}: ${number(low, 3)} to ${number(high, 3)}, residual up to ${number(most, 2)}, ` +
    `last ${number(seconds, 2)} s`), svg);
}

live(`/twins/${path}/live`, (twin) => {
  showGate(twin);
  byId("parameters").replaceChildren(...Object.entries(twin.parameters).map(parameterRow));
  byId("drift").replaceChildren(...Object.entries(twin.drift).map(driftRow));
  byId("channels").replaceChildren(...Object.entries(twin.channels).map(plot));
  facts(byId("counts"), Object.entries(twin.counts).map(([what, n]) => [what, String(n)]));
});

document.addEventListener("lost", () => {
  byId("gate").className = "gate closed";
  byId("gate-word").textContent = "unknown";
  byId("gate-because").textContent = "the service does not answer: take the gate for closed";
});
