import { get, view } from "./api.js";
import { h } from "./dom.js";
import { robotLink } from "./fleet.js";
import { digits, fixed, isNumber, percent, tick } from "./format.js";
import { lower, t, unbroken } from "./messages.js";
import { empty, part } from "./part.js";
import { plot } from "./plot.js";
import { statusName } from "./status.js";

const at = (value) => `${fixed(value, 2)} s`;

export const cycleLink = (run, cycle, joint) => `#/cycle/${run}/${cycle}${joint ? `?joint=${joint}` : ""}`;

/** Torques of one cycle: measured and estimated, their difference in a separate strip, and velocity. */
export function mount({ main, argument, query, choose, title }) {
  const [run, cycle] = argument.split("/").map(Number);
  let joint = Number(query.get("joint")) || 1;
  const name = t`Cycle ${cycle} of run ${run}`;
  title(name);
  // A stored cycle does not change, and its export is long: it is read once.
  let read = null;
  let asked = null;
  const cycles = () => (asked ??= view("cycles", { run_id: run, order: "cycle", limit: 10000 }).then((answer) => answer.rows));
  const stored = async () => (await cycles()).some((row) => row.cycle === cycle);
  const torques = async () => (await stored() ? ask() : { missing: t`The cycle is not stored.` });
  const ask = () => (read ??= get(`v1/runs/${run}/cycles/${cycle}/torque`).catch((error) => {
    if ([404, 410].includes(error.status)) return { missing: error.message };
    read = null;
    throw error;
  }));

  const top = part({
    className: "bare",
    load: cycles,
    draw: (rows) => {
      const one = rows.find((row) => row.cycle === cycle);
      if (!one) return [h("h1", { tabindex: -1 }, t`There is no cycle ${cycle} of run ${run}`), empty(h("p", null, h("a", { href: `#/run/${run}` }, t`Show run ${run}`)))];
      title(`${name}, ${one.robot}`);
      const place = rows.indexOf(one);
      const next = (row, text, key) => (row ? h("a", { href: cycleLink(run, row.cycle, joint), "data-key": key }, text) : null);
      return [
        h("p", { class: "crumb" }, h("a", { href: "#/", "data-key": "fleet" }, t`Fleet`), " / ", h("a", { href: robotLink(one.robot), "data-key": "robot" }, one.robot), " / ", h("a", { href: `#/run/${run}`, "data-key": "run" }, t`run ${run}`), " / ", t`cycle ${cycle}`),
        h("h1", { tabindex: -1 }, `${name}, ${one.robot}`),
        h("p", { class: "head-line" }, h("span", null, statusName(one.status)), isNumber(one.duration_s) ? h("span", null, `${fixed(one.duration_s, 1)} s`) : null,
          next(rows[place - 1], t`Cycle before`, "before"), next(rows[place + 1], t`Cycle after`, "after")),
        one.reason ? h("p", { class: "lead" }, unbroken(one.reason)) : null,
      ];
    },
  });

  const select = h("select", { id: "joint", onchange: () => {
    joint = Number(select.value);
    choose({ joint: joint === 1 ? null : joint });
    body.again();
  } });
  const body = part({
    title: t`Measured and estimated torque`,
    note: t`Read again from the export. The estimate is what the cycle's own parameters give for its motion; both went through the same low-pass. At rest a joint is held by friction of unknown sign, so the estimate is drawn only while it moves. Drag across a plot to look closer, double-click to see all.`,
    tools: h("div", { class: "tools" }, h("label", { for: "joint" }, t`Joint`), select),
    load: torques,
    draw: (data, owned) => {
      if (data.missing) {
        select.disabled = true;
        return empty(t`There are no torques to show.`, data.missing);
      }
      if (!data.joints.some((one) => one.joint === joint)) joint = data.joints[0].joint;
      select.replaceChildren(...data.joints.map((one) => h("option", { value: one.joint }, t`joint ${one.joint}`)));
      select.value = String(joint);
      const one = data.joints.find((of) => of.joint === joint);
      const x = one.time_s;
      const [force, unit, speed] = one.kind === "prismatic" ? [t`Force`, "N", "m/s"] : [t`Torque`, "Nm", "rad/s"];
      const torque = (value) => `${digits(value, 3)} ${unit}`;
      const common = { xLabel: t`s since the start of the recording`, formatX: at, formatTick: tick, sync: `cycle/${run}/${cycle}`, xRange: [x[0], x.at(-1)] };
      const analysed = data.stages.filter((stage) => stage.stage !== "between");
      const stages = analysed.filter((stage, index) => stage.stage !== analysed[index - 1]?.stage);
      const moving = (values) => values.map((value, index) => (one.moving[index] ? value : null));
      const shares = [
        isNumber(one.moving_rmsd_nm) ? t`RMSD while the joint moves ${torque(one.moving_rmsd_nm)}, ${percent(one.moving_relative_rmsd, 1)} of the measured ${lower(force)}` : t`no row in which the joint moves counts in verification`,
        isNumber(one.rmsd_nm) ? t`with the rows at rest ${torque(one.rmsd_nm)}` : null,
        t`low-pass ${digits(data.cutoff_hz, 3)} Hz`, data.source_name,
      ];
      return [
        h("p", { class: "part-note" }, shares.filter(Boolean).join("; ")),
        plot({
          ...common, title: t`${force}, joint ${joint}`, head: t`Joint ${joint}, ${lower(force)} in ${unit} over s`, yLabel: t`${lower(force)} in ${unit}`, height: 300, format: torque,
          marks: stages.slice(1).map((stage) => ({ x: stage.from_s, color: "--muted", dash: [4, 4] })),
          series: [
            { label: t`measured`, x, y: one.measured_nm, color: "--c1", width: 2.5 },
            { label: t`estimated`, x, y: moving(one.estimated_nm), color: "--c2", width: 1.25, dash: [6, 3] },
          ],
          legend: [{ label: t`measured`, color: "--c1" }, { label: t`estimated`, color: "--c2", dash: [6, 3] },
            stages.length > 1 ? { label: t`a stage begins: ${stages.map((stage) => t(stage.stage)).join(", ")}`, color: "--muted", dash: [4, 4], upright: true } : null].filter(Boolean),
        }, owned),
        plot({
          ...common, title: t`Residual, joint ${joint}`, head: t`Residual in ${unit}: measured less estimated`, yLabel: t`residual in ${unit}`, height: 180, format: torque, limits: [{ value: 0 }],
          series: [{ label: t`residual`, x, y: moving(one.residual_nm), color: "--c4", width: 1.25 }],
        }, owned),
        plot({
          ...common, title: t`Velocity, joint ${joint}`, head: t`Velocity in ${speed}`, yLabel: t`velocity in ${speed}`, height: 180, format: (value) => `${digits(value, 3)} ${speed}`, limits: [{ value: 0 }],
          series: [{ label: t`velocity`, x, y: one.velocity_rad_s, color: "--c3", width: 1.25 }],
        }, owned),
      ];
    },
  });

  const parts = [top, body];
  main.replaceChildren(...parts.map((one) => one.element));
  return {
    refresh: () => {
      asked = null;
      return Promise.all(parts.map((one) => one.refresh()));
    },
    destroy() { for (const one of parts) one.destroy(); },
  };
}
