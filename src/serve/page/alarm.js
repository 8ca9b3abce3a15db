import { actionButton, assignButton, commentForm, possibleActions, whyNot, workButton } from "./actions.js";
import { fleet, view } from "./api.js";
import { h } from "./dom.js";
import { ago, isNumber, likelihood, moment, percent, sentence } from "./format.js";
import { overdueNote, robotLink } from "./fleet.js";
import { indexPlot, limitsOfAlarm, marksOf, smoothedOf } from "./index-plot.js";
import { lower, t } from "./messages.js";
import { empty, part } from "./part.js";
import { plot, seconds } from "./plot.js";
import { figure, findingOf, isFriction, limitAndScore, more, quantityName, stateText, whatToDo } from "./quantities.js";
import { badge, jointName, kindName, severityName } from "./status.js";

const EVENTS = {
  opened: t`Opened`, worse: t`Worse`, corrected: t`Corrected to another kind`, ended: t`Ended: later tests no longer show it`, reopened: t`Reopened`,
  withdrawn: t`Withdrawn`, unshelved: t`No longer shelved`, acknowledged: t`Acknowledged`, shelved: t`Shelved`, maintenance: t`Work entered: in maintenance`,
  commented: t`Comment`, assigned: t`Assigned`, resolved: t`Resolved`, false_alarm: t`Marked as a false alarm`, overdue: t`Overdue`,
};

function fact(name, value, more) {
  return h("div", null, h("dt", null, name), h("dd", null, value, more ? h("small", null, more) : null));
}

function alternatives(one) {
  try {
    const list = JSON.parse(one.alternatives ?? "[]");
    return Array.isArray(list) ? list : [];
  } catch {
    return [];
  }
}

