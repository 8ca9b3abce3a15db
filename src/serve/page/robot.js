import { cancelWindowButton, deleteButton, editButton, maintenanceForm, windowButton } from "./actions.js";
import { fleet as readFleet, get, view } from "./api.js";
import { h, icon, replace, table } from "./dom.js";
import { alarmRow, alarmsOf, jointCell, overdueNote, robotLink, staleSince } from "./fleet.js";
import { ago, change, count, digits, isNumber, moment, percent, plural, sentence, tick, unit, withoutJoint } from "./format.js";
import { commonRange, indexPlot, legendOf, limitsOf, marksOf } from "./index-plot.js";
import { t } from "./messages.js";
import { empty, part } from "./part.js";
import { inside, legend, plot, seconds } from "./plot.js";
import { worstAlarmFirst } from "./quantities.js";
import { speedPlot, warmUpPlot } from "./friction-plots.js";
import { sparkRange } from "./spark.js";
import { badge, jointName, known, rank } from "./status.js";

const RUNS_SHOWN = 20;
const TWINS = 40;
// Parts with many rows are not read again with every cycle of a running test.
const SLOW_MS = 15_000;

const by = (rows, key) => {
  const groups = new Map();
  for (const row of rows) {
    if (!groups.has(row[key])) groups.set(row[key], []);
    groups.get(row[key]).push(row);
  }
  return groups;
};

function fill(node, options, value) {
  const text = JSON.stringify(options);
  if (node.dataset.options !== text) {
    node.dataset.options = text;
    node.replaceChildren(...options.map(([key, name]) => h("option", { value: key }, name)));
  }
  node.value = String(value ?? "");
}

