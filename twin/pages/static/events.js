import { byId, date, element, get } from "./common.js";

const KINDS = ["started", "stopped", "parameters", "drift", "diagnosis", "excitation_low",
  "excitation_back", "verification", "gate", "approval", "promoted", "rolled_back",
  "telemetry_stale", "telemetry_back", "degraded", "recovered"];
const LOUD = ["drift", "degraded", "telemetry_stale", "rolled_back"];
const PAGE = 50;

let oldest = null;

const short = (value) =>
  typeof value === "string" && /^[0-9a-f]{64}$/.test(value) ? value.slice(0, 12) : value;

function item(event) {
  const detail = Object.entries(event.detail)
    .filter(([, value]) => value !== null)
    .map(([key, value]) => `${key}: ${typeof value === "object" ? JSON.stringify(value) : short(value)}`)
    .join(", ");
  return element("li", { "data-kind": event.kind },
    element("time", { datetime: new Date(event.time * 1000).toISOString() }, date(event.time)),
    element("strong", { class: LOUD.includes(event.kind) ? "loud" : "" },
      event.kind.replaceAll("_", " ")), ` ${event.twin || "service"} `,
    element("div", { class: "detail" }, detail));
}

async function more() {
  const query = new URLSearchParams({ limit: PAGE });
  if (byId("twin").value) query.set("twin", byId("twin").value);
  if (byId("kind").value) query.set("kind", byId("kind").value);
  if (oldest !== null) query.set("before", oldest);
  try {
    const { events } = await get(`/events?${query}`);
    byId("events").append(...events.map(item));
    byId("more").hidden = events.length < PAGE;
    if (events.length) oldest = events[events.length - 1].number;
    byId("connection").textContent = "";
  } catch (error) {
    byId("connection").textContent = error.message;
    byId("connection").classList.add("lost");
  }
}

function anew() {
  oldest = null;
  byId("events").replaceChildren();
  return more();
}

for (const kind of KINDS)
  byId("kind").append(element("option", { value: kind }, kind.replaceAll("_", " ")));
const { twins } = await get("/twins");
for (const { name } of twins) byId("twin").append(element("option", { value: name }, name));
byId("twin").value = new URLSearchParams(location.search).get("twin") ?? "";
byId("filter").addEventListener("change", anew);
byId("more").addEventListener("click", more);
await anew();
const { intact, events, because } = await get("/audit");
byId("audit").textContent = intact ? `The log is whole: ${events} events.` : `The log is NOT whole: ${because}`;
byId("audit").className = intact ? "faint" : "loud";
