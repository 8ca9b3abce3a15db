import { view } from "./api.js";
import { cycleLink } from "./cycle.js";
import { h, table } from "./dom.js";
import { robotLink } from "./fleet.js";
import { count, digits, fixed, isNumber, moment, percent, unit } from "./format.js";
import { t, unbroken } from "./messages.js";
import { empty, part } from "./part.js";
import { JOINT_COLORS, JOINT_DASHES, plot } from "./plot.js";
import { badge, statusName } from "./status.js";
import { runStatus } from "./robot.js";

// Tables with more rows scroll inside their frame.
const ROWS_SHOWN = 80;
const STAGES = [["excitation", t`Excitation`], ["friction", t`Friction`], ["warming", t`Warming`], ["all", t`Whole cycle`]];

function fact(name, value, more) {
  return h("div", null, h("dt", null, name), h("dd", null, value, more ? h("small", null, more) : null));
}

const sentences = (one) => [one.reason, one.remarks].filter(Boolean).flatMap((text) => unbroken(text).split("\n"));
// Equal remarks on several cycles differ only in their numbers.
const plain = (text) => text.replace(/[\d.]+/g, "#");

/** Remarks that all cycles share, once each. */
function saidOfAll(rows) {
  if (rows.length < 2) return [];
  const others = rows.slice(1).map((one) => new Set(sentences(one).map(plain)));
  return sentences(rows[0]).filter((text) => others.every((of) => of.has(plain(text))));
}

function cycleStatus(one) {
  const look = { complete: "ok", doubtful: "warning", refused: "critical" }[one.status] ?? "unknown";
  return badge(look, statusName(one.status));
}

