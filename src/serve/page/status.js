import { h, icon } from "./dom.js";
import { KINDS } from "./lists.js";
import { t } from "./messages.js";

export const STATUSES = ["critical", "warning", "overdue", "unknown", "learning", "ok"];
export const MEANING = {
  critical: t`an alarm of severity critical`,
  warning: t`an alarm of severity warning`,
  overdue: t`the next test is late`,
  unknown: t`the latest test gives no result`,
  learning: t`no baseline yet`,
  ok: t`agrees with the baseline`,
};
export const STATES = {
  open: t`open`, acknowledged: t`acknowledged`, shelved: t`shelved`, maintenance: t`in maintenance`, resolved: t`resolved`, false_alarm: t`false alarm`,
};

export const rank = (status) => {
  const at = STATUSES.indexOf(status);
  return at < 0 ? 3 : at;
};
export const known = (status) => (STATUSES.includes(status) || status === "info" ? status : "unknown");
export const kindName = (kind) => (KINDS[kind] ? t(KINDS[kind].label) : kind ?? t`Anomaly`);
/** A kind in one word, for narrow places. */
export const kindWord = (kind) => ({ thermal: t`warm-up`, step: t`friction`, drift: t`friction`, fleet: t`unlike others`, oscillation: t`oscillation`, sensor: t`sensor`, accuracy: t`accuracy`, payload: t`payload` }[kind] ?? kind);
export const stateName = (state) => STATES[state] ?? state ?? "";
export const jointName = (joint) => (joint === null || joint === undefined ? t`whole arm` : t`joint ${joint}`);

const WORDS = {
  critical: t`critical`, warning: t`warning`, info: t`info`, overdue: t`overdue`, unknown: t`unknown`, learning: t`learning`, ok: t`ok`,
  complete: t`complete`, doubtful: t`doubtful`, refused: t`refused`,
};
/** A status or severity as a word. */
export const statusName = (status) => WORDS[status] ?? status ?? WORDS.unknown;
export const severityName = statusName;
/** A status as an icon with a distinct shape and a word. */
export function badge(status, word = statusName(status)) {
  return h("span", { class: `badge s-${known(status)}` }, icon(known(status)), h("span", null, word));
}
