import { digits, fixed, isNumber, percent, tick } from "./format.js";
import { t } from "./messages.js";
import { JOINT_DASHES, plot, ramp } from "./plot.js";

const CURVE_POINTS = 80;
const newton = (value) => `${digits(value, 3)} Nm`;

/** Means of both directions, by cycle and speed level. */
function means(points) {
  const groups = new Map();
  for (const one of points) {
    if (!isNumber(one.torque_nm)) continue;
    const key = `${one.cycle}/${one.speed_fraction}`;
    if (!groups.has(key)) groups.set(key, { cycle: one.cycle, level: one.speed_fraction, speed: 0, minute: 0, torque: 0, count: 0 });
    const group = groups.get(key);
    group.speed += one.speed_rad_s;
    group.minute += one.minute;
    group.torque += Math.abs(one.torque_nm);
    group.count += 1;
  }
  return [...groups.values()].map((one) => ({ ...one, speed: one.speed / one.count, minute: one.minute / one.count, torque: one.torque / one.count }));
}

export function speedPlot(points, joint, owned) {
  const all = means(points);
  const cycles = [...new Set(all.map((one) => one.cycle))].sort((a, b) => a - b);
  const series = cycles.map((cycle, index) => {
    const of = all.filter((one) => one.cycle === cycle).sort((a, b) => a.speed - b.speed);
    return { label: t`cycle ${cycle}`, x: of.map((one) => one.speed), y: of.map((one) => one.torque), color: ramp(cycles.length < 2 ? 1 : index / (cycles.length - 1)), points: true, size: 5, width: 1.5 };
  });
  return plot({
    title: t`Friction over speed, joint ${joint}`, head: t`Joint ${joint}, friction in Nm over speed in rad/s`, xLabel: t`speed in rad/s`, yLabel: t`friction in Nm`, height: 240, zero: true,
    format: newton, formatTick: tick, formatX: (value) => `${fixed(value, 2)} rad/s`, series,
    legend: [{ ramp: true, label: t`cycle ${cycles[0]} (cold) to ${cycles.at(-1)} (hot)` }],
  }, owned);
}

function curve(fit, from, to) {
  const x = Array.from({ length: CURVE_POINTS }, (_, index) => from + (to - from) * index / (CURVE_POINTS - 1));
  return { x, y: x.map((t) => fit.a_nm + (fit.b_nm ?? 0) * (fit.t1_min ? Math.exp(-t / fit.t1_min) : 0) + (fit.c_nm ?? 0) * (fit.t2_min ? Math.exp(-t / fit.t2_min) : 0)) };
}

export function warmUpPlot(points, fits, joint, owned) {
  const all = means(points);
  const levels = [...new Set(all.map((one) => one.level))].sort((a, b) => a - b);
  const colors = ["--c1", "--c2", "--c3", "--c4", "--c5", "--c6", "--c7", "--c8"];
  const series = [];
  const legend = [];
  levels.forEach((level, index) => {
    const of = all.filter((one) => one.level === level).sort((a, b) => a.minute - b.minute);
    const color = colors[index % colors.length];
    series.push({ label: percent(level, 0), x: of.map((one) => one.minute), y: of.map((one) => one.torque), color, line: false, points: true, size: 6 });
    const fit = fits.find((one) => Math.abs(one.speed_fraction - level) < 1e-6);
    if (fit && isNumber(fit.a_nm)) {
      const from = fit.first_min ?? of[0].minute;
      const drawn = curve(fit, from, fit.last_min ?? of.at(-1).minute);
      series.push({ label: t`fit ${percent(level, 0)}`, ...drawn, color, dash: JOINT_DASHES[index % JOINT_DASHES.length], width: 1.5, derived: true, spanGaps: true });
    }
    legend.push({ label: t`${percent(level, 0)} of the largest speed`, color, dot: true, dash: JOINT_DASHES[index % JOINT_DASHES.length] });
  });
  return plot({
    title: t`Warm-up, joint ${joint}`, head: t`Joint ${joint}, friction in Nm over minutes since the start`, xLabel: t`minutes since the start`, yLabel: t`friction in Nm`, height: 240,
    format: newton, formatTick: tick, formatX: (value) => `${fixed(value, 1)} min`, series, legend,
  }, owned);
}
