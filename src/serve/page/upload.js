import { rights, sendFile } from "./api.js";
import { h, replace, toast } from "./dom.js";
import { count, moment } from "./format.js";
import { t } from "./messages.js";

/** Largest export that the daemon explains, bytes. */
const MOST_EXPLAINED = 64 * 2 ** 20;

const NEXT = {
  store: t`This export can be stored.`,
  nothing: t`This export is stored already.`,
  quarantine: t`This export would go into quarantine.`,
};

const address = (file) => `v1/exports/${encodeURIComponent(file.name)}`;
const fact = (name, value) => (value === null || value === undefined ? null : h("div", null, h("dt", null, name), h("dd", null, value)));
const list = (title, texts) => (texts.length ? [h("h4", null, title), h("ul", null, texts.map((text) => h("li", null, text)))] : null);

function explanation(found) {
  return [
    h("p", { class: "lead" }, NEXT[found.next]),
    h("dl", { class: "facts" },
      fact(t`Robot`, found.robot), fact(t`Model`, found.model), fact(t`Layout`, found.layout),
      fact(t`Start`, found.started_at && moment(found.started_at)), fact(t`Rows`, found.rows === null ? null : count(found.rows)),
      fact(t`Cycles`, found.cycles === null ? null : found.kind === "production" ? count(found.cycles) : t`${count(found.cycles)}, ${count(found.cycles_identified)} of them with parameters`),
      fact(t`Run`, found.run_id === null ? null : h("a", { href: `#/run/${found.run_id}` }, t`run ${found.run_id}`)),
      fact(t`Takes the place of`, found.supersedes_run_id === null ? null : h("a", { href: `#/run/${found.supersedes_run_id}` }, t`run ${found.supersedes_run_id}`))),
    list(t`Problems`, found.problems), list(t`Remarks`, found.remarks),
  ];
}

/** A place to drop an export on: what it is, is shown before it is sent. Null for who may send none. */
export function dropPlace(sent) {
  if (!rights?.upload) return null;
  const answer = h("div", { "aria-live": "polite" });
  const picker = h("input", { type: "file", class: "hidden", id: "drop", accept: ".csv,.gz,.zst,.parquet,.mcap", onchange: () => { take(picker.files[0]); picker.value = ""; } });
  const place = h("div", { class: "drop" }, picker,
    h("label", { for: "drop" }, t`Drop an export here, or choose a file`), h("p", { class: "muted" }, t`It is read and explained before it is stored.`), answer);
  let turn = 0;

  const close = () => { turn += 1; replace(answer); };

  async function send(file, button) {
    button.disabled = true;
    try {
      await sendFile(address(file), file);
      toast(t`${file.name} is sent. It is read in a moment.`);
      close();
      sent();
    } catch (error) {
      button.disabled = false;
      replace(answer, h("p", { class: "failure", role: "alert" }, error.message));
    }
  }

  async function take(file) {
    if (!file) return;
    const own = ++turn;
    const actions = (may) => {
      const button = h("button", { type: "button", "data-key": "send", disabled: !may, onclick: () => send(file, button) }, t`Send`);
      return h("div", { class: "pair" }, may ? button : null, h("button", { type: "button", class: "quiet", "data-key": "not-sent", onclick: close }, may ? t`Do not send` : t`Close`));
    };
    const show = (...content) => { if (own === turn) replace(answer, h("h3", null, file.name), ...content); };
    if (file.size > MOST_EXPLAINED) return show(h("p", null, t`This file is too large to be explained first.`), actions(true));
    show(h("p", { class: "muted" }, t`Reading`));
    try {
      const found = await sendFile(`${address(file)}?explain=true`, file);
      show(explanation(found), actions(found.next === "store"));
    } catch (error) {
      show(h("p", { class: "failure", role: "alert" }, error.message), actions(false));
    }
  }

  const over = (is) => (event) => { event.preventDefault(); place.classList.toggle("over", is); };
  place.addEventListener("dragover", over(true));
  place.addEventListener("dragleave", over(false));
  place.addEventListener("drop", (event) => { over(false)(event); take(event.dataTransfer.files[0]); });
  return place;
}