export function mount({ main, argument: robot, query, choose, title }) {
  title(robot);
  let joint = Number(query.get("joint")) || null;
  // The joint that a link or a person named. Without one, the page shows the worst joint.
  let named = joint;
  let run = Number(query.get("run")) || null;
  let own = query.get("scale") === "own";
  let parameter = query.get("parameter") ?? "f1";
  let allRuns = false;
  let whole = null;
  let asked = null;
  let gone = false;
  let ready;
  // Parts of one joint wait until the page knows which joint and run they show.
  const chosen = new Promise((resolve) => { ready = resolve; });

  const fleet = () => (asked ??= readFleet());
  const jointsOf = () => whole?.joints.map((one) => one.joint) ?? [];
  let inAlarm = [];
  let work = null;
  /** Where work was done, as far as the page can tell: the named joint, or the only place in alarm. */
  const placeOfWork = () => (jointsOf().includes(named) ? named : inAlarm.length === 1 ? inAlarm[0] : undefined);

  const head = h("div");
  let headText = null;
  function drawHead(data) {
    whole = data.robots.find((one) => one.robot === robot) ?? null;
    const stale = whole && staleSince(whole, Date.now());
    const text = JSON.stringify([whole, alarmsOf(data.anomalies, robot), Math.floor(Date.now() / 60_000)]);
    if (text === headText) return;
    headText = text;
    const crumb = h("p", { class: "crumb" }, h("a", { href: "#/", "data-key": "fleet" }, t`Fleet`), ` / ${robot}`);
    if (!whole) {
      replace(head, crumb, h("h1", { tabindex: -1 }, robot), empty(h("p", null, t`This robot has no complete test. Its runs and exports are below, if there are any.`), h("p", null, h("a", { href: "#/ingest", "data-key": "ingest" }, t`Show exports and quarantine`))));
      return;
    }
    if (!joint || !jointsOf().includes(joint)) joint = [...whole.joints].sort((a, b) => rank(a.status) - rank(b.status) || a.joint - b.joint)[0]?.joint ?? null;
    const worst = whole.joints.filter((one) => one.status === whole.status);
    const reasons = by(worst.filter((one) => one.reason), "reason");
    replace(head, crumb, h("h1", { tabindex: -1 }, robot),
      h("p", { class: "head-line" }, badge(whole.status), stale ? h("b", { class: "late" }, t`stale since ${moment(stale, "day")}`) : null, h("span", null, t`Model ${whole.model || t`not recognised`}`),
        h("span", null, t`last test ${moment(whole.last_run_at)}`, h("span", { class: "muted" }, ` ${ago(whole.last_run_at)}`)),
        stale ? null : overdueNote(whole.expected_by)),
      [...reasons].map(([reason, joints]) => h("p", { class: "lead" }, joints.length === whole.joints.length ? t`All joints:` : joints.length > 1 ? t`Joints ${joints.map((one) => one.joint).join(", ")}:` : t`Joint ${joints[0].joint}:`, " ", withoutJoint(reason, jointName(joints[0].joint)), ".")),
      whole.joints.filter((one) => one.warning_by || one.critical_by).map((one) => h("p", { class: "lead" }, t`Joint ${one.joint}: friction is ${one.trend ? t(one.trend) : t`changing`}.`, " ",
        one.warning_by ? [t`A warning is expected by ${moment(one.warning_by, "day")}.`, " "] : null, one.critical_by ? [t`The critical limit is expected by ${moment(one.critical_by, "day")}.`] : null)),
      h("nav", { class: "cells joints", "aria-label": t`Joints` }, whole.joints.map((one) => {
        const cell = jointCell(robot, one, sparkRange([whole]), alarmsOf(data.anomalies, robot));
        if (one.joint === joint) cell.setAttribute("aria-current", "true");
        cell.addEventListener("click", (event) => {
          event.preventDefault();
          setJoint(one.joint);
          showTab("engineering");
        });
        return cell;
      })));
  }

  const soon = () => { refresh().catch(() => {}); };

  const jointSelect = h("select", { id: "joint", onchange: () => setJoint(Number(jointSelect.value)) });
  const runSelect = h("select", { id: "run", onchange: () => {
    run = Number(runSelect.value);
    choose({ run });
    frictionSpeed.again();
    warmUp.again();
  } });
  const detailHead = h("div", { class: "detail-head" }, h("h2", { id: "detail" }, t`One joint`),
    h("div", { class: "tools" }, h("span", { class: "pair" }, h("label", { for: "joint" }, t`Joint`), jointSelect), h("span", { class: "pair" }, h("label", { for: "run" }, t`Run`), runSelect)));

  function setJoint(next) {
    joint = next;
    named = next;
    work?.suggestPlace();
    choose({ joint });
    fill(jointSelect, jointsOf().map((one) => [one, t`Joint ${one}`]), joint);
    for (const cell of head.querySelectorAll(".cell")) {
      if (cell.dataset.key === `${robot}/${joint}`) cell.setAttribute("aria-current", "true");
      else cell.removeAttribute("aria-current");
    }
    for (const one of ofJoint) one.again();
  }

  const alarms = part({
    title: t`Alarms`, className: "flush",
    load: async (signal) => (await view("anomalies", { robot, order: "-last_seen_at", limit: 200 }, signal)).rows,
    draw: (rows) => {
      const active = rows.filter((one) => !["resolved", "false_alarm"].includes(one.state)).sort(worstAlarmFirst);
      const closed = rows.filter((one) => !active.includes(one));
      return [
        active.length ? h("ol", { class: "alarms" }, active.map((one) => alarmRow(one))) : h("p", { class: "calm" }, icon("ok"), t`No open alarm.`),
        closed.length ? h("details", { class: "more", "data-key": "closed" }, h("summary", { "data-key": "closed-summary" }, plural(closed.length, "earlier alarm")), h("ol", { class: "alarms" }, closed.map((one) => alarmRow(one)))) : null,
      ];
    },
  });

  const scale = h("input", { type: "checkbox", id: "scale", onchange: () => {
    own = scale.checked;
    choose({ scale: own ? "own" : null });
    index.again();
  } });
  scale.checked = own;
  const index = part({
    title: t`Friction index over time`, note: t`Friction of each test against the joint's own baseline, at equal speed and temperature. The band is the 95 % interval.`,
    tools: h("div", { class: "tools" }, h("label", { class: "check" }, scale, t`A scale of its own for each joint`)),
    load: async (signal) => {
      const [rows, anomalies, works, data] = await Promise.all([
        view("friction_index", { robot, order: "-started_at", limit: 10000 }, signal), view("anomalies", { robot, limit: 500 }, signal),
        view("maintenance_log", { robot, limit: 500 }, signal), fleet()]);
      return { rows: rows.rows.reverse(), truncated: rows.truncated, anomalies: anomalies.rows, works: works.rows, limits: data.limits,
        joints: data.robots.find((one) => one.robot === robot)?.joints.map((one) => [one.joint, one.status, one.friction_index]) ?? [] };
    },
    draw: ({ rows, truncated, anomalies, works, limits, joints }, owned) => {
      if (!rows.length) return empty(t`No friction index yet. A joint needs a baseline of full tests first, five by default. Until then the status is “learning”.`);
      const groups = by(rows, "joint");
      const lines = (one) => limitsOf({ limits }, anomalies, one);
      const anyLimit = [...groups.keys()].some((one) => lines(one).length);
      const range = own ? null : commonRange(rows, [...groups.keys()].flatMap(lines));
      const times = rows.map((row) => seconds(row.started_at));
      const pad = (Math.max(...times) - Math.min(...times) || 86400) * 0.03;
      const xRange = [Math.min(...times) - pad, Math.max(...times) + pad];
      const state = new Map(joints.map((one) => [one[0], one]));
      return [
        h("div", { class: "plots" }, [...groups].sort((a, b) => a[0] - b[0]).map(([number, of]) => {
          const [, status, value] = state.get(number) ?? [];
          return indexPlot({
            rows: of, joint: number, limits: lines(number), marks: marksOf(anomalies, works, number), range, xRange, title: t`Joint ${number}`, sync: `index/${robot}`, height: 184, plain: true,
            head: [h("span", null, t`Joint ${number}`), status ? badge(known(status)) : null, h("span", { class: "muted" }, change(value))],
          }, owned);
        })),
        legend(inside(legendOf([...groups.keys()].flatMap(lines), [...groups.keys()].flatMap((one) => marksOf(anomalies, works, one))), xRange)),
        limits ? null : h("p", { class: "part-note" }, anyLimit ? t`A limit is drawn where an alarm states it. The daemon does not state the limits of the other joints.` : t`No limit is drawn: the daemon does not state the limits of these joints.`),
        truncated ? h("p", { class: "part-note" }, t`The history is longer than 10 000 points; the latest of them are shown.`) : null,
      ];
    },
  });

  const frictionSpeed = part({
    title: t`Friction over speed`, level: 3, note: t`Mean of both directions, of the chosen run; cycles from cold to hot.`, lazy: true,
    load: async (signal) => {
      await chosen;
      return joint && run ? { joint, rows: (await view("friction_points", { run_id: run, joint, limit: 10000 }, signal)).rows } : null;
    },
    draw: (data, owned) => (data?.rows.length ? speedPlot(data.rows, data.joint, owned) : empty(t`This run has no friction points of the joint. They come from the friction stage of a test.`)),
  });

  const warmUp = part({
    title: t`Friction over time of a run`, level: 3, note: t`Points at each speed level, and the fitted warm-up curve a + b exp(−t/t₁) + c exp(−t/t₂).`, lazy: true,
    load: async (signal) => {
      await chosen;
      if (!joint || !run) return null;
      const [points, fits] = await Promise.all([view("friction_points", { run_id: run, joint, limit: 10000 }, signal), view("warmup_fits", { run_id: run, joint }, signal)]);
      return { joint, points: points.rows, fits: fits.rows };
    },
    draw: (data, owned) => (data?.points.length ? warmUpPlot(data.points, data.fits, data.joint, owned) : empty(t`This run has no friction points of the joint.`)),
  });

  const runTimes = async (signal) => (await view("runs", { robot, kind: "test", order: "-started_at", limit: 10000 }, signal)).rows;

  const rmsd = part({
    title: t`RMSD over runs`, level: 3, note: t`Relative RMSD of the excitation stage while the joint moves: median of a run's cycles, and their range. Logarithmic axis.`, lazy: true, quiet: SLOW_MS,
    load: async (signal) => {
      await chosen;
      if (!joint) return null;
      const [rows, all] = await Promise.all([view("cycle_rmsd", { robot, joint, stage: "excitation", verification: "self", order: "-run_id", limit: 10000 }, signal), runTimes(signal)]);
      const times = new Map(all.filter((one) => one.status === "complete").map((one) => [one.run_id, one.started_at]));
      return [...by(rows.rows.filter((one) => isNumber(one.moving_relative_rmsd) && times.has(one.run_id)), "run_id")].map(([id, of]) => {
        const values = of.map((one) => one.moving_relative_rmsd).sort((a, b) => a - b);
        return [times.get(id), values[Math.floor(values.length / 2)], values[0], values.at(-1), id];
      }).sort((a, b) => a[0].localeCompare(b[0]));
    },
    draw: (rows, owned) => (rows?.length ? plot({
      title: t`RMSD over runs`, hideTitle: true, time: true, xLabel: t`time`, yLabel: t`relative RMSD`, boundsLabel: t`Range of the cycles`, log: true, height: 240,
      format: (value) => percent(value, 2), formatTick: (value) => percent(value, value < 0.01 ? 1 : value < 0.03 ? 1 : 0),
      series: [{ label: t`median`, x: rows.map((one) => seconds(one[0])), y: rows.map((one) => one[1]), low: rows.map((one) => one[2]), high: rows.map((one) => one[3]), color: "--plot", points: rows.length < 90, size: 5 }],
      legend: [{ label: t`median of a run's cycles, with their range`, color: "--plot" }],
    }, owned) : empty(t`No RMSD yet. It comes with the first cycle that gives parameters.`)),
  });

  const parameterSelect = h("select", { id: "parameter", onchange: () => {
    parameter = parameterSelect.value;
    choose({ parameter });
    parameters.again();
  } });
  const parameters = part({
    title: t`Parameters over runs`, level: 3, note: t`The last cycle of each run, with its 95 % interval.`, lazy: true, quiet: SLOW_MS,
    tools: h("div", { class: "tools" }, h("label", { for: "parameter" }, t`Parameter`), parameterSelect),
    load: async (signal) => {
      await chosen;
      if (!joint) return null;
      const all = (await runTimes(signal)).filter((one) => one.status === "complete");
      if (!all.length) return null;
      const names = [...new Set((await view("parameter_statistics", { run_id: all[0].run_id, joint, window: "all" }, signal)).rows.map((one) => one.parameter))].sort();
      const shown = names.includes(parameter) ? parameter : names[0];
      if (!shown) return null;
      const { rows } = await view("cycle_parameters", { robot, joint, parameter: shown, order: "-run_id", limit: 10000 }, signal);
      const times = new Map(all.map((one) => [one.run_id, one.started_at]));
      const last = [...by(rows.filter((one) => times.has(one.run_id)), "run_id")].map(([id, of]) => ({ at: times.get(id), row: of.reduce((a, b) => (b.cycle > a.cycle ? b : a)) }));
      return { names, shown, last: last.sort((a, b) => a.at.localeCompare(b.at)) };
    },
    draw: (data, owned) => {
      fill(parameterSelect, data?.names.map((one) => [one, one]) ?? [], data?.shown);
      if (!data?.last.length) return empty(t`No parameters of this joint yet.`);
      const { row } = data.last.at(-1);
      return [
        plot({
          title: t`${data.shown} in ${unit(row.unit)}`, time: true, xLabel: t`time`, yLabel: t`${data.shown} in ${unit(row.unit)}`, boundsLabel: t`95 % interval`, height: 224,
          format: (value) => `${digits(value, 4)} ${unit(row.unit)}`, formatTick: tick,
          series: [{ label: data.shown, x: data.last.map((one) => seconds(one.at)), y: data.last.map((one) => one.row.value), low: data.last.map((one) => one.row.interval_low), high: data.last.map((one) => one.row.interval_high), color: "--plot", points: true, size: 5, width: 1 }],
          legend: [{ label: t`value, with its 95 % interval`, color: "--plot", dot: true }],
        }, owned),
        row.grouping && row.grouping !== data.shown ? h("p", { class: "part-note" }, t`Stands for ${row.grouping}.`) : null,
      ];
    },
  });

  const twins = part({
    title: t`Against other arms of the model`, level: 3, note: t`Friction index of the same joint of the other arms, in grey.`, lazy: true, quiet: SLOW_MS,
    load: async (signal) => {
      await chosen;
      if (!joint) return null;
      const data = await fleet();
      const model = data.robots.find((one) => one.robot === robot)?.model;
      const same = new Set(data.robots.filter((one) => model && one.model === model && one.robot !== robot).map((one) => one.robot));
      const [mine, all] = await Promise.all([view("friction_index", { robot, joint, order: "started_at", limit: 10000 }, signal),
        same.size ? view("friction_index", { joint, order: "-started_at", limit: 10000 }, signal) : { rows: [] }]);
      const others = [...by(all.rows.filter((one) => same.has(one.robot) && isNumber(one.friction_index)), "robot")].slice(0, TWINS)
        .map(([name, rows]) => ({ label: name, x: rows.map((one) => seconds(one.started_at)).reverse(), y: rows.map((one) => one.friction_index).reverse() }));
      return { joint, mine: mine.rows, others, of: same.size, model };
    },
    draw: (data, owned) => {
      if (!data?.mine.length) return empty(t`No friction index of this joint yet.`);
      if (!data.others.length) return empty(t`No other arm of the model ${data.model || t`of this robot`} has a friction index of this joint.`);
      const values = data.others.flatMap((one) => one.y.map((y) => ({ friction_index: y })));
      return [indexPlot({ rows: data.mine, joint: data.joint, others: data.others, range: commonRange([...data.mine, ...values]), title: robot, head: t`Joint ${data.joint}`, height: 240 }, owned),
        data.others.length < data.of ? h("p", { class: "part-note" }, t`${data.others.length} of ${data.of} other arms are shown, those with the latest tests.`) : null];
    },
  });

  const runs = part({
    title: t`Runs`,
    load: async (signal) => (await view("runs", { robot, order: "-started_at", limit: 500 }, signal)).rows,
    draw: (rows) => {
      const tests = rows.filter((one) => one.kind === "test" && (one.status === "complete" || one.status === "streaming"));
      if (!tests.some((one) => one.run_id === run)) run = (tests.find((one) => one.status === "complete") ?? tests[0])?.run_id ?? null;
      fill(runSelect, tests.map((one) => [one.run_id, t`${one.started_at.slice(0, 10)}, run ${one.run_id}`]), run);
      const ended = tests.filter((one) => one.status === "complete").map((one) => [one.run_id, t`${one.started_at.slice(0, 10)}, run ${one.run_id}`]);
      fill(emptySelect, ended, emptySelect.value || ended.at(-1)?.[0]);
      fill(loadedSelect, ended, loadedSelect.value || ended[0]?.[0]);
      if (!rows.length) return empty(t`No run of this robot. Copy an export of a test into a watched folder.`);
      const shown = allRuns ? rows : rows.slice(0, RUNS_SHOWN);
      return [runTable(shown, t`Runs of ${robot}`), rows.length > RUNS_SHOWN ? h("button", { type: "button", class: "quiet", "data-key": "all-runs", onclick: () => {
        allRuns = !allRuns;
        runs.again();
      } }, allRuns ? t`Show the latest ${RUNS_SHOWN}` : t`Show all ${rows.length} runs`) : null];
    },
  });

  const works = part({
    title: t`Maintenance`,
    load: async (signal) => {
      const [done, planned] = await Promise.all([view("maintenance_log", { robot, order: "-at", limit: 500 }, signal), view("maintenance_windows", { robot, order: "-until_at", limit: 100 }, signal)]);
      return { rows: done.rows, planned: planned.rows.filter((one) => Date.parse(one.until_at) > Date.now()) };
    },
    draw: ({ rows, planned }) => [
      h("div", { class: "actions" }, windowButton(robot, jointsOf(), soon)),
      planned.length ? [h("h3", null, t`Planned`), h("ol", { class: "log" }, planned.map((one) => h("li", null, h("span", { class: "muted" }, t`${moment(one.from_at)} to ${moment(one.until_at)}`),
        h("div", null, h("p", null, h("b", null, sentence(one.what))), h("p", { class: "muted" }, jointName(one.joint), one.who ? `, ${one.who}` : null)), cancelWindowButton(one, soon))))] : null,
      (rows.length ? h("ol", { class: "log" }, rows.map((one) => h("li", null, h("span", { class: "muted" }, moment(one.at)),
      h("div", null, h("p", null, h("b", null, sentence(one.what))), h("p", { class: "muted" }, jointName(one.joint), one.who ? `, ${one.who}` : null)), h("div", { class: "pair" }, editButton(one, jointsOf(), soon), deleteButton(one, soon)))))
      : h("p", { class: "muted" }, t`No work is entered. From work on, a joint is compared with its tests after it.`))],
  });
  const workForm = h("section", { class: "part", "aria-labelledby": "enter-work" }, h("div", { class: "part-head" }, h("h2", { id: "enter-work" }, t`Enter work done`)), h("div", null));

  const emptySelect = h("select", { id: "payload-empty" });
  const loadedSelect = h("select", { id: "payload-loaded" });
  const payloadResult = h("div", { role: "status" });
  async function showPayload() {
    replace(payloadResult, h("p", { class: "muted" }, t`Reading the cycles of both tests.`));
    try {
      const found = await get(`v1/payload?${new URLSearchParams({ empty: emptySelect.value, loaded: loadedSelect.value })}`);
      const number = (value) => (value === null ? t`not shown` : digits(value, 4));
      replace(payloadResult, table({ caption: t`Payload of ${robot}`, rows: found.quantities, columns: [
        { title: t`Quantity`, cell: (one) => one.quantity },
        { title: t`Value`, number: true, cell: (one) => number(one.value) },
        { title: t`95 % from`, number: true, cell: (one) => number(one.interval_low) },
        { title: t`95 % to`, number: true, cell: (one) => number(one.interval_high) },
      ] }), h("p", { class: "part-note" }, t`Drive gains may be off by up to ${Math.round(100 * found.gain_uncertainty)} %.`));
    } catch (error) {
      replace(payloadResult, h("p", { class: "late" }, sentence(error.message)));
    }
  }
  const payloadPart = h("section", { class: "part", "aria-labelledby": "payload" }, h("div", { class: "part-head" }, h("h2", { id: "payload" }, t`Payload`),
    h("div", { class: "tools" }, h("span", { class: "pair" }, h("label", { for: "payload-empty" }, t`Without`), emptySelect), h("span", { class: "pair" }, h("label", { for: "payload-loaded" }, t`With`), loadedSelect),
      h("button", { type: "button", "data-key": "payload", onclick: showPayload }, t`Compare`))), payloadResult);

  const ofJoint = [frictionSpeed, warmUp, rmsd, parameters, twins];
  const parts = [alarms, index, runs, works, ...ofJoint];
  const sections = {
    now: [t`Now`, [alarms.element, index.element]],
    runs: [t`Runs and maintenance`, [runs.element, h("div", { class: "columns" }, works.element, workForm), payloadPart]],
    engineering: [t`Engineering`, [detailHead, h("div", { class: "columns" }, frictionSpeed.element, warmUp.element, twins.element, rmsd.element, parameters.element)]],
  };
  const bodies = new Map(Object.entries(sections).map(([name, [, content]]) => [name, h("div", null, content)]));
  const tabs = h("nav", { class: "tabs", "aria-label": t`Parts of this page` }, Object.entries(sections).map(([name, [text]]) => h("a", {
    href: `#/robot/${encodeURIComponent(robot)}?tab=${name}`, "data-tab": name, onclick: (event) => {
      event.preventDefault();
      showTab(name);
    },
  }, text)));

  function showTab(name) {
    const shown = sections[name] ? name : "now";
    choose({ tab: shown === "now" ? null : shown });
    for (const [key, node] of bodies) node.hidden = key !== shown;
    for (const link of tabs.children) {
      if (link.dataset.tab === shown) link.setAttribute("aria-current", "page");
      else link.removeAttribute("aria-current");
    }
  }
  showTab(query.get("tab") ?? (joint ? "engineering" : "now"));
  main.replaceChildren(head, tabs, ...bodies.values());

  async function refresh() {
    asked = null;
    try {
      const data = await fleet();
      if (gone) return;
      drawHead(data);
      fill(jointSelect, jointsOf().map((one) => [one, t`Joint ${one}`]), joint);
      inAlarm = [...new Set(alarmsOf(data.anomalies, robot).map((one) => one.joint))];
      if (whole && !workForm.querySelector("form")) {
        work = maintenanceForm(robot, jointsOf(), placeOfWork, soon);
        workForm.lastChild.replaceWith(work.node);
      }
      work?.suggestPlace();
    } catch (error) {
      if (!head.firstChild) replace(head, h("h1", { tabindex: -1 }, robot));
      if (error.status !== 0 && error.status !== 401) throw error;
    }
    // The run that plots show follows from the list of runs.
    await runs.refresh();
    ready();
    await Promise.all(parts.filter((one) => one !== runs).map((one) => one.refresh()));
  }

  return { refresh, destroy() { gone = true; for (const one of parts) one.destroy(); } };
}