export function mount({ main, argument, query, choose, title }) {
  const id = Number(argument);
  title(t`Run ${argument}`);
  let stage = query.get("stage") ?? "excitation";
  let cycle = Number(query.get("cycle")) || null;
  let cycles = null;
  let asked = null;
  const row = () => (asked ??= view("runs", { run_id: id, limit: 1 }).then((answer) => answer.rows[0] ?? null));

  const top = part({
    className: "bare", load: row,
    draw: (one) => {
      if (!one) return [h("h1", { tabindex: -1 }, t`There is no run ${argument}`), empty(h("p", null, h("a", { href: "#/ingest" }, t`Show the latest runs`)))];
      title(t`Run ${id} of ${one.robot}`);
      return [
        h("p", { class: "crumb" }, h("a", { href: "#/", "data-key": "fleet" }, t`Fleet`), " / ", h("a", { href: robotLink(one.robot), "data-key": "robot" }, one.robot), " / ", t`run ${id}`),
        h("h1", { tabindex: -1 }, t`Run ${id} of ${one.robot}`),
        h("p", { class: "head-line" }, runStatus(one), h("span", null, t`started ${moment(one.started_at)}`), one.superseded_by_run_id ? h("a", { href: `#/run/${one.superseded_by_run_id}`, "data-key": "newer" }, t`superseded by run ${one.superseded_by_run_id}`) : null),
        one.reason ? h("p", { class: "lead" }, unbroken(one.reason)) : null,
        one.status === "quarantined" ? h("p", null, h("a", { href: "#/ingest", "data-key": "quarantine" }, t`Show it in quarantine`)) : null,
      ];
    },
  });

  const figures = part({
    title: t`Figures`, load: row,
    draw: (one) => (one ? h("dl", { class: "facts" },
      fact(t`Cycles`, count(one.cycles)), fact(t`Rows`, count(one.rows), one.rows_skipped ? t`${count(one.rows_skipped)} bad rows skipped` : null),
      fact(t`Sample rate`, isNumber(one.sample_rate_hz) ? `${digits(one.sample_rate_hz, 4)} Hz` : t`not known yet`), fact(t`Model`, one.model || t`not recognised`),
      fact(t`Kind`, one.kind === "production" ? t`production` : t`test`), fact(t`Export`, one.source_name)) : empty(t`No figures.`)),
  });

  const stageSelect = h("select", { id: "stage", onchange: () => {
    stage = stageSelect.value;
    choose({ stage: stage === "excitation" ? null : stage });
    rmsd.again();
  } }, STAGES.map(([key, text]) => h("option", { value: key, selected: key === stage }, text)));
  const rmsd = part({
    title: t`RMSD by cycle and joint`, note: t`Estimated against measured torque while the joint moves, as a share of the measured torque. Logarithmic axis, so that a cold first cycle does not squeeze the others.`,
    tools: h("div", { class: "tools" }, h("label", { for: "stage" }, t`Stage`), stageSelect),
    load: async (signal) => (await view("cycle_rmsd", { run_id: id, stage, verification: "self", order: "cycle", limit: 10000 }, signal)).rows,
    draw: (rows, owned) => {
      const known = rows.filter((one) => isNumber(one.moving_relative_rmsd) && one.moving_relative_rmsd > 0);
      if (!known.length) return empty(t`No RMSD of this stage. A cycle has it once it has parameters.`);
      const joints = [...new Set(known.map((one) => one.joint))].sort((a, b) => a - b);
      return plot({
        title: t`RMSD by cycle and joint`, hideTitle: true, xLabel: t`Cycle`, yLabel: t`relative RMSD`, log: true, whole: true, height: 280,
        format: (value) => percent(value, 2), formatTick: (value) => percent(value, value < 0.1 ? 1 : 0), formatX: (value) => t`cycle ${value}`,
        series: joints.map((joint, index) => {
          const of = known.filter((one) => one.joint === joint);
          return { label: t`joint ${joint}`, x: of.map((one) => one.cycle), y: of.map((one) => one.moving_relative_rmsd), color: JOINT_COLORS[index % 8], dash: JOINT_DASHES[index % 8], points: of.length < 60, size: 5 };
        }),
        legend: joints.map((joint, index) => ({ label: t`joint ${joint}`, color: JOINT_COLORS[index % 8], dash: JOINT_DASHES[index % 8] })),
      }, owned);
    },
  });

  const list = part({
    title: t`Cycles`,
    load: async (signal) => (await view("cycles", { run_id: id, order: "cycle", limit: 10000 }, signal)).rows,
    draw: (rows) => {
      cycles = rows.filter((one) => one.status !== "refused").map((one) => one.cycle);
      fillCycles();
      if (!rows.length) return empty(t`No cycle is stored yet. A cycle is stored when the first row of the next one is written.`);
      const shared = saidOfAll(rows);
      const known = new Set(shared.map(plain));
      const box = table({
        tall: rows.length > ROWS_SHOWN, caption: t`Cycles of run ${id}`, rows,
        columns: [
          { title: t`Cycle`, cell: (one) => h("a", { href: cycleLink(id, one.cycle), "data-key": `cycle${one.cycle}` }, t`cycle ${one.cycle}`) }, { title: t`Status`, cell: cycleStatus }, { title: t`Started`, cell: (one) => moment(one.started_at) },
          { title: t`Duration`, number: true, cell: (one) => (isNumber(one.duration_s) ? `${fixed(one.duration_s, 1)} s` : "–") },
          { title: t`Rows`, number: true, cell: (one) => count(one.rows) },
          { title: t`Condition number, scaled`, number: true, cell: (one) => digits(one.scaled_condition_number, 3) },
          { title: t`Residual`, number: true, cell: (one) => (isNumber(one.residual_std_nm) ? `${digits(one.residual_std_nm, 3)} Nm` : "–") },
          { title: t`Reason and remarks`, wide: true, cell: (one) => sentences(one).filter((text) => !known.has(plain(text))).map((text) => h("p", null, text)) },
        ],
      });
      return [...shared.map((text) => h("p", { class: "part-note" }, t`All cycles, with the figures of the first: ${text}`)), box];
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
      cycleSelect.replaceChildren(...(cycles ?? []).map((one) => h("option", { value: one }, t`cycle ${one}`)));
    }
    cycleSelect.value = String(cycle ?? "");
  }
  const parameters = part({
    title: t`Parameters of a cycle`, note: t`Base parameters with their 95 % intervals. A value whose interval holds zero is not determined by this motion.`,
    tools: h("div", { class: "tools" }, h("label", { for: "cycle" }, t`Cycle`), cycleSelect),
    load: async (signal) => (cycle ? (await view("cycle_parameters", { run_id: id, cycle, order: "joint", limit: 1000 }, signal)).rows : []),
    draw: (rows) => {
      if (!rows.length) return empty(t`This cycle has no parameters.`);
      const places = (one) => digits(one.value, 4);
      return table({
        tall: rows.length > ROWS_SHOWN, caption: t`Parameters of cycle ${cycle} of run ${id}`, rows,
        columns: [
          { title: t`Parameter`, cell: (one) => [`J${one.joint} `, h("b", null, one.parameter)] },
          { title: t`Value`, number: true, cell: places },
          { title: t`Unit`, cell: (one) => unit(one.unit) },
          { title: t`95 % interval`, number: true, cell: (one) => (isNumber(one.interval_low) ? t`${digits(one.interval_low, 4)} to ${digits(one.interval_high, 4)}` : t`not known`) },
          { title: t`Relative error`, number: true, cell: (one) => (isNumber(one.relative_std_error) ? [percent(one.relative_std_error, 1), one.interval_low <= 0 && one.interval_high >= 0 ? h("span", { class: "tag" }, t`holds zero`) : null] : "–") },
          { title: t`Stands for`, wide: true, cell: (one) => one.grouping ?? "" },
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
