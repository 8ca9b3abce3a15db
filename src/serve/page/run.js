import { view } from "./api.js";
import { cycleLink } from "./cycle.js";
import { h, table } from "./dom.js";
import { robotLink } from "./fleet.js";
import { count, digits, fixed, isNumber, moment, percent, unit } from "./format.js";
import { empty, part } from "./part.js";
import { JOINT_COLORS, JOINT_DASHES, plot } from "./plot.js";
import { badge } from "./status.js";
import { runStatus } from "./robot.js";

// Longer tables scroll inside their frame.
const ROWS_SHOWN = 80;
const STAGES = [["excitation", "Excitation"], ["friction", "Friction"], ["warming", "Warming"], ["all", "Whole cycle"]];

function fact(name, value, more) {
  return h("div", null, h("dt", null, name), h("dd", null, value, more ? h("small", null, more) : null));
}

const sentences = (one) => [one.reason, one.remarks].filter(Boolean).flatMap((text) => text.split("\n"));
// What is said of several cycles differs in its figures at most.
const plain = (text) => text.replace(/[\d.]+/g, "#");

/** What is said of every cycle, once. */
function saidOfAll(rows) {
  if (rows.length < 2) return [];
  const others = rows.slice(1).map((one) => new Set(sentences(one).map(plain)));
  return sentences(rows[0]).filter((text) => others.every((of) => of.has(plain(text))));
}

function cycleStatus(one) {
  const look = { complete: "ok", doubtful: "warning", refused: "critical" }[one.status] ?? "unknown";
  return badge(look, one.status);
}