/** Runs as a table; also used by the page of exports. */
export function runTable(rows, caption, withRobot = false) {
  const columns = [
    { title: t`Run`, cell: (one) => h("a", { href: `#/run/${one.run_id}`, "data-key": `run/${one.run_id}` }, t`run ${one.run_id}`) },
    withRobot ? { title: t`Robot`, cell: (one) => h("a", { href: robotLink(one.robot), "data-key": `of/${one.run_id}` }, one.robot) } : null,
    { title: t`Started`, cell: (one) => moment(one.started_at) },
    { title: t`Status`, cell: (one) => runStatus(one) },
    { title: t`Cycles`, number: true, cell: (one) => count(one.cycles) },
    { title: t`Rows`, number: true, cell: (one) => count(one.rows) },
    { title: t`Export`, wide: true, cell: (one) => one.source_name },
  ].filter(Boolean);
  return table({ caption, columns, rows });
}

export function runStatus(one) {
  const [look, word] = { complete: ["ok", t`complete`], streaming: ["live", t`being read`], quarantined: ["critical", t`in quarantine`], superseded: ["unknown", t`superseded`], set_aside: ["unknown", t`set aside`] }[one.status] ?? ["unknown", one.status];
  return h("span", { class: `badge s-${look}` }, icon(look), word, one.kind === "production" ? h("span", { class: "tag" }, t`production`) : null);
}
