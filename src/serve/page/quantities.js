import { change, clauses, digits, finding, fixed, isNumber, percent, sentence } from "./format.js";
import { KINDS, QUANTITIES } from "./lists.js";
import { language, t } from "./messages.js";

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

/**
 * The finding of an alarm, without the joint, which stands beside it. Detectors write English; in another language the
 * sentence is made of the quantity and its values.
 */
export function findingOf(one) {
  if (language === "en") return finding(one.message);
  const name = sentence(quantityName(one.quantity, one.kind));
  if (!isNumber(one.value) || !isNumber(one.baseline)) return t`${name}: not plausible`;
  const limit = one.threshold ? [written(one, "score", one.threshold)] : [];
  const [value, expected] = [figure(one, one.value), figure(one, one.baseline).replace(/ \([^()]*%\)$/, "")];
  return limit.length ? t`${name}: ${value}, expected ${expected} (limit ${limit[0]})` : t`${name}: ${value}, expected ${expected}`;
}

/** What follows the finding: values and advice. */
export function more(one) {
  const rest = clauses(one.message).slice(1).map((text) => `${sentence(text)}.`);
  return language === "en" ? rest : [t(KINDS[one.kind]?.advice ?? "")];
}
