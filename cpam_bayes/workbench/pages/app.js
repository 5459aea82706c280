// What is typed goes to the server; what it answers replaces the parts of the page by their identifiers.
"use strict";
const base = document.body.dataset.base, visit = base !== "/folder";
let version = +document.body.dataset.version || 0, structure = -1, pending = Promise.resolve();
const $ = (id) => document.getElementById(id);
const say = (text, wrong) => { const at = $("said"); at.textContent = text || ""; at.className = wrong ? "wrong" : ""; };

async function ask(path, body) {
  try {
    const response = await fetch(path, body === undefined ? {} :
      { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
    const said = response.headers.get("Content-Type").startsWith("application/json")
      ? await response.json() : { error: await response.text() };
    if (!response.ok) { say(said.error, true); return null; }
    return said;
  } catch { say("The server does not answer. Start cpam-bayes app again and open its address: nothing is lost.", true); return null; }
}

function show(news) {
  if (!news || !news.parts || news.version < version) return;
  version = news.version;
  if ("form" in news.parts) {
    const at = document.activeElement, key = at && at.closest("#form") && mark(at);
    const places = key && typeof at.selectionStart === "number" ? [at.selectionStart, at.selectionEnd] : null;
    $("form").innerHTML = news.parts.form;
    structure = news.structure;
    for (const [of, value] of typed) {
      const box = document.querySelector(of);
      if (box) box.value = value;
    }
    const again = key && document.querySelector(key);
    if (again) again.focus();
    if (again && places) again.setSelectionRange(...places);
  }
  for (const [id, html] of Object.entries(news.parts)) {
    const at = id !== "form" && $(id);
    if (at && at.dataset.html !== html) {
      const open = [...at.querySelectorAll("details")].map((d) => d.open);
      at.innerHTML = html; at.dataset.html = html;
      at.querySelectorAll("details").forEach((d, i) => { d.open = open[i]; });
    }
  }
  document.querySelectorAll(".error").forEach((at) => {
    if (!(at.id in news.parts)) { at.textContent = ""; delete at.dataset.html; }
    document.querySelectorAll(`[aria-describedby="${CSS.escape(at.id)}"]`).forEach((box) => box.setAttribute("aria-invalid", String(at.id in news.parts)));
  });
}
// What names a field, over a form that is drawn anew; what was typed there and no answer has seen yet.
const typed = new Map();
const mark = (at) => (at.closest("[data-sensor]") ? `[data-sensor="${at.closest("[data-sensor]").dataset.sensor}"] ` : "") + Object.entries(at.dataset).map(([k, v]) => `[data-${k.replace(/[A-Z]/g, (c) => "-" + c.toLowerCase())}="${CSS.escape(v)}"]`).join("");
const edit = (change) => { flush(); return send(change); };
const send = (change, of, text) => { pending = pending.then(async () => {
  const news = await ask(`${base}/edit`, { ...change, structure });
  if (news && of && typed.get(of) === text) typed.delete(of);
  if (news) { say(""); show(news); } }); return pending; };
async function act(change) {
  flush();
  await pending;
  const news = await ask(`${base}/act`, change);
  if (news) { say(news.said); show(news); }
}

async function listen() {
  for (;;) {
    const response = await fetch(`${base}/news?seen=${version}&structure=${structure}`).catch(() => null);
    if (response && response.ok) show(await response.json());
    else {
      if (response) say((await response.json().catch(() => ({}))).error || "Open the address that cpam-bayes app printed.", true);
      else say("The server does not answer. Start cpam-bayes app again and open its address: nothing is lost.", true);
      await new Promise((done) => setTimeout(done, 3000));
    }
  }
}

// Edits of fields that are typed in wait a moment, and go before every other one.
const waiting = new Map();
let timer = 0;
function flush() {
  clearTimeout(timer);
  for (const [of, change] of waiting) send(change, of, typed.get(of));
  waiting.clear();
}
function changed(at) {
  const d = at.dataset;
  if ("key" in d) return { do: "set", key: d.key, value: at.value };
  if ("row" in d && at.value.trim()) return { do: "row", index: +d.row, value: at.value };
  if ("part" in d) return { do: "sensor", index: +at.closest("[data-sensor]").dataset.sensor, value: { [d.part]: at.value } };
  return null;
}
document.addEventListener("input", (event) => {
  const at = event.target, change = changed(at), of = mark(at);
  waiting.delete(of);
  if (change || "paste" in at.dataset) typed.set(of, at.value); else typed.delete(of);
  if (!change) return;
  waiting.set(of, change);
  clearTimeout(timer);
  timer = setTimeout(flush, 120);
});
document.addEventListener("change", (event) => {
  const at = event.target, d = at.dataset;
  if ("leave" in d) edit({ do: "leave", index: +d.leave, value: !at.checked });
  if ("file" in d && at.files[0]) drop(at.files[0]);
  if ("edge" in d) edit({ do: "edge", index: +d.edge, value: at.value });
  if ("material" in d && at.value) edit({ do: "material", value: at.value });
  if ("row" in d && !at.value.trim()) edit({ do: "row", index: +d.row, value: "" });
});
document.addEventListener("paste", (event) => {
  const at = event.target, text = event.clipboardData.getData("text");
  const takes = at.dataset && ("row" in at.dataset || ("paste" in at.dataset && !at.value && !document.querySelector("[data-row]")));
  if (takes && /\d[\s;]+\d/.test(text.trim())) {
    event.preventDefault();
    edit({ do: "paste", value: text });
  }
});
document.addEventListener("click", async (event) => {
  const at = event.target.closest("button, #plate-view, .spectrum");
  if (!at) return;
  const d = at.dataset;
  if ("open" in d) {
    const news = await ask("/open", d.open === "blank" ? {} : d.open === "example" ? { example: true } : { file: d.open });
    if (news) location.assign(news.go);
  } else if ("edit" in d) edit({ do: d.edit });
  else if ("act" in d) act({ do: d.act });
  else if ("remove" in d) edit({ do: "sensor", index: +d.remove, value: null });
  else if ("addMass" in d) add(0, 0);
  else if ("take" in d || "append" in d) {
    const box = document.querySelector("[data-paste]");
    typed.delete(mark(box));
    edit({ do: "append" in d ? "append" : "paste", value: box.value });
  } else if ("print" in d) {
    const page = window.open(d.print);
    page.addEventListener("load", () => page.print());
  } else if (at.classList.contains("spectrum")) {
    const box = at.getBoundingClientRect();
    edit({ do: "peak", value: +d.low + (+d.high - +d.low) * (event.clientX - box.left) / box.width });
  } else if (at.id === "plate-view") {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(at.getScreenCTM().inverse());
    const [x, y] = [point.x, d.width - point.y];
    if (x >= 0 && y >= 0 && x <= +d.length && y <= +d.width) add(Math.round(x), Math.round(y));
  }
});
async function drop(file) {
  flush();
  await pending;
  say(`reading ${file.name}`);
  try {
    const response = await fetch(`${base}/file?name=${encodeURIComponent(file.name)}`,
      { method: "POST", headers: { "Content-Type": "application/octet-stream" }, body: file });
    const said = await response.json();
    say(said.said || said.error, !response.ok);
    if (response.ok) show(said);
  } catch { say("The server does not answer, or the file is too large.", true); }
}
document.addEventListener("dragover", (event) => { if (visit) event.preventDefault(); });
document.addEventListener("drop", (event) => {
  if (!visit || !event.dataTransfer.files.length) return;
  event.preventDefault();
  drop(event.dataTransfer.files[0]);
});
const add = (x, y) => edit({ do: "sensor", index: document.querySelectorAll("[data-sensor]").length,
  value: { mass_g: "1", x_mm: String(x), y_mm: String(y) } });
document.addEventListener("keydown", (event) => {
  if (!visit || !(event.ctrlKey || event.metaKey)) return;
  const key = event.key.toLowerCase();
  if (key === "s") { event.preventDefault(); act({ do: "save" }); }
  if (key === "z" && !event.target.matches("textarea")) { event.preventDefault(); edit({ do: event.shiftKey ? "redo" : "undo" }); }
});
ask(`${base}/news?seen=-1&structure=-1`).then((news) => { show(news); listen(); });
