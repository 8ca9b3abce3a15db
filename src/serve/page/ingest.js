import { dismissButton, retryButton, whyNot } from "./actions.js";
import { fleet, get, getFile, rights, view } from "./api.js";
import { h, icon, replace, save, toast } from "./dom.js";
import { ago, count, moment, plural, sentence } from "./format.js";
import { t } from "./messages.js";
import { empty, part } from "./part.js";
import { demoNote, watchedNote } from "./fleet.js";
import { runTable } from "./robot.js";
import { dropPlace } from "./upload.js";

const STATES = {
  open: "open", dismissed: "dismissed", earlier: t`another fault was found later`, reading: t`being read again`, stored: t`stored since`, superseded: t`replaced by a corrected export`,
};

function fact(name, value) {
  return value === null || value === undefined || value === "" ? null : h("div", null, h("dt", null, name), h("dd", null, value));
}

/** The export itself, for who may act on it: the lines around the fault, and the file. */
function original(one) {
  if (!rights?.act || one.line === null || !["open", "dismissed"].includes(one.state)) return null;
  const body = h("div");
  const lines = h("details", { "data-key": `lines/${one.fault_id}`, ontoggle: async () => {
    if (!lines.open || body.firstChild) return;
    try {
      const found = await get(`v1/quarantine/${one.run_id}/excerpt`);
      const file = h("button", { type: "button", class: "quiet", "data-key": `file/${one.fault_id}`, onclick: async () => {
        try { save(await getFile(`v1/quarantine/${one.run_id}/file`), one.source_name); } catch (error) { toast(error.message); }
      } }, t`Save the original file`);
      replace(body, h("pre", { class: "excerpt", tabindex: 0, "aria-label": t`Lines around the fault` }, found.lines.map((text, index) => excerptLine(found, text, index))), file);
    } catch (error) {
      replace(body, h("p", { class: "muted" }, error.message, "."));
    }
  } }, h("summary", { "data-key": `lines-summary/${one.fault_id}` }, t`Lines around the fault`), body);
  return lines;
}

function excerptLine(found, text, index) {
  const number = found.first_line + index;
  const cells = [...text];
  const { cell_begin: begin, cell_end: end } = found;
  const whole = number !== found.line || begin === null;
  return h("span", { class: number === found.line ? "at" : null }, h("span", { class: "muted" }, String(number).padStart(6), "  "),
    whole ? text : [cells.slice(0, begin).join(""), h("mark", null, cells.slice(begin, end).join("")), cells.slice(end).join("")], "\n");
}

function fault(one, soon) {
  return h("li", { class: "fault" },
    h("div", { class: "fault-head" },
      h("h3", null, one.source_name),
      one.state === "open" ? h("div", { class: "pair" }, retryButton(one, soon), dismissButton(one, soon)) : one.state === "dismissed" ? retryButton(one, soon) : h("span", { class: "tag" }, STATES[one.state] ?? one.state)),
    h("p", { class: "lead" }, sentence(one.problem), "."),
    one.remedy ? h("p", null, h("b", null, t`What to do:`), " ", one.remedy, ".") : null,
    original(one),
    one.retry_asked_at ? h("p", { class: "muted" }, t`Another attempt was asked for ${ago(one.retry_asked_at)}.`) : null,
    one.dismissal_reason ? h("p", { class: "muted" }, t`Dismissed by ${one.dismissed_by ?? t`somebody`}: ${one.dismissal_reason}`) : null,
    h("dl", { class: "facts" },
      fact(t`Robot`, one.robot), fact(t`Line`, one.line === null ? null : count(one.line)), fact(t`Column`, one.column_name),
      fact(t`Value`, one.value === null ? null : h("code", null, one.value)), fact(t`Cycles stored before it`, one.cycles_stored ? count(one.cycles_stored) : null),
      fact(t`Found`, [moment(one.last_at), one.tries > 1 ? h("small", null, t`${plural(one.tries, "attempt")}, the first ${ago(one.first_at)}`) : null]),
      fact(t`Run`, h("a", { href: `#/run/${one.run_id}`, "data-key": `fault/${one.fault_id}` }, t`run ${one.run_id}`))));
}

