import { actionButton, possibleActions, whyNot, workButton } from "./actions.js";
import { get, view } from "./api.js";
import { h } from "./dom.js";
import { ago, clauses, finding, isNumber, likelihood, moment, percent, sentence } from "./format.js";
import { robotLink } from "./fleet.js";
import { indexPlot, limitsOf, marksOf } from "./index-plot.js";
import { empty, part } from "./part.js";
import { plot, seconds } from "./plot.js";
import { figure, isFriction, limitAndScore, quantityName } from "./quantities.js";
import { badge, jointName, kindName, stateName } from "./status.js";

const EVENTS = {
  opened: "Opened", worse: "Worse", corrected: "Corrected to another kind", ended: "Ended: later tests no longer show it", reopened: "Reopened",
  withdrawn: "Withdrawn", unshelved: "No longer shelved", acknowledged: "Acknowledged", shelved: "Shelved", maintenance: "Work entered: in maintenance",
  resolved: "Resolved", false_alarm: "Marked as a false alarm", overdue: "Overdue",
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
  title(`Alarm ${argument}`);
  let joints = [];
  let anomaly = null;
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
      if (one && one.robot !== anomaly?.robot) joints = (await view("fleet_health", { robot: one.robot, order: "joint" }, signal)).rows.map((of) => of.joint);
      anomaly = one;
      return one;
    },
    draw: (one) => {
      if (!one) return [h("h1", { tabindex: -1 }, `There is no alarm ${argument}`), empty("It was withdrawn, or the number is wrong.", h("p", null, h("a", { href: "#/" }, "Show the fleet")))];
      title(`${one.robot} ${jointName(one.joint)}: ${kindName(one.kind)}`);
      const onset = one.onset_at ?? one.first_seen_at;
      return [
        h("p", { class: "crumb" }, h("a", { href: "#/", "data-key": "fleet" }, "Fleet"), " / ", h("a", { href: robotLink(one.robot, one.joint), "data-key": "robot" }, one.robot), ` / alarm ${one.anomaly_id}`),
        h("h1", { tabindex: -1 }, `${one.robot}, ${jointName(one.joint)}: ${kindName(one.kind).toLowerCase()}`),
        h("p", { class: "head-line" }, badge(one.severity), h("span", null, "State: ", h("b", null, stateName(one.state)), one.state === "shelved" && one.shelved_until ? [" until ", moment(one.shelved_until)] : null),
          h("span", null, "since ", moment(onset), h("span", { class: "muted" }, ` ${ago(onset)}`)),
          one.ended ? h("span", { class: "muted" }, "Later tests no longer show it.") : null,
          one.provisional ? h("span", { class: "muted" }, "The test that shows it is still being written.") : null),
        h("p", { class: "lead" }, finding(one.message), "."),
        more(one.message).map((text) => h("p", { class: "muted" }, text)),
        h("div", { class: "actions", role: "group", "aria-label": "Actions" },
          possibleActions(one).map((name) => actionButton(name, one, soon)),
          one.ended || one.state === "false_alarm" ? null : workButton(one, joints, soon)),
        whyNot(),
      ];
    },
  });

  const figures = part({
    title: "Figures", load: row,
    draw: (one) => {
      if (!one) return empty("No figures.");
      const [limit, score] = limitAndScore(one);
      return h("dl", { class: "facts" },
        fact("Latest value", figure(one, one.value), quantityName(one.quantity, one.kind)), fact("Baseline", figure(one, one.baseline).replace(/ \([^()]*%\)$/, "")),
        fact("Most extreme value", figure(one, one.peak_value)), fact("Limit", limit, score),
        fact("Onset", one.onset_at ? moment(one.onset_at) : "not known", one.onset_cycle ? `cycle ${one.onset_cycle} of this test` : null),
        fact("First test that shows it", moment(one.first_seen_at), one.run_id ? h("a", { href: `#/run/${one.run_id}` }, `run ${one.run_id}`) : null),
        fact("Latest test that shows it", moment(one.last_seen_at), one.last_run_id ? h("a", { href: `#/run/${one.last_run_id}` }, `run ${one.last_run_id}`) : null));
    },
  });

  const evidence = part({
    title: "Evidence",
    load: async (signal) => {
      const one = await row();
      if (!one) return { one };
      const shown = one.quantity.includes("rmsd") && one.joint !== null ? "rmsd" : "index";
      const joint = one.joint ?? null;
      const [fleet, works, rows] = await Promise.all([
        shown === "index" ? get("v1/fleet", signal).catch(() => null) : null,
        view("maintenance_log", { robot: one.robot }, signal),
        shown === "rmsd" ? view("cycle_rmsd", { robot: one.robot, joint, stage: "excitation", verification: "self", order: "-run_id", limit: 10000 }, signal)
          : joint === null ? null : view("friction_index", { robot: one.robot, joint, order: "-started_at", limit: 10000 }, signal).then((answer) => ({ rows: answer.rows.reverse() })),
      ]);
      const runs = shown === "rmsd" ? (await view("runs", { robot: one.robot, kind: "test", limit: 10000 }, signal)).rows.map((run) => [run.run_id, run.started_at]) : null;
      return { one, shown, limits: fleet?.limits, works: works.rows, rows: rows?.rows ?? [], runs };
    },
    draw: ({ one, shown, limits, works, rows, runs }, owned) => {
      if (!one) return empty("No evidence.");
      const marks = marksOf([{ ...one, severity: "warning", onset_at: one.onset_at ?? one.first_seen_at }], works, one.joint);
      if (shown === "rmsd" && rows.length) return rmsdPlot(rows, new Map(runs), marks, one, owned);
      if (one.joint === null) return empty("This anomaly concerns the whole arm, so that no single joint's curve shows it.", h("p", null, h("a", { href: robotLink(one.robot), "data-key": "all" }, `Show all joints of ${one.robot}`)));
      const drawn = limitsOf({ limits }, [one], one.joint);
      return [
        isFriction(one.quantity) ? null
          : h("p", { class: "part-note" }, `The alarm is about the ${quantityName(one.quantity, one.kind)}. The curve is the friction index of the joint, for comparison.`),
        indexPlot({ rows, joint: one.joint, limits: drawn, marks, title: `${one.robot} ${jointName(one.joint)}`, height: 280 }, owned),
        drawn.length ? h("p", { class: "part-note" }, "The limit is that of the index smoothed over the tests; points are single tests.") : null,
      ];
    },
  });

  const causes = part({
    title: "Hypotheses", load: row,
    draw: (one) => {
      if (!one) return empty("No hypotheses.");
      const others = alternatives(one);
      if (!isNumber(one.odds) && !others.length) return h("p", { class: "muted" }, "Other causes were not compared.");
      return h("ol", { class: "causes" },
        h("li", null, h("b", null, `${kindName(one.kind)}, ${jointName(one.joint)}`), h("span", null, `${likelihood(one.odds)}, against all others together`)),
        others.map((other) => h("li", null, h("span", null, sentence(String(other.cause ?? ""))), h("span", { class: "muted" }, likelihood(other.odds)))));
    },
  });

  const history = part({
    title: "History", load: async (signal) => (await view("anomaly_history", { anomaly_id: id, order: "-anomaly_event_id" }, signal)).rows,
    draw: (rows) => (rows.length ? h("ol", { class: "log" }, rows.map((one) => h("li", null, h("span", { class: "muted" }, moment(one.at)),
      h("div", null, h("p", null, h("b", null, EVENTS[one.what] ?? one.what), one.who ? ` by ${one.who}` : null, ` \u2013 ${one.severity}`),
        one.why ? h("p", { class: "muted" }, `“${one.why}”`) : null)))) : empty("No events: the anomaly had ended when it was found.")),
  });

  const parts = [top, figures, evidence, causes, history];
  main.replaceChildren(top.element, evidence.element, figures.element, h("div", { class: "columns" }, causes.element, history.element));
  return { refresh, destroy() { for (const one of parts) one.destroy(); } };
}

