import { h } from "./dom.js";
import { change, clauses, digits, fixed, isNumber, moment, percent, sentence, withoutJoint } from "./format.js";
import { QUANTITIES } from "./lists.js";
import { t } from "./messages.js";
import { jointName, rank, stateName } from "./status.js";

const times = (value) => t`${digits(value, 3)} times`;

/** How a value or score is written, by the form of its quantity. */
const FORMS = {
  number: (value) => digits(value, 3),
  ratio: (value) => `${fixed(value, 3)} (${change(value)})`,
  fraction: (value) => percent(value),
  times,
  times_of_logarithm: (value) => times(Math.exp(value)),
  standard_errors: (value) => t`${digits(value, 3)} standard errors`,
  with_unit: (value, unit) => `${digits(value, 3)} ${unit}`,
};
const UNKNOWN = { value: "number", score: "number" };

/** An oscillation's value is how far the RMSD swings. */
export const quantityName = (quantity, kind) => (kind === "oscillation" && quantity === "moving_relative_rmsd"
  ? t`swing of the relative RMSD from cycle to cycle` : t(QUANTITIES[quantity]?.label ?? quantity));

/** Whether the quantity is the level of a joint's friction, however it is measured. */
export const isFriction = (quantity) => QUANTITIES[quantity]?.friction ?? false;

function written(one, use, value) {
  const of = QUANTITIES[one.quantity] ?? UNKNOWN;
  return FORMS[of[use]](value, of.unit);
}

/** A value of an anomaly, in the unit of its quantity. */
export const figure = (one, value) => (isNumber(value) ? written(one, "value", value) : t`no figure`);

/** Limit and score of an anomaly. One that no figure measures has neither, and some have a score and no limit. */
export function limitAndScore(one) {
  const said = (value) => (isNumber(value) && isNumber(one.value) ? written(one, "score", value) : null);
  const score = said(one.score);
  const smoothed = one.kind === "drift" || one.kind === "step";
  const text = score && (smoothed ? t`score ${score}, smoothed over the tests` : t`score ${score}`);
  return [(one.threshold ? said(one.threshold) : null) ?? t`none`, text ?? ""];
}

/** Size of an alarm as a multiple of its limit, so that alarms of all quantities compare. */
const sizeOf = (one) => (isNumber(one.score) && one.threshold > 0 ? Math.abs(one.score) / one.threshold : 0);
const isClosed = (one) => ["resolved", "false_alarm"].includes(one.state);

/** The order of alarms everywhere: those to do first, then by severity, size and time. */
export const worstAlarmFirst = (a, b) => isClosed(a) - isClosed(b) || rank(a.severity) - rank(b.severity) || sizeOf(b) - sizeOf(a)
  || b.last_seen_at.localeCompare(a.last_seen_at) || a.anomaly_id - b.anomaly_id;

/** The state of an alarm, with the end of a state that ends by itself. */
export const stateText = (one, style) => (one.state === "shelved" && one.shelved_until ? t`shelved until ${moment(one.shelved_until, style)}` : stateName(one.state));

/** The finding of an alarm, without values and advice that follow. */
export const findingOf = (one) => sentence(clauses(withoutJoint(one.message, jointName(one.joint)))[0]);

// Words of all clauses of findings.tsv that say what to do, in the languages of the page.
const ADVICE = /\b(?:check|look) |or record |controllare|cercare|registrare il|prüfen|suchen|eintragen|请/;
const after = (one, isAdvice) => clauses(one.message).slice(1).filter((text) => ADVICE.test(text) === isAdvice).map((text) => `${sentence(text)}.`);

/** What follows the finding: values. */
export const more = (one) => after(one, false);

/** What to do about an alarm, as a line of its own; null if its message says nothing. */
export function whatToDo(one, props) {
  const said = after(one, true);
  return said.length ? h("span", props, h("b", null, t`What to do:`), ` ${said.join(" ")}`) : null;
}