function blocked(one) {
  return h("li", { class: "fault" },
    h("div", { class: "fault-head" }, h("h3", null, one.source_name), h("span", { class: "tag" }, t`still growing`)),
    h("p", { class: "lead" }, one.line === null ? t`Cannot be read since ${moment(one.blocked_at)}` : t`Cannot be read beyond line ${count(one.line)} since ${moment(one.blocked_at)}`, `: ${one.problem}.`),
    one.remedy ? h("p", null, h("b", null, t`What to do:`), " ", one.remedy, ".") : null,
    h("dl", { class: "facts" }, fact(t`Robot`, one.robot),
      fact(t`Run`, one.run_id === null ? null : h("a", { href: `#/run/${one.run_id}`, "data-key": `blocked/${one.run_id}` }, t`run ${one.run_id}`))));
}

export function mount({ main, title }) {
  title(t`Ingest`);
  const refresh = () => Promise.all(parts.map((one) => one.refresh()));
  const soon = () => { refresh().catch(() => {}); };

  const live = part({
    title: t`Live files`, className: "flush",
    load: async (signal) => (await fleet(signal)).live,
    draw: (rows) => (rows.length ? h("ul", { class: "lives" }, rows.map((one) => h("li", null,
      h("a", { class: "row-link live-row", href: `#/run/${one.run_id}`, "data-key": `live${one.run_id}` }, h("span", { class: "badge s-live" }, icon("live"), one.robot),
        h("span", null, t`${plural(one.cycles, "cycle")} so far`), h("span", { class: "muted file" }, one.source_name), h("span", { class: "muted" }, t`began ${ago(one.started_at)}`)))))
      : h("p", { class: "page-note" }, t`No file is being read now.`)),
  });

  const stuck = part({
    title: t`Cannot be read further`, note: t`Growing files with a fault. They are tried again while they grow, and judged when they are complete.`,
    load: async (signal) => (await view("blocked_files", { order: "-blocked_at", limit: 300 }, signal)).rows,
    draw: (rows) => (rows.length ? h("ul", { class: "faults" }, rows.map(blocked))
      : h("p", { class: "calm bare-calm" }, icon("ok"), t`Every growing file is read as far as it is written.`)),
  });

  const quarantine = part({
    title: t`In quarantine`, note: t`Exports that were not understood. Correct the export or the layout, then retry.`,
    load: async (signal) => (await view("quarantine", { order: "-last_at", limit: 300 }, signal)).rows,
    draw: (rows) => {
      const open = rows.filter((one) => one.state === "open" || one.state === "reading");
      const settled = rows.filter((one) => !open.includes(one));
      return [
        open.length ? whyNot() : null,
        open.length ? h("ul", { class: "faults" }, open.map((one) => fault(one, soon))) : h("p", { class: "calm bare-calm" }, icon("ok"), t`No export is in quarantine.`),
        settled.length ? h("details", { "data-key": "settled" }, h("summary", { "data-key": "settled-summary" }, plural(settled.length, "settled fault")), h("ul", { class: "faults" }, settled.map((one) => fault(one, soon)))) : null,
      ];
    },
  });

  const runs = part({
    title: t`Latest runs`,
    load: async (signal) => ({ rows: (await view("runs", { order: "-run_id", limit: 30 }, signal)).rows, fleet: { watched: (await fleet(signal)).watched } }),
    draw: ({ rows, fleet }) => (rows.length ? runTable(rows, t`The latest 30 runs`, true)
      : empty(h("p", null, t`No export was read yet.`), watchedNote(fleet), demoNote())),
  });

  const drop = dropPlace(soon);
  const parts = [live, stuck, quarantine, runs];
  main.replaceChildren(h("h1", { tabindex: -1 }, t`Ingest`),
    ...(drop ? [h("section", { class: "part" }, h("div", { class: "part-head" }, h("h2", null, t`Send an export`)), drop)] : []), ...parts.map((one) => one.element));
  return { refresh, destroy() { for (const one of parts) one.destroy(); } };
}
