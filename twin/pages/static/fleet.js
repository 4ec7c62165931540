import { byId, date, element, live, number, word } from "./common.js";

function card(twin) {
  const link = element("a", { href: `/pages/twin?name=${encodeURIComponent(twin.name)}` }, twin.name);
  const state = twin.verifying ? "verification under way" : twin.state;
  return element(
    "li",
    { class: word(twin.gate), "data-twin": twin.name },
    element("h2", {}, link),
    element("p", { class: "word" }, word(twin.gate)),
    element("p", {}, twin.gate.because),
    element(
      "p",
      { class: twin.verifying ? "busy" : "faint" },
      `${state} since ${date(twin.since)}, telemetry ${number(twin.age, 2)} s old`,
    ),
  );
}

live("/live", ({ twins }) => byId("fleet").replaceChildren(...twins.map(card)));

document.addEventListener("lost", () => {
  for (const shown of byId("fleet").children) {
    shown.className = "closed";
    shown.querySelector(".word").textContent = "unknown";
  }
});