/** What follows the finding in its message: figures and advice. */
function more(message) {
  return clauses(message).slice(1).map((text) => `${sentence(text)}.`);
}

function rmsdPlot(rows, runs, marks, one, owned) {
  const by = new Map();
  for (const row of rows) {
    if (!isNumber(row.moving_relative_rmsd) || !runs.has(row.run_id)) continue;
    if (!by.has(row.run_id)) by.set(row.run_id, []);
    by.get(row.run_id).push(row.moving_relative_rmsd);
  }
  const points = [...by].map(([run, values]) => ({ x: seconds(runs.get(run)), values: values.sort((a, b) => a - b) })).sort((a, b) => a.x - b.x);
  return plot({
    title: `Relative RMSD, ${jointName(one.joint)}`, time: true, xLabel: "time", yLabel: "relative RMSD", log: true, height: 280, format: (value) => percent(value, 2),
    formatTick: (value) => percent(value, value < 0.01 ? 1 : 0), boundsLabel: "Range of the cycles", marks,
    limits: one.quantity === "moving_relative_rmsd" && one.kind === "accuracy" && isNumber(one.threshold) ? [{ value: one.threshold, color: "--warning-icon" }] : [],
    series: [{ label: "median of the cycles", x: points.map((p) => p.x), y: points.map((p) => p.values[Math.floor(p.values.length / 2)]), low: points.map((p) => p.values[0]), high: points.map((p) => p.values.at(-1)), color: "--plot", points: points.length < 90, size: 5 }],
    legend: [{ label: "median of the cycles, with their range", color: "--plot" }, { label: "onset of an alarm", color: "--critical", upright: true }],
  }, owned);
}
