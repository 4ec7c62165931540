// What all pages share: asking with a token, live data, numbers and dates in words.

const KEY = "twinproof-token";

export const byId = (id) => document.getElementById(id);

export function element(tag, attributes = {}, ...children) {
  const svg = ["svg", "path", "rect", "line"].includes(tag);
  const made = svg
    ? document.createElementNS("http://www.w3.org/2000/svg", tag)
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function headers() {
  const token = sessionStorage.getItem(KEY);
  return token ? { Authorization: `Bearer ${token}` } : {};
}

function say(text, lost = false) {
  byId("connection").textContent = text;
  byId("connection").classList.toggle("lost", lost);
}

async function ask(path) {
  for (;;) {
    const answer = await fetch(path, { headers: headers(), cache: "no-store" });
    if (answer.status !== 401) return answer;
    sessionStorage.setItem(KEY, await tokenFromReader());
  }
}

let asking = null;
function tokenFromReader() {
  // Two requests that are refused at once ask once.
  asking ??= new Promise((done) => {
    say("a token is needed", true);
    const input = element("input", { type: "password", "aria-label": "Token", autocomplete: "off" });
    const form = element("form", { id: "token" }, input, element("button", {}, "Use token"));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      form.remove();
      asking = null;
      done(input.value.trim());
    });
    document.querySelector("main").prepend(form);
  });
  return asking;
}

export async function get(path) {
  const answer = await ask(path);
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.detail ?? answer.statusText);
  return found;
}

// Server-sent events by fetch: EventSource cannot show a token.
export async function live(path, show) {
  for (;;) {
    try {
      const answer = await ask(path);
      if (answer.status === 404) {
        say((await answer.json()).detail, true);
        return;
      }
      if (!answer.ok) throw new Error(answer.statusText);
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      let rest = "";
      say("live");
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        const parts = (rest + value).split("\n\n");
        rest = parts.pop();
        const newest = parts.filter((part) => part.startsWith("data: ")).pop();
        if (newest) show(JSON.parse(newest.slice(6)));
      }
    } catch (error) {
      console.warn(error);
    }
    // What is shown is old now, and must not look as if it were not.
    say("no connection: what is shown is old", true);
    document.dispatchEvent(new Event("lost"));
    await new Promise((wait) => setTimeout(wait, 1000));
  }
}

export function number(value, digits = 4) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) return value.toExponential(digits - 1);
  return String(Number(value.toPrecision(digits)));
}

export const date = (seconds) =>
  seconds === null ? "–" : new Date(seconds * 1000).toLocaleString();

export function facts(list, pairs) {
  list.replaceChildren(
    ...pairs.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]),
  );
}

export const word = (gate) => (gate.allowed ? "open" : "closed");
