import { h, logFault, replace } from "./dom.js";
import { mayAskAgain } from "./api.js";
import { t } from "./messages.js";

let number = 0;

const PATIENCE_MS = 5000;

/** A note until the data are there. If that takes long, it says so. */
export function loading(begins = true) {
  const note = h("p", { class: "page-note loading" }, t`Loading`);
  if (begins) runsLong(note);
  return note;
}

function runsLong(note) {
  setTimeout(() => { if (note.isConnected) note.textContent = t`No answer from the daemon yet. The page keeps waiting.`; }, PATIENCE_MS);
}

export function failed(error, retry) {
  return h("div", { class: "failure", role: "alert" }, h("p", null, error.message),
    h("button", { type: "button", "data-key": "retry", onclick: () => { mayAskAgain(); retry(); } }, t`Try again`));
}

export function empty(...children) {
  return h("div", { class: "empty" }, ...children.map((one) => (one instanceof Node ? one : h("p", null, one))));
}

/**
 * A part of a page with separate data. It is drawn again only if its data have changed, so that focus, open menus and
 * scroll positions stay. `draw` returns the content, and adds to `owned` the objects that must be destroyed.
 */
export function part({ title, note, tools, load, draw, lazy = false, quiet = 0, level = 2, className = "" }) {
  const id = `p${++number}`;
  const waiting = loading(!lazy);
  const body = h("div", { class: "part-body" }, waiting);
  const element = h("section", { class: `part ${className}`, "aria-labelledby": title ? id : null },
    title ? h("div", { class: "part-head" }, h(`h${level}`, { id }, title), tools) : null,
    note ? h("p", { class: "part-note" }, note) : null, body);
  let seen = null;
  let owned = [];
  let running = null;
  let wanted = !lazy;
  let gone = false;
  let last = 0;
  let later = null;

  function show(content, fresh) {
    for (const one of owned) one.destroy();
    owned = fresh;
    replace(body, content);
  }

  async function refresh(now = false) {
    if (!wanted || gone) return;
    const wait = last + quiet - Date.now();
    if (!now && wait > 0) {
      later ??= setTimeout(() => { later = null; refresh(true); }, wait);
      return;
    }
    last = Date.now();
    running?.abort();
    const own = new AbortController();
    running = own;
    try {
      const data = await load(own.signal);
      if (gone || own !== running) return;
      const text = JSON.stringify(data);
      if (text === seen) return;
      seen = text;
      const fresh = [];
      show(draw(data, fresh), fresh);
    } catch (error) {
      if (gone || error.name === "AbortError") return;
      logFault(error);
      // Shown data stay: the note next to the page's name gives their age.
      if (seen !== null && error.status === 0) throw error;
      seen = null;
      show(failed(error, () => refresh(true)), []);
      throw error;
    }
  }

  let watcher = null;
  if (lazy) {
    watcher = new IntersectionObserver((entries) => {
      if (!entries.some((one) => one.isIntersecting)) return;
      watcher.disconnect();
      wanted = true;
      runsLong(waiting);
      refresh(true).catch(() => {});
    }, { rootMargin: "400px" });
    watcher.observe(element);
  }
  return {
    element,
    refresh,
    /** Loads again after another choice, because the shown content is no longer valid. */
    again() {
      seen = null;
      return refresh(true).catch(() => {});
    },
    destroy() {
      gone = true;
      running?.abort();
      clearTimeout(later);
      watcher?.disconnect();
      for (const one of owned) one.destroy();
    },
  };
}
