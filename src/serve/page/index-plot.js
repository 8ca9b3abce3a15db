import { h } from "./dom.js";
import { change, isNumber } from "./format.js";
import { t } from "./messages.js";
import { plot, seconds } from "./plot.js";
import { jointName, kindName } from "./status.js";

const WIDTH = 1.96;

export function bounds(row) {
  const half = isNumber(row.friction_index_std_error) ? WIDTH * row.friction_index_std_error : null;
  return half === null ? [null, null] : [row.friction_index - half, row.friction_index + half];
}

/** The range that contains all these indices with their intervals, and the limits. */
export function commonRange(rows, limits = []) {
  let low = 0.97;
  let high = 1.03;
  for (const row of rows) {
    if (!isNumber(row.friction_index)) continue;
    const [from, to] = bounds(row);
    low = Math.min(low, from ?? row.friction_index);
    high = Math.max(high, to ?? row.friction_index);
  }
  for (const one of limits) {
    low = Math.min(low, one.value);
    high = Math.max(high, one.value);
  }
  const gap = (high - low) * 0.05;
  return [low - gap, high + gap];
}

/** Limits of the index, if the daemon reports them: of the fleet, otherwise of an alarm of this joint. */
export function limitsOf(fleet, anomalies, joint) {
  const told = fleet?.limits;
  const lines = [];
  if (isNumber(told?.drift_warning_fraction)) lines.push({ value: 1 + told.drift_warning_fraction, label: t`warning`, color: "--warning-icon", dash: [6, 4] });
  if (isNumber(told?.drift_critical_fraction)) lines.push({ value: 1 + told.drift_critical_fraction, label: t`critical`, color: "--critical", dash: [2, 3] });
  if (!lines.length) {
    const own = anomalies.find((one) => one.joint === joint && one.quantity === "friction_index" && (one.kind === "drift" || one.kind === "step") && isNumber(one.threshold));
    if (own) lines.push({ value: 1 + own.threshold, label: t`limit of the alarm`, color: "--warning-icon", dash: [6, 4] });
  }
  return lines;
}

/** The smoothed index that an alarm compares with its limit, at the time of its latest test; null for other alarms. */
export function smoothedOf(one) {
  if (one.quantity !== "friction_index" || (one.kind !== "drift" && one.kind !== "step") || !isNumber(one.score) || !isNumber(one.value)) return null;
  const side = one.value < 1 ? -1 : 1;
  return { x: seconds(one.last_seen_at), y: 1 + side * Math.abs(one.score), limit: isNumber(one.threshold) ? 1 + side * one.threshold : null };
}

/** Limits on the plot of an alarm: its own one too, if it is another than that of a warning. */
export function limitsOfAlarm(fleet, one) {
  const lines = limitsOf(fleet, [one], one.joint);
  const own = smoothedOf(one)?.limit ?? null;
  return own === null || lines.some((line) => Math.abs(line.value - own) < 1e-9) ? lines : [...lines, { value: own, label: t`limit of the alarm`, color: "--ink", dash: [8, 3] }];
}

/** Onsets of alarms and times of maintenance that concern a joint, as marks over time. */
export function marksOf(anomalies, works, joint) {
  const concerns = (one) => one.joint === null || one.joint === joint;
  return [
    ...anomalies.filter((one) => concerns(one) && one.onset_at && one.severity !== "info")
      .map((one) => ({ x: seconds(one.onset_at), label: t`onset: ${kindName(one.kind)}`, kind: "onset", color: "--critical", dash: [] })),
    ...works.filter((one) => concerns(one) && one.at).map((one) => ({ x: seconds(one.at), label: one.what, kind: "maintenance", color: "--plot-mark", dash: [3, 3] })),
  ];
}

/** Entries for what a plot draws. Marks give their times, so that those outside of the plot are left out. */
export function legendOf(limits, marks, others = [], smoothed = null) {
  const at = (kind) => marks.filter((one) => one.kind === kind).map((one) => one.x);
  const lines = [...new Map(limits.map((one) => [`${one.label}${one.value}`, one])).values()];
  return [
    { label: t`friction index, 95 % interval`, color: "--plot", band: true },
    others.length ? { label: t`other arms of the model`, color: "--plot-grey" } : null,
    ...lines.map((one) => ({ label: `${one.label} (${change(one.value, 0)})`, color: one.color, dash: [4, 2] })),
    smoothed ? { label: t`smoothed over the tests, as the limit compares it`, color: "--c2", dot: true, line: false } : null,
    { label: t`onset of an alarm`, color: "--critical", upright: true, at: at("onset") },
    { label: t`maintenance`, color: "--plot-mark", upright: true, dash: [2, 1.5], at: at("maintenance") },
  ].filter(Boolean);
}

/** The friction index of a joint over calendar time, with its interval, limits and marks. */
export function indexPlot({ rows, joint, limits = [], marks = [], range, xRange, title, head, others = [], smoothed = null, sync, height, plain }, owned) {
  const known = rows.filter((row) => isNumber(row.friction_index));
  if (!known.length && !others.length) {
    return h("figure", { class: "plot" }, h("figcaption", { class: "plot-title" }, head ?? title), h("p", { class: "muted" }, t`No friction index yet. It needs a baseline of five full tests.`));
  }
  const series = [
    ...others.map((one) => ({ label: one.label, x: one.x, y: one.y, color: "--plot-grey", width: 1, spanGaps: true })),
    {
      label: title ?? jointName(joint), x: known.map((row) => seconds(row.started_at)), y: known.map((row) => row.friction_index),
      low: known.map((row) => bounds(row)[0]), high: known.map((row) => bounds(row)[1]), band: true, color: "--plot", points: known.length <= 90, size: 5,
    },
    ...(smoothed ? [{ label: t`smoothed over the tests`, x: [smoothed.x], y: [smoothed.y], color: "--c2", points: true, line: false, size: 10 }] : []),
  ];
  const low = commonRange(known, smoothed ? [...limits, { value: smoothed.y }] : limits);
  return plot({
    title: title ?? jointName(joint), head, label: t`Friction index of ${title ?? jointName(joint)}`, time: true, xLabel: t`time`, yLabel: t`change of friction`,
    boundsLabel: t`95 % interval`, format: (value) => change(value), formatTick: (value) => change(value, 0).replace("±", ""), series,
    limits: [{ value: 1, color: "--strong-line", dash: [1, 3] }, ...limits], marks, yRange: range ?? low, xRange, sync, legend: plain ? [] : legendOf(limits, marks, others, smoothed), height,
  }, owned);
}