export function mount({ main, argument, title }) {
  const id = Number(argument);
  title(t`Alarm ${argument}`);
  let joints = [];
  let people = [];
  let asked = null;
  // One request for all parts of the page.
  const row = () => (asked ??= view("anomalies", { anomaly_id: id, limit: 1 }).then((answer) => answer.rows[0] ?? null));
  const refresh = () => {
    asked = null;
    return Promise.all(parts.map((one) => one.refresh()));
  };
  const soon = () => { refresh().catch(() => {}); };

  const top = part({
    className: "bare",
    load: async (signal) => {
      const one = await row();
      const [health, known] = await Promise.all([one ? view("fleet_health", { robot: one.robot, order: "joint" }, signal).then((answer) => answer.rows) : [], peopleOf(signal)]);
      joints = health.map((of) => of.joint);
      people = known;
      return { one, overdue: health[0]?.expected_by };
    },
    draw: ({ one, overdue }) => {
      if (!one) return [h("h1", { tabindex: -1 }, t`There is no alarm ${argument}`), empty(t`It was withdrawn, or the number is wrong.`, h("p", null, h("a", { href: "#/" }, t`Show the fleet`)))];
      title(`${one.robot} ${jointName(one.joint)}: ${kindName(one.kind)}`);
      const onset = one.onset_at ?? one.first_seen_at;
      return [
        h("p", { class: "crumb" }, h("a", { href: "#/", "data-key": "fleet" }, t`Fleet`), " / ", h("a", { href: robotLink(one.robot, one.joint), "data-key": "robot" }, one.robot), " / ", t`alarm ${one.anomaly_id}`),
        h("h1", { tabindex: -1 }, `${one.robot}, ${jointName(one.joint)}: ${lower(kindName(one.kind))}`),
        h("p", { class: "head-line" }, badge(one.severity), h("span", null, t`State: ${h("b", null, stateText(one))}`),
          h("span", null, t`since ${moment(onset)}`, h("span", { class: "muted" }, ` ${ago(onset)}`)),
          one.assignee ? h("span", null, t`Assigned to ${h("b", null, one.assignee)}`) : null,
          one.ended ? h("span", { class: "muted" }, t`Later tests no longer show it.`) : null,
          one.provisional ? h("span", { class: "muted" }, t`The test that shows it is still being written.`) : null, overdueNote(overdue)),
        h("p", { class: "lead" }, findingOf(one), "."),
        h("p", { class: "lead" }, whatToDo(one)),
        more(one).map((text) => h("p", { class: "muted" }, text)),
        h("div", { class: "actions", role: "group", "aria-label": t`Actions` },
          possibleActions(one).map((name) => actionButton(name, one, soon)),
          one.ended || one.state === "false_alarm" ? null : workButton(one, joints, soon), assignButton(one, people, soon)),
        whyNot(),
      ];
    },
  });

  const figures = part({
    title: t`Figures`, load: row,
    draw: (one) => {
      if (!one) return empty(t`No figures.`);
      const [limit, score] = limitAndScore(one);
      return h("dl", { class: "facts" },
        fact(t`Latest value`, figure(one, one.value), quantityName(one.quantity, one.kind)), fact(t`Baseline`, figure(one, one.baseline).replace(/ \([^()]*%\)$/, "")),
        fact(t`Most extreme value`, figure(one, one.peak_value)), fact(t`Limit`, limit, score),
        fact(t`Onset`, one.onset_at ? moment(one.onset_at) : t`not known`, one.onset_cycle ? t`cycle ${one.onset_cycle} of this test` : null),
        fact(t`First test that shows it`, moment(one.first_seen_at), one.run_id ? h("a", { href: `#/run/${one.run_id}` }, t`run ${one.run_id}`) : null),
        fact(t`Latest test that shows it`, moment(one.last_seen_at), one.last_run_id ? h("a", { href: `#/run/${one.last_run_id}` }, t`run ${one.last_run_id}`) : null));
    },
  });

  const evidence = part({
    title: t`Evidence`,
    load: async (signal) => {
      const one = await row();
      if (!one) return { one };
      const shown = one.quantity.includes("rmsd") && one.joint !== null ? "rmsd" : "index";
      const joint = one.joint ?? null;
      const [robots, works, rows] = await Promise.all([
        shown === "index" ? fleet(signal).catch(() => null) : null,
        view("maintenance_log", { robot: one.robot }, signal),
        shown === "rmsd" ? view("cycle_rmsd", { robot: one.robot, joint, stage: "excitation", verification: "self", order: "-run_id", limit: 10000 }, signal)
          : joint === null ? null : view("friction_index", { robot: one.robot, joint, order: "-started_at", limit: 10000 }, signal).then((answer) => ({ rows: answer.rows.reverse() })),
      ]);
      const runs = shown === "rmsd" ? (await view("runs", { robot: one.robot, kind: "test", limit: 10000 }, signal)).rows.map((run) => [run.run_id, run.started_at]) : null;
      return { one, shown, limits: robots?.limits, works: works.rows, rows: rows?.rows ?? [], runs };
    },
    draw: ({ one, shown, limits, works, rows, runs }, owned) => {
      if (!one) return empty(t`No evidence.`);
      const marks = marksOf([{ ...one, severity: "warning", onset_at: one.onset_at ?? one.first_seen_at }], works, one.joint);
      if (shown === "rmsd" && rows.length) return rmsdPlot(rows, new Map(runs), marks, one, owned);
      if (one.joint === null) return empty(t`This anomaly concerns the whole arm, so that no single joint's curve shows it.`, h("p", null, h("a", { href: robotLink(one.robot), "data-key": "all" }, t`Show all joints of ${one.robot}`)));
      const drawn = limitsOfAlarm({ limits }, one);
      return [
        isFriction(one.quantity) ? null
          : h("p", { class: "part-note" }, t`The alarm is about the ${quantityName(one.quantity, one.kind)}. The curve is the friction index of the joint, for comparison.`),
        indexPlot({ rows, joint: one.joint, limits: drawn, marks, smoothed: smoothedOf(one), title: `${one.robot} ${jointName(one.joint)}`, height: 280 }, owned),
        drawn.length ? h("p", { class: "part-note" }, t`The limit is that of the index smoothed over the tests; points are single tests.`) : null,
      ];
    },
  });

  const causes = part({
    title: t`Hypotheses`, load: row,
    draw: (one) => {
      if (!one) return empty(t`No hypotheses.`);
      const others = alternatives(one);
      if (!isNumber(one.odds) && !others.length) return h("p", { class: "muted" }, t`Other causes were not compared.`);
      return h("ol", { class: "causes" },
        h("li", null, h("b", null, `${kindName(one.kind)}, ${jointName(one.joint)}`), h("span", null, t`${likelihood(one.odds)}, against all others together`)),
        others.map((other) => h("li", null, h("span", null, sentence(String(other.cause ?? ""))), h("span", { class: "muted" }, likelihood(other.odds)))));
    },
  });

  const comment = commentForm({ anomaly_id: id }, soon);
  const history = part({
    title: t`History`,
    load: async (signal) => ({ rows: (await view("anomaly_history", { anomaly_id: id, order: "-anomaly_event_id" }, signal)).rows, one: await row() }),
    // Only the end of the present shelving is stored.
    draw: ({ rows, one: now }) => [rows.length ? h("ol", { class: "log" }, rows.map((one) => h("li", null, h("span", { class: "muted" }, moment(one.at)),
      h("div", null, h("p", null, h("b", null, EVENTS[one.what] ?? one.what), now?.state === "shelved" && one === rows.find((of) => of.what === "shelved") ? [" ", t`until ${moment(now.shelved_until)}`] : null,
        one.who ? [" ", t`by ${one.who}`] : null, ` \u2013 ${severityName(one.severity)}`),
        said(one))))) : empty(t`No events: the anomaly had ended when it was found.`), comment],
  });

  const parts = [top, figures, evidence, causes, history];
  main.replaceChildren(top.element, evidence.element, figures.element, h("div", { class: "columns" }, causes.element, history.element));
  return { refresh, destroy() { for (const one of parts) one.destroy(); } };
}

