// The page: shows the project's state as the server has it, and sends what the user does.

import { Plots } from "/static/plots.js";

const $ = (selector, root = document) => root.querySelector(selector);
const $$ = (selector, root = document) => [...root.querySelectorAll(selector)];
const TABS = $$("[data-tab]").map((section) => section.dataset.tab);

let state = null;
const errors = {}; // field → text; from the last answer that spoke of it
const stamps = {}; // piece → version shown
let settled = null; // when the last job began whose end was taken note of
const plots = new Plots($("#panels"), (begin, end) => {
  $("#range").textContent = `${number(begin)} to ${number(end)} s`;
});

const FIELDS = {
  model: { label: "Model", list: "models", folder: "models", accept: ".mo,.fmu",
    hint: "A class of the library, file.mo:Class.Name, or an FMU" },
  recording: { label: "Recording", list: "recordings", folder: "recordings",
    accept: ".csv,.parquet,.mat,.mf4,.blf,.asc,.log,.gz,.trc", hint: "A file, or a registered data set such as emps" },
  holdout: { label: "Unseen recording", list: "recordings", folder: "recordings",
    accept: ".csv,.parquet,.mat,.mf4,.blf,.asc,.log,.gz,.trc", hint: "Of the same machine; only scored, never fitted" },
  dbc: { label: "DBC file", list: "dbcs", folder: "recordings", accept: ".dbc", hint: "Describes a CAN log; leave empty otherwise" },
  also: { label: "Further recordings", list: "recordings", folder: "recordings", several: true,
    accept: ".csv,.parquet,.mat,.mf4,.blf,.asc,.log,.gz,.trc", hint: "Of the same machine, fitted at once with the first; commas between them" },
  libraries: { label: "Modelica libraries", hint: "Folders that hold further libraries, with effects of your own; commas between them" },
  horizon: { label: "Horizon", hint: "auto, free, or the length of windows in seconds" },
};

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value != null) made.setAttribute(name, value);
  }
  made.append(...children.filter((child) => child != null));
  return made;
}

const number = (value) => (value == null ? "–" : String(Number(value.toPrecision(5))).replace("-", "−"));
const sentence = (error) => [error.what, error.remedy].filter(Boolean).join("; ");

// ---- talking to the server

// One after the other: a field that is left by pressing a button is changed before the button's task
// begins, and no older state is shown after a newer one.
let asked = Promise.resolve();
function send(...request) {
  return (asked = asked.then(() => ask(...request), () => ask(...request)));
}

async function ask(method, path, body, field = "") {
  errors[field] = "";
  let answer;
  try {
    answer = await fetch(path, { method, ...(body && { body: JSON.stringify(body), headers: { "Content-Type": "application/json" } }) });
  } catch {
    $("#fault").textContent = "The workbench does not answer: is it still running in the terminal?";
    return false;
  }
  $("#fault").textContent = "";
  const found = await answer.json();
  if (!answer.ok) {
    errors[field] = sentence(found);
    render();
    return false;
  }
  take(found);
  return true;
}

let nextPoll = 0;
function take(found) {
  const job = found.job;
  state = found;
  // Whether or not it was ever seen running: one that fails at once is over before the next look.
  if (job && job.status !== "running" && job.began !== settled) {
    settled = job.began;
    ended(job);
  }
  render();
  clearTimeout(nextPoll);
  if (found.looking || job?.status === "running") nextPoll = setTimeout(poll, 350);
}

function poll() {
  return send("GET", "/api/state", null, "poll");
}

function ended(job) {
  if (job.status === "failed") {
    const { field } = job.error;
    errors[field === "add" ? "add" : job.task] = sentence(job.error);
    if (field in FIELDS || field === "max_effects") errors[field] = sentence(job.error);
  }
}

function run(task, more = {}) {
  errors[task] = "";
  return send("POST", "/api/jobs", { task, ...more }, task);
}

async function upload(field, file) {
  const { folder, several } = FIELDS[field];
  errors[field] = "";
  render();
  const box = $(`#hint-${field}`), hint = box.textContent;
  box.textContent = `taking ${file.name} …`;
  const answer = await fetch(`/upload/${folder}/${encodeURIComponent(file.name)}`, { method: "PUT", body: file })
    .catch(() => null);
  box.textContent = hint;
  const found = answer ? await answer.json() : { what: `'${file.name}' was refused or the connection broke`, remedy: "check the file and try again" };
  if (!answer?.ok) {
    errors[field] = sentence(found);
    return render();
  }
  const words = several ? state.choices[field].split(",").map((word) => word.trim()).filter(Boolean) : [];
  return send("PATCH", "/api/state", { [field]: [...new Set([...words, found.word])].join(", ") }, field);
}

