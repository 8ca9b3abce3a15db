import { t } from "./messages.js";
const SVG = "http://www.w3.org/2000/svg";

// what crates/model/src/text.rs hides
const HIDDEN = /(?![\n\t])[\p{Cc}\p{Zl}\p{Zp}\p{Bidi_Control}\p{Default_Ignorable_Code_Point}\p{Noncharacter_Code_Point}\ufff9-\ufffb]/gu;

/** Text as people may see it: hidden characters as \u{202e}. */
function shown(text) {
  return text.replace(HIDDEN, (character) => `\\u{${character.codePointAt(0).toString(16)}}`);
}

function append(node, children) {
  for (const child of children.flat(Infinity)) {
    if (child === null || child === undefined || child === false) continue;
    node.append(child instanceof Node ? child : shown(String(child)));
  }
  return node;
}

/** An element. Text always becomes a text node, so nothing from the server is read as markup. */
export function h(tag, props, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(props ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "class") node.className = value;
    else if (name === "value") node.value = value;
    else if (name === "title" || name === "aria-label") node.setAttribute(name, shown(String(value)));
    else node.setAttribute(name, value === true ? "" : value);
  }
  return append(node, children);
}

export function svg(tag, props, ...children) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(props ?? {})) node.setAttribute(name, value);
  return append(node, children);
}

export function icon(name) {
  const node = svg("svg", { class: `icon i-${name}`, "aria-hidden": "true" });
  node.append(svg("use", { href: `#i-${name}` }));
  return node;
}

export function hidden(text) {
  return h("span", { class: "hidden" }, text);
}

/** Replaces the children of a node; the focus stays on the element of the same key, and the page does not jump. */
export function replace(node, ...children) {
  const active = document.activeElement;
  const key = node.contains(active) ? active.closest("[data-key]")?.dataset.key : null;
  const open = new Set([...node.querySelectorAll("details[data-key][open]")].map((one) => one.dataset.key));
  // Asking for the height makes the browser lay the page out, which an empty node does not need.
  if (node.firstChild) node.style.minHeight = `${node.offsetHeight}px`;
  node.replaceChildren(append(document.createDocumentFragment(), children));
  for (const one of node.querySelectorAll("details[data-key]")) if (open.has(one.dataset.key)) one.open = true;
  node.style.minHeight = "";
  if (key) node.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus({ preventScroll: true });
}

/** A table in a box of its own that scrolls sideways on narrow screens. */
export function table({ caption, showCaption, columns, rows, key, tall }) {
  const head = h("tr", null, columns.map((one) => h("th", { scope: "col", class: one.number ? "number" : null }, one.title)));
  const body = rows.map((row) => h("tr", null, columns.map((one, index) => {
    const content = one.cell(row);
    const props = { class: [one.number && "number", one.wide && "wide"].filter(Boolean).join(" ") || null };
    return index === 0 ? h("th", { scope: "row", ...props }, content) : h("td", props, content);
  })));
  const scroll = h("div", { class: tall ? "scroll tall" : "scroll", tabindex: 0, role: "group", "aria-label": caption, "data-key": key ?? caption },
    h("table", null, h("caption", { class: showCaption ? null : "hidden" }, caption), h("thead", null, head), h("tbody", null, body)));
  return rows.length && !Array.isArray(rows[0]) ? [scroll, csvButton(caption, rows)] : scroll;
}

/** A button that saves rows of a view with all their columns, units in the names. */
function csvButton(caption, rows) {
  return h("button", { type: "button", class: "quiet", "data-key": `csv/${caption}`, "aria-label": t`${caption}: save as CSV`, onclick: () => {
    save(new Blob([csv(rows)], { type: "text/csv;charset=utf-8" }), `armwatch ${caption}.csv`);
  } }, t`Save as CSV`);
}

/** Saves a file on this device. */
export function save(blob, name) {
  const url = URL.createObjectURL(blob);
  h("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

function csv(rows) {
  const names = Object.keys(rows[0]).filter((name) => rows.some((row) => row[name] === null || typeof row[name] !== "object"));
  const cell = (value) => {
    if (value === null || value === undefined) return "";
    // A spreadsheet would compute what begins so.
    const text = typeof value === "string" && /^[=+@\t\r-]/.test(value) ? `'${value}` : String(value);
    return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [names, ...rows.map((row) => names.map((name) => row[name]))].map((row) => row.map(cell).join(",")).join("\r\n");
}

const told = new WeakSet();
/** Writes a fault of the page itself to the console. A request that failed shows on the page. */
export function logFault(error) {
  if (error.status !== undefined || error.name === "AbortError" || told.has(error)) return;
  told.add(error);
  console.error(error);
}

let announcing;
export function announce(text) {
  const node = document.getElementById("announce");
  clearTimeout(announcing);
  node.textContent = "";
  announcing = setTimeout(() => { node.textContent = text; }, 60);
}

const NOTICE_MS = 6000;
const UNDO_MS = 30_000;
let notices = [];

const keepNotices = (keeps) => {
  for (const one of notices) if (!keeps(one)) one.node.remove();
  notices = notices.filter((one) => one.node.isConnected);
};

/** Removes all notices but the latest: another page is shown. */
export const keepLastNotice = () => keepNotices((one) => one === notices.at(-1));

/** Removes notices about states that alarms no longer have. The rows were asked for at `asked`. */
export const checkNotices = (rows, asked) => keepNotices((one) => one.at > asked || !rows.some((row) => row.anomaly_id === one.alarm && row.state !== one.state));

/**
 * A short note at the screen's edge that a screen reader hears too. `undo` takes back what it reports. It replaces the
 * note about the same robot or file; one about the `state` of an `alarm` lasts as long as the alarm has it.
 */
export function toast(text, { undo, about, alarm, state } = {}) {
  const button = undo ? h("button", { type: "button", class: "quiet", onclick: async () => {
    button.disabled = true;
    try {
      await undo();
      node.remove();
    } catch (error) {
      node.replaceChildren(h("span", null, t`Not undone: ${error.message}`));
      announce(t`Not undone: ${error.message}`);
    }
  } }, t`Undo`) : null;
  const node = h("div", { class: "toast" }, h("span", null, text), button);
  keepNotices((one) => about === undefined || one.about !== about);
  document.getElementById("toasts").append(node);
  notices.push({ node, about, alarm, state, at: Date.now() });
  announce(undo ? t`${text} Undo is at the end of the page.` : text);
  setTimeout(() => node.remove(), undo ? UNDO_MS : NOTICE_MS);
}

export function remembered(key, fallback = "") {
  try { return localStorage.getItem(`armwatch.${key}`) ?? fallback; } catch { return fallback; }
}

export function remember(key, value) {
  try { localStorage.setItem(`armwatch.${key}`, value); } catch { /* Without storage nothing is remembered. */ }
}
