import { get, view } from "./api.js";
import { h } from "./dom.js";
import { robotLink } from "./fleet.js";
import { digits, fixed, isNumber, percent } from "./format.js";
import { empty, part } from "./part.js";
import { plot } from "./plot.js";

const tick = (value) => digits(value, 3).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
const at = (value) => `${fixed(value, 2)} s`;

export const cycleLink = (run, cycle, joint) => `#/cycle/${run}/${cycle}${joint ? `?joint=${joint}` : ""}`;

/** Torques of one cycle: measured and estimated, their difference on a strip of its own, and velocity. */
export function mount({ main, argument, query, choose, title }) {
  const [run, cycle] = argument.split("/").map(Number);
  let joint = Number(query.get("joint")) || 1;
  const name = `Cycle ${cycle} of run ${run}`;
  title(name);
  // A stored cycle does not change, and its export is long: it is read once.
  let read = null;
  let asked = null;
  const cycles = () => (asked ??= view("cycles", { run_id: run, order: "cycle", limit: 10000 }).then((answer) => answer.rows));
  const stored = async () => (await cycles()).some((row) => row.cycle === cycle);
  const torques = async () => (await stored() ? ask() : { missing: "The cycle is not stored." });
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
      if (!one) return [h("h1", { tabindex: -1 }, `There is no cycle ${cycle} of run ${run}`), empty(h("p", null, h("a", { href: `#/run/${run}` }, `Show run ${run}`)))];
      title(`${name}, ${one.robot}`);
      const place = rows.indexOf(one);
      const next = (row, text, key) => (row ? h("a", { href: cycleLink(run, row.cycle, joint), "data-key": key }, text) : null);
      return [
        h("p", { class: "crumb" }, h("a", { href: "#/", "data-key": "fleet" }, "Fleet"), " / ", h("a", { href: robotLink(one.robot), "data-key": "robot" }, one.robot), " / ", h("a", { href: `#/run/${run}`, "data-key": "run" }, `run ${run}`), ` / cycle ${cycle}`),
        h("h1", { tabindex: -1 }, `${name}, ${one.robot}`),
        h("p", { class: "head-line" }, h("span", null, one.status), isNumber(one.duration_s) ? h("span", null, `${fixed(one.duration_s, 1)} s`) : null,
          next(rows[place - 1], "Cycle before", "before"), next(rows[place + 1], "Cycle after", "after")),
        one.reason ? h("p", { class: "lead" }, one.reason) : null,
      ];
    },
  });

  const select = h("select", { id: "joint", onchange: () => {
    joint = Number(select.value);
    choose({ joint: joint === 1 ? null : joint });
    body.again();
  } });
  const body = part({
    title: "Measured and estimated torque",
    note: "Read again from the export. The estimate is what the cycle's own parameters give for its motion; both went through the same low-pass. At rest a joint is held by friction of unknown sign, so the estimate is drawn only while it moves. Drag across a plot to look closer, double-click to see all.",
    tools: h("div", { class: "tools" }, h("label", { for: "joint" }, "Joint"), select),
    load: torques,
    draw: (data, owned) => {
      if (data.missing) {
        select.disabled = true;
        return empty("There are no torques to show.", data.missing);
      }
      if (!data.joints.some((one) => one.joint === joint)) joint = data.joints[0].joint;
      select.replaceChildren(...data.joints.map((one) => h("option", { value: one.joint }, `joint ${one.joint}`)));
      select.value = String(joint);
      const one = data.joints.find((of) => of.joint === joint);
      const x = one.time_s;
      const [force, unit, speed] = one.kind === "prismatic" ? ["Force", "N", "m/s"] : ["Torque", "Nm", "rad/s"];
      const torque = (value) => `${digits(value, 3)} ${unit}`;
      const common = { xLabel: "s since the start of the recording", formatX: at, formatTick: tick, sync: `cycle/${run}/${cycle}`, xRange: [x[0], x.at(-1)] };
      const analysed = data.stages.filter((stage) => stage.stage !== "between");
      const stages = analysed.filter((stage, index) => stage.stage !== analysed[index - 1]?.stage);
      const moving = (values) => values.map((value, index) => (one.moving[index] ? value : null));
      const shares = [
        isNumber(one.moving_rmsd_nm) ? `RMSD while the joint moves ${torque(one.moving_rmsd_nm)}, ${percent(one.moving_relative_rmsd, 1)} of the measured ${force.toLowerCase()}` : "no row in which the joint moves counts in verification",
        isNumber(one.rmsd_nm) ? `with the rows at rest ${torque(one.rmsd_nm)}` : null,
        `low-pass ${digits(data.cutoff_hz, 3)} Hz`, data.source_name,
      ];
      return [
        h("p", { class: "part-note" }, shares.filter(Boolean).join("; ")),
        plot({
          ...common, title: `${force}, joint ${joint}`, head: `Joint ${joint}, ${force.toLowerCase()} in ${unit} over s`, yLabel: `${force.toLowerCase()} in ${unit}`, height: 300, format: torque,
          marks: stages.slice(1).map((stage) => ({ x: stage.from_s, color: "--muted", dash: [4, 4] })),
          series: [
            { label: "measured", x, y: one.measured_nm, color: "--c1", width: 2.5 },
            { label: "estimated", x, y: moving(one.estimated_nm), color: "--c2", width: 1.25, dash: [6, 3] },
          ],
          legend: [{ label: "measured", color: "--c1" }, { label: "estimated", color: "--c2", dash: [6, 3] },
            stages.length > 1 ? { label: `a stage begins: ${stages.map((stage) => stage.stage).join(", ")}`, color: "--muted", dash: [4, 4], upright: true } : null].filter(Boolean),
        }, owned),
        plot({
          ...common, title: `Residual, joint ${joint}`, head: `Residual in ${unit}: measured less estimated`, yLabel: `residual in ${unit}`, height: 180, format: torque, limits: [{ value: 0 }],
          series: [{ label: "residual", x, y: moving(one.residual_nm), color: "--c4", width: 1.25 }],
        }, owned),
        plot({
          ...common, title: `Velocity, joint ${joint}`, head: `Velocity in ${speed}`, yLabel: `velocity in ${speed}`, height: 180, format: (value) => `${digits(value, 3)} ${speed}`, limits: [{ value: 0 }],
          series: [{ label: "velocity", x, y: one.velocity_rad_s, color: "--c3", width: 1.25 }],
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