// ---- showing the state

function field(name, { label, list, folder, accept, hint }) {
  const input = element("input", {
    id: `field-${name}`, list: list && `list-${list}`, spellcheck: "false", autocomplete: "off",
    "aria-describedby": `hint-${name} error-${name}`,
    onchange: () => send("PATCH", "/api/state", { [name]: input.value }, name),
  });
  const file = folder && element("label", { class: "upload" }, "Upload…", element("input", {
    type: "file", accept, "aria-label": `Upload ${label.toLowerCase()}`,
    onchange: (event) => event.target.files[0] && upload(name, event.target.files[0]).then(() => { event.target.value = ""; }),
  }));
  return element("div", { class: "field" },
    element("label", { for: `field-${name}` }, label), element("div", { class: "line" }, input, file),
    element("p", { class: "hint-text", id: `hint-${name}` }, hint),
    element("p", { class: "error", id: `error-${name}`, role: "alert" }));
}

function setUp() {
  $("#fields").append(...Object.entries(FIELDS).map(([name, about]) => field(name, about)));
  $("#improve-fields").append(field("max_effects", { label: "At most so many effects", hint: "A whole number" }));
  for (const list of ["models", "recordings", "dbcs"]) document.body.append(element("datalist", { id: `list-${list}` }));
  for (const button of $$("[data-task]")) button.addEventListener("click", () => run(button.dataset.task));
  $("#cancel").addEventListener("click", () => send("DELETE", "/api/jobs"));
  $("#demo").addEventListener("click", () => send("POST", "/api/demo"));
  $("#suggestions").addEventListener("click", async () => {
    for (const row of state.look.recording.rows.filter((r) => r.suggested)) {
      await send("PATCH", `/api/channels/${row.name}`, { source: row.suggested }, `row-${row.name}`);
    }
  });
  $("#propose").addEventListener("click", () => { errors.add = ""; run("propose", { add: $("#add-text").value }); });
  $("#add-text").addEventListener("keydown", (event) => event.key === "Enter" && $("#propose").click());
  $("#accept").addEventListener("click", () => send("POST", "/api/steps", null, "add"));
  $("#undo").addEventListener("click", () => send("DELETE", "/api/steps", null, "add"));
  const views = { whole: () => plots.whole(), in: () => plots.zoom(0.5), out: () => plots.zoom(2),
    left: () => plots.pan(-0.25), right: () => plots.pan(0.25) };
  for (const button of $$("[data-view]")) button.addEventListener("click", views[button.dataset.view]);
  $("#record").addEventListener("change", (event) => plots.load(Number(event.target.value)));
  document.addEventListener("click", async (event) => {
    const span = event.target.closest("button.span");
    if (!span) return;
    const record = Number(span.closest("[data-record]").dataset.record);
    if (record !== plots.record) await plots.load(record);
    $("#record").value = String(record);
    const begin = Number(span.dataset.begin), end = Number(span.dataset.end), room = 0.3 * (end - begin);
    plots.show(begin - room, end + room);
    $("#plots").scrollIntoView();
  });
  addEventListener("hashchange", showTab);
  showTab();
}