/** What a person wrote with an event. */
function said(one) {
  if (one.what === "assigned") return h("p", { class: "muted" }, one.why ? t`to ${one.why}` : t`to nobody`);
  return one.why ? h("p", { class: one.what === "commented" ? null : "muted" }, `“${one.why}”`) : null;
}

/** Persons that have answered an alarm or have one, the latest first. */
export async function peopleOf(signal) {
  const { rows } = await view("anomaly_history", { order: "-anomaly_event_id", limit: 500 }, signal);
  return [...new Set(rows.flatMap((one) => [one.who, one.what === "assigned" ? one.why : null]).filter(Boolean))].slice(0, 8);
}

function rmsdPlot(rows, runs, marks, one, owned) {
  const by = new Map();
  for (const row of rows) {
    if (!isNumber(row.moving_relative_rmsd) || !runs.has(row.run_id)) continue;
    if (!by.has(row.run_id)) by.set(row.run_id, []);
    by.get(row.run_id).push(row.moving_relative_rmsd);
  }
  const points = [...by].map(([run, values]) => ({ x: seconds(runs.get(run)), values: values.sort((a, b) => a - b) })).sort((a, b) => a.x - b.x);
  const limits = one.quantity === "moving_relative_rmsd" && one.kind === "accuracy" && isNumber(one.threshold) ? [{ value: one.threshold, color: "--warning-icon", dash: [6, 4] }] : [];
  const at = (kind) => marks.filter((mark) => mark.kind === kind).map((mark) => mark.x);
  return plot({
    title: t`Relative RMSD, ${jointName(one.joint)}`, time: true, xLabel: t`time`, yLabel: t`relative RMSD`, log: true, height: 280, format: (value) => percent(value, 2),
    formatTick: (value) => percent(value, value < 0.01 ? 1 : 0), boundsLabel: t`Range of the cycles`, marks,
    limits,
    series: [{ label: t`median of the cycles`, x: points.map((p) => p.x), y: points.map((p) => p.values[Math.floor(p.values.length / 2)]), low: points.map((p) => p.values[0]), high: points.map((p) => p.values.at(-1)), color: "--plot", points: points.length < 90, size: 5 }],
    legend: [{ label: t`median of the cycles, with their range`, color: "--plot" }, ...limits.map((limit) => ({ label: t`limit of the alarm`, color: limit.color, dash: [4, 2] })),
      { label: t`onset of an alarm`, color: "--critical", upright: true, at: at("onset") }, { label: t`maintenance`, color: "--plot-mark", upright: true, dash: [2, 1.5], at: at("maintenance") }],
  }, owned);
}