export function mount({ main, argument, query, choose, title }) {
  const id = Number(argument);
  title(`Run ${argument}`);
  let stage = query.get("stage") ?? "excitation";
  let cycle = Number(query.get("cycle")) || null;
  let cycles = null;
  let asked = null;
  const row = () => (asked ??= view("runs", { run_id: id, limit: 1 }).then((answer) => answer.rows[0] ?? null));

  const top = part({
    className: "bare", load: row,
    draw: (one) => {
      if (!one) return [h("h1", { tabindex: -1 }, `There is no run ${argument}`), empty(h("p", null, h("a", { href: "#/ingest" }, "Show the latest runs")))];
      title(`Run ${id} of ${one.robot}`);
      return [
        h("p", { class: "crumb" }, h("a", { href: "#/", "data-key": "fleet" }, "Fleet"), " / ", h("a", { href: robotLink(one.robot), "data-key": "robot" }, one.robot), ` / run ${id}`),
        h("h1", { tabindex: -1 }, `Run ${id} of ${one.robot}`),
        h("p", { class: "head-line" }, runStatus(one), h("span", null, "started ", moment(one.started_at)), one.superseded_by_run_id ? h("a", { href: `#/run/${one.superseded_by_run_id}`, "data-key": "newer" }, `superseded by run ${one.superseded_by_run_id}`) : null),
        one.reason ? h("p", { class: "lead" }, one.reason) : null,
        one.status === "quarantined" ? h("p", null, h("a", { href: "#/ingest", "data-key": "quarantine" }, "Show it in quarantine")) : null,
      ];
    },
  });

  const figures = part({
    title: "Figures", load: row,
    draw: (one) => (one ? h("dl", { class: "facts" },
      fact("Cycles", count(one.cycles)), fact("Rows", count(one.rows), one.rows_skipped ? `${count(one.rows_skipped)} bad rows skipped` : null),
      fact("Sample rate", isNumber(one.sample_rate_hz) ? `${digits(one.sample_rate_hz, 4)} Hz` : "not known yet"), fact("Model", one.model || "not recognised"),
      fact("Kind", one.kind === "production" ? "production" : "test"), fact("Export", one.source_name)) : empty("No figures.")),
  });

  const stageSelect = h("select", { id: "stage", onchange: () => {
    stage = stageSelect.value;
    choose({ stage: stage === "excitation" ? null : stage });
    rmsd.again();
  } }, STAGES.map(([key, text]) => h("option", { value: key, selected: key === stage }, text)));
  const rmsd = part({
    title: "RMSD by cycle and joint", note: "Estimated against measured torque while the joint moves, as a share of the measured torque. Logarithmic axis, so that a cold first cycle does not squeeze the others.",
    tools: h("div", { class: "tools" }, h("label", { for: "stage" }, "Stage"), stageSelect),
    load: async (signal) => (await view("cycle_rmsd", { run_id: id, stage, verification: "self", order: "cycle", limit: 10000 }, signal)).rows,
    draw: (rows, owned) => {
      const known = rows.filter((one) => isNumber(one.moving_relative_rmsd) && one.moving_relative_rmsd > 0);
      if (!known.length) return empty("No RMSD of this stage. A cycle has it once it has parameters.");
      const joints = [...new Set(known.map((one) => one.joint))].sort((a, b) => a - b);
      return plot({
        title: "RMSD by cycle and joint", hideTitle: true, xLabel: "cycle", yLabel: "relative RMSD", log: true, whole: true, height: 280,
        format: (value) => percent(value, 2), formatTick: (value) => percent(value, value < 0.1 ? 1 : 0), formatX: (value) => `cycle ${value}`,
        series: joints.map((joint, index) => {
          const of = known.filter((one) => one.joint === joint);
          return { label: `joint ${joint}`, x: of.map((one) => one.cycle), y: of.map((one) => one.moving_relative_rmsd), color: JOINT_COLORS[index % 8], dash: JOINT_DASHES[index % 8], points: of.length < 60, size: 5 };
        }),
        legend: joints.map((joint, index) => ({ label: `joint ${joint}`, color: JOINT_COLORS[index % 8], dash: JOINT_DASHES[index % 8] })),
      }, owned);
    },
  });

  const list = part({
    title: "Cycles",
    load: async (signal) => (await view("cycles", { run_id: id, order: "cycle", limit: 10000 }, signal)).rows,
    draw: (rows) => {
      cycles = rows.filter((one) => one.status !== "refused").map((one) => one.cycle);
      fillCycles();
      if (!rows.length) return empty("No cycle is stored yet. A cycle is stored when the first row of the next one is written.");
      const shared = saidOfAll(rows);
      const known = new Set(shared.map(plain));
      const box = table({
        tall: rows.length > ROWS_SHOWN, caption: `Cycles of run ${id}`, rows,
        columns: [
          { title: "Cycle", cell: (one) => h("a", { href: cycleLink(id, one.cycle), "data-key": `cycle${one.cycle}` }, `cycle ${one.cycle}`) }, { title: "Status", cell: cycleStatus }, { title: "Started", cell: (one) => moment(one.started_at) },
          { title: "Duration", number: true, cell: (one) => (isNumber(one.duration_s) ? `${fixed(one.duration_s, 1)} s` : "–") },
          { title: "Rows", number: true, cell: (one) => count(one.rows) },
          { title: "Condition number, scaled", number: true, cell: (one) => digits(one.scaled_condition_number, 3) },
          { title: "Residual", number: true, cell: (one) => (isNumber(one.residual_std_nm) ? `${digits(one.residual_std_nm, 3)} Nm` : "–") },
          { title: "Reason and remarks", wide: true, cell: (one) => sentences(one).filter((text) => !known.has(plain(text))).map((text) => h("p", null, text)) },
        ],
      });
      return [...shared.map((text) => h("p", { class: "part-note" }, `All cycles, with the figures of the first: ${text}`)), box];
    },
  });

  const cycleSelect = h("select", { id: "cycle", onchange: () => {
    cycle = Number(cycleSelect.value);
    choose({ cycle });
    parameters.again();
  } });
  function fillCycles() {
    if (!cycles?.includes(cycle)) cycle = cycles?.at(-1) ?? null;
    const text = JSON.stringify(cycles);
    if (cycleSelect.dataset.options !== text) {
      cycleSelect.dataset.options = text;
      cycleSelect.replaceChildren(...(cycles ?? []).map((one) => h("option", { value: one }, `cycle ${one}`)));
    }
    cycleSelect.value = String(cycle ?? "");
  }
  const parameters = part({
    title: "Parameters of a cycle", note: "Base parameters with their 95 % intervals. A value whose interval holds zero is not determined by this motion.",
    tools: h("div", { class: "tools" }, h("label", { for: "cycle" }, "Cycle"), cycleSelect),
    load: async (signal) => (cycle ? (await view("cycle_parameters", { run_id: id, cycle, order: "joint", limit: 1000 }, signal)).rows : []),
    draw: (rows) => {
      if (!rows.length) return empty("This cycle has no parameters.");
      const places = (one) => digits(one.value, 4);
      return table({
        tall: rows.length > ROWS_SHOWN, caption: `Parameters of cycle ${cycle} of run ${id}`, rows,
        columns: [
          { title: "Parameter", cell: (one) => [`J${one.joint} `, h("b", null, one.parameter)] },
          { title: "Value", number: true, cell: places },
          { title: "Unit", cell: (one) => unit(one.unit) },
          { title: "95 % interval", number: true, cell: (one) => (isNumber(one.interval_low) ? `${digits(one.interval_low, 4)} to ${digits(one.interval_high, 4)}` : "not known") },
          { title: "Relative error", number: true, cell: (one) => (isNumber(one.relative_std_error) ? [percent(one.relative_std_error, 1), one.interval_low <= 0 && one.interval_high >= 0 ? h("span", { class: "tag" }, "holds zero") : null] : "–") },
          { title: "Stands for", wide: true, cell: (one) => one.grouping ?? "" },
        ],
      });
    },
  });

  const parts = [top, figures, rmsd, list, parameters];
  main.replaceChildren(...parts.map((one) => one.element));

  async function refresh() {
    asked = null;
    await Promise.all([top, figures, rmsd, list].map((one) => one.refresh()));
    await parameters.refresh();
  }
  return { refresh, destroy() { for (const one of parts) one.destroy(); } };
}