function showTab() {
  const wanted = location.hash.slice(1);
  if (wanted && !TABS.includes(wanted)) return;
  const tab = wanted || "data";
  for (const section of $$("[data-tab]")) section.hidden = section.dataset.tab !== tab;
  for (const link of $$("nav a")) {
    if (link.hash === `#${tab}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (state) render();
}

function render() {
  if (!state) return;
  const { choices, look, results, job } = state;
  $("#folder").textContent = state.folder;
  $("#title").textContent = choices.model ? `${state.present_model} against ${choices.recording || "no recording yet"}` : "Model against machine";
  $("#start").hidden = Boolean(choices.model || choices.recording);
  renderFields(choices, look);
  renderChannels(look);
  renderJob(job);
  renderErrors();
  for (const note of $$("[data-stale]")) note.hidden = !results[note.dataset.stale]?.stale;
  for (const note of $$("[data-empty]")) note.hidden = Boolean(results[note.dataset.empty]);
  renderPieces(results);
  renderAdd(results, choices);
  renderExport(results);
}

function renderFields(choices, look) {
  for (const name of [...Object.keys(FIELDS), "max_effects"]) {
    const input = $(`#field-${name}`);
    if (document.activeElement !== input || input.value === "") input.value = choices[name];
    const wrong = errors[name] || (look?.errors?.[name] ? sentence(look.errors[name]) : "");
    $(`#error-${name}`).textContent = wrong;
    input.setAttribute("aria-invalid", String(Boolean(wrong)));
  }
  for (const list of ["models", "recordings", "dbcs"]) {
    fill($(`#list-${list}`), state[list], () => state[list].map((word) => element("option", { value: word })));
  }
  const time = look?.errors?.time;
  $("#error-time").textContent = errors["row-time"] || (time ? sentence(time) : "");
}

// Build anew only what changed, and leave the focus where it was.
function fill(box, key, children) {
  const text = JSON.stringify(key);
  if (box.dataset.key === text) return;
  const focus = box.contains(document.activeElement) ? document.activeElement.id : "";
  box.dataset.key = text;
  box.replaceChildren(...children());
  if (focus) document.getElementById(focus)?.focus();
}

function renderChannels(look) {
  const record = look?.recording, rows = record?.rows;
  $("#map-empty").hidden = Boolean(rows);
  $("#channels-region").hidden = !rows;
  $("#suggestions").hidden = !rows?.some((row) => row.suggested);
  const timed = rows && !record.columns.includes("time") && Boolean(look.errors.time || Object.keys(record.time).length);
  $("#time-row").hidden = !timed;
  if (!rows) return;
  fill($("#time-row"), [timed, record.time, record.columns], () => timed ? [timeField(record)] : []);
  fill($("#notes"), [record.notes, record.unknown], () => [
    ...(record.notes ?? []).map((note) => element("li", {}, note)),
    ...record.unknown.map((name) => element("li", { class: "error" }, `channels.toml speaks of '${name}', which this model does not have. `,
      element("button", { type: "button", onclick: () => send("DELETE", `/api/channels/${name}`, null, "model") }, "Remove it"))),
  ]);
  const wrong = rows.map((row) => errors[`row-${row.name}`]);
  fill($("#channels"), [rows, wrong], () => [
    element("thead", {}, element("tr", {}, ...["Variable", "Column", "Unit of the column", "Times", "Noise (sd)", "Preview"].map((text) => element("th", { scope: "col" }, text)))),
    element("tbody", {}, ...rows.map((row) => channelRow(row, record))),
  ]);
}

function channelRow(row, record) {
  const change = (key) => (event) => send("PATCH", `/api/channels/${row.name}`, { [key]: event.target.value }, `row-${row.name}`);
  const wrong = errors[`row-${row.name}`] || row.error;
  const common = { "aria-invalid": String(Boolean(wrong)), "aria-describedby": `error-row-${row.name}` };
  const options = [element("option", { value: "" }, row.kind === "input" ? "choose…" : "not recorded"),
    ...record.columns.map((name) => element("option", { value: name, selected: name === row.source }, name === row.suggested ? `${name} (suggested)` : name))];
  const units = row.units.filter(Boolean).map((unit) => element("option", { value: unit }));
  return element("tr", {},
    element("th", { scope: "row" }, row.name, element("span", { class: "sub" }, `${row.kind}, ${row.unit || "1"}`), element("span", { class: "sub" }, row.description)),
    element("td", {}, element("select", { id: `source-${row.name}`, "aria-label": `Column of ${row.name}`, ...common, onchange: change("source") }, ...options),
      element("p", { class: "error", id: `error-row-${row.name}`, role: "alert" }, wrong || "")),
    element("td", {}, element("input", { id: `unit-${row.name}`, class: "short", list: `units-${row.name}`, value: row.recorded_unit, placeholder: row.file_unit || row.unit, "aria-label": `Unit of the column of ${row.name}`, onchange: change("unit") }),
      element("datalist", { id: `units-${row.name}` }, ...units)),
    ...["factor", "sd"].map((key) => element("td", {}, element("input", { id: `${key}-${row.name}`, class: "short", inputmode: "decimal", value: row.typed[key] ?? "", placeholder: key === "factor" ? "1" : "estimated", "aria-label": `${key === "factor" ? "Factor" : "Noise"} of ${row.name}`, onchange: change(key) }))),
    element("td", {}, ...preview(row)));
}

function timeField(record) {
  const send_ = (key) => (event) => send("PATCH", "/api/channels/time", { [key]: event.target.value }, "row-time");
  return element("div", { class: "field" }, element("span", { class: "label" }, "Time"),
    element("div", { class: "line" },
      element("select", { id: "time-source", "aria-label": "Column of time", onchange: send_("source") }, element("option", { value: "" }, "choose…"),
        ...record.columns.map((name) => element("option", { value: name, selected: name === record.time.source }, name))),
      element("select", { id: "time-unit", "aria-label": "Unit of time", onchange: send_("unit") }, ...["s", "ms", "us"].map((unit) => element("option", { value: unit, selected: unit === record.time.unit }, unit)))),
    element("p", { class: "hint-text" }, "Which column is time, and in which unit"));
}

function preview(row) {
  const p = row.preview;
  if (!p) return [element("span", { class: "small" }, row.source ? "" : "–")];
  const low = p.least ?? 0, span = (p.most ?? 1) - low || 1, width = p.t.at(-1) - p.t[0] || 1;
  const points = p.t.map((t, k) => (p.y[k] == null ? "" : `${((t - p.t[0]) / width * 200).toFixed(1)},${(36 - (p.y[k] - low) / span * 34).toFixed(1)}`)).join(" ");
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 200 38");
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `${row.name} over time`);
  const line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
  line.setAttribute("points", points);
  svg.append(line);
  return [svg, element("span", { class: "small" }, `${number(p.least)} to ${number(p.most)} ${row.unit}; ${p.samples} samples, ${number(p.begin)} to ${number(p.end)} s`)];
}

