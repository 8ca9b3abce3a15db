import { change, digits, fixed, isNumber, percent } from "./format.js";

// How a figure is written.
const none = () => null;
const plain = (value) => digits(value, 3);
const fraction = (value) => percent(value);
const index = (value) => `${fixed(value, 3)} (${change(value)})`;
const times = (value) => `${digits(value, 3)} times`;
const logarithm = (value) => times(Math.exp(value));
const errors = (value) => `${digits(value, 3)} standard errors`;
const nm = (value) => `${digits(value, 3)} Nm`;
const kg = (value) => `${digits(value, 3)} kg`;
// A sliding joint's is in metres.
const rad = (value) => `${digits(value, 3)} rad (m)`;

/** Quantities of anomalies: what people call each, how its values are written, and how its limit and score are. */
const QUANTITIES = {
  friction_index: ["friction index", index, fraction],
  common_friction_ratio: ["friction common to all joints, against the usual", index, fraction],
  warm_friction_nm: ["warm friction", friction, fraction],
  excitation_friction_nm: ["friction of the excitation", friction, fraction],
  friction_swing: ["swing of friction from cycle to cycle", fraction, fraction],
  warm_up_time_ratio: ["warm-up time, against the usual", times, logarithm],
  common_warm_up_time_ratio: ["warm-up time common to all joints, against the usual", times, logarithm],
  moving_relative_rmsd: ["relative RMSD, moving", fraction, fraction],
  friction_of_model_nm: ["friction against other arms", nm, logarithm],
  rmsd_of_model: ["RMSD against other arms", fraction, logarithm],
  load_kg: ["load", kg, errors],
  torque_signal: ["torque signal", signal, ofSignal],
  position_offset_rad: ["position offset", rad, rad],
  unexplained_torque: ["torque that the model leaves unexplained, against the usual", times, times],
  inertial_parameters: ["inertial parameters", none, none],
  contact: ["relative RMSD of one cycle, beside its neighbours", fraction, times],
  position_signal: ["position signal", none, none],
  velocity_signal: ["velocity signal", none, none],
  time_stamps: ["time stamps", none, none],
  rows: ["rows of the export", none, none],
  motion: ["motion of the test", none, none],
  model: ["model of the arm", none, none],
  production_friction: ["friction in ordinary work, against the test's", times, fraction],
  production_relative_rmsd: ["relative RMSD in ordinary work", fraction, fraction],
  production_torque_signal: ["torque signal in ordinary work", signal, ofSignal],
  production_load_kg: ["load in ordinary work", kg, errors],
};

/** A step inside a test is told as a ratio, by whatever friction the joint is judged. */
function friction(value, one) {
  return one.kind === "step" && one.baseline === 1 ? index(value) : nm(value);
}

/** An offset of a torque signal is a torque, compared with none; noise and gain are compared with one. */
function signal(value, one) {
  return one.baseline === 0 ? nm(value) : times(value);
}

/** The limit of noise is a ratio, that of gain the part by which it has changed. */
function ofSignal(value, one) {
  if (one.baseline === 0) return nm(value);
  return one.threshold >= 1 ? times(value) : fraction(value);
}

/** An oscillation's value is how far the RMSD swings. */
export const quantityName = (quantity, kind) => (kind === "oscillation" && quantity === "moving_relative_rmsd"
  ? "swing of the relative RMSD from cycle to cycle" : QUANTITIES[quantity]?.[0] ?? quantity);

/** A value of an anomaly, in the unit of its quantity. */
export function figure(one, value) {
  const [, form] = QUANTITIES[one.quantity] ?? [null, plain];
  return (isNumber(value) ? form(value, one) : null) ?? "no figure";
}

/** Limit and score of an anomaly. One that no figure measures has neither, and some have a score and no limit. */
export function limitAndScore(one) {
  const [, , form] = QUANTITIES[one.quantity] ?? [null, plain, plain];
  const said = (value) => (isNumber(value) && isNumber(one.value) ? form(value, one) : null);
  const score = said(one.score);
  const smoothed = one.kind === "drift" || one.kind === "step" ? ", smoothed over the tests" : "";
  return [(one.threshold ? said(one.threshold) : null) ?? "none", score ? `score ${score}${smoothed}` : ""];
}
