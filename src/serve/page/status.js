import { h, icon } from "./dom.js";
import { KINDS } from "./lists.js";

export const STATUSES = ["critical", "warning", "overdue", "unknown", "learning", "ok"];
export const MEANING = {
  critical: "an alarm of severity critical",
  warning: "an alarm of severity warning",
  overdue: "the next test is late",
  unknown: "the latest test does not tell",
  learning: "no baseline yet",
  ok: "agrees with the baseline",
};
export const STATES = {
  open: "open", acknowledged: "acknowledged", shelved: "shelved", maintenance: "in maintenance", resolved: "resolved", false_alarm: "false alarm",
};

export const rank = (status) => {
  const at = STATUSES.indexOf(status);
  return at < 0 ? 3 : at;
};
export const known = (status) => (STATUSES.includes(status) || status === "info" ? status : "unknown");
export const kindName = (kind) => KINDS[kind]?.label ?? kind ?? "Anomaly";
/** A kind in one word, where there is little space. */
export const kindWord = (kind) => ({ thermal: "warm-up", step: "friction", drift: "friction", fleet: "unlike others" }[kind] ?? kind ?? "anomaly");
export const stateName = (state) => STATES[state] ?? state ?? "";
export const jointName = (joint) => (joint === null || joint === undefined ? "whole arm" : `joint ${joint}`);

/** Status as an icon of its own shape and a word. */
export function badge(status, word = status) {
  return h("span", { class: `badge s-${known(status)}` }, icon(known(status)), h("span", null, word ?? "unknown"));
}