function renderJob(job) {
  const running = job?.status === "running";
  $("#job").hidden = !running;
  for (const button of [...$$("[data-task]"), $("#propose"), $("#accept"), $("#undo")]) button.disabled = running;
  if (running) {
    const seconds = Math.max(0, Math.round(Date.now() / 1000 - job.began));
    $("#job-text").textContent = `${job.progress || "starting"} … ${seconds} s`;
  }
}

function renderErrors() {
  for (const box of $$("[data-error]")) {
    box.textContent = box.dataset.error.split(" ").map((task) => errors[task]).filter(Boolean).join(" ");
  }
  $("#error-add").textContent = errors.add || errors.propose || "";
  $("#add-text").setAttribute("aria-invalid", String(Boolean(errors.add || errors.propose)));
}

async function renderPieces(results) {
  for (const box of $$("[data-piece]")) {
    const name = box.dataset.piece, stamp = results[name]?.stamp;
    // Charts and tables are made when their tab is opened.
    if (!stamp || stamps[name] === stamp || box.closest("[data-tab]").hidden) continue;
    stamps[name] = stamp;
    box.innerHTML = await (await fetch(`/api/pieces/${name}`)).text();
    if (name === "compare") {
      $("#plots").hidden = false;
      const records = results.compare.records;
      $("#record-line").hidden = records.length < 2;
      $("#record").replaceChildren(...records.map((name, k) => element("option", { value: String(k) }, name)));
      await plots.load(0);
    }
  }
}

function renderAdd(results, choices) {
  const found = results.diagnose?.candidates ?? [];
  $("#to-add").hidden = !found.length;
  fill($("#candidates"), [found, results.diagnose?.stale], () => [
    element("legend", {}, "Candidates of the diagnosis, best first"),
    ...(found.length ? found.slice(0, 8).map((text, k) => element("label", {},
      element("input", { type: "radio", name: "candidate", id: `candidate-${k}`, onchange: () => { $("#add-text").value = text; } }), " ",
      element("code", {}, text))) : [element("p", { class: "empty" }, "None: diagnose first, or write an effect below.")]),
  ]);
  const change = results.change;
  $("#change").hidden = !change || (change.stale && choices.steps.some((step) => step.model.endsWith(`:${change.name}`)));
  $("#accept").disabled ||= Boolean(change?.stale);
  $("#change-h").textContent = change ? `${change.name}: with ${change.label.replace("@", " at ")}` : "";
  $("#no-steps").hidden = choices.steps.length > 0;
  $("#undo").hidden = !choices.steps.length;
  fill($("#steps"), choices.steps, () => choices.steps.map((step) => element("li", {}, element("code", {}, step.additions.at(-1)), ` in ${step.model}`)));
}

function renderExport(results) {
  fill($("#exports"), state.exports, () => state.exports.map((path) => element("li", {}, element("a", { href: `/files/${path}`, download: path.endsWith(".html") ? null : path.split("/").at(-1), target: path.endsWith(".html") ? "_blank" : null }, path))));
  $("#no-exports").hidden = state.exports.length > 0;
  $("#commands").textContent = state.commands.join("\n") || "Choose a model and a recording first.";
  const improved = results.improve && state.exports.includes("improved/report.html");
  $("#report").hidden = $("#report-link").hidden = !improved;
  const address = improved ? `/files/improved/report.html?${results.improve.stamp}` : "";
  if (improved && !$("#ladder-h").closest("section").hidden && $("#report").getAttribute("src") !== address) $("#report").src = address;
}

setUp();
poll();
