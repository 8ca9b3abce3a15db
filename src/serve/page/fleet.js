import { fleet } from "./api.js";
import { announce, h, hidden, icon, replace } from "./dom.js";
import { ago, change, count, moment, plural } from "./format.js";
import { t } from "./messages.js";
import { empty, failed, loading } from "./part.js";
import { spark, sparkRange } from "./spark.js";
import { badge, jointName, kindName, kindWord, known, rank, stateName, STATUSES, statusName } from "./status.js";
import { findingOf, isFriction, stateText, whatToDo, worstAlarmFirst } from "./quantities.js";

const FIRST_ALARMS = 6;
// Rows that a first screen shows; the others are made when the browser has painted them.
const AT_ONCE = 6;
const CHUNK = 24;
const idle = globalThis.requestIdleCallback ? (work) => requestIdleCallback(work, { timeout: 100 }) : (work) => setTimeout(work, 20);
// Browsers need not lay out far rows of a long list.
const MANY = 40;
const names = new Intl.Collator("en", { numeric: true });
/** The order of robots: by status, then as the worst open alarm of each. */
export function worstFirst(anomalies) {
  const alarms = anomalies.filter(isAlarm).sort((a, b) => (b.state === "open") - (a.state === "open") || worstAlarmFirst(a, b)).map((one) => one.robot);
  const place = new Map(alarms.map((robot) => [robot, alarms.indexOf(robot)]));
  const at = (one) => place.get(one.robot) ?? alarms.length;
  return (a, b) => rank(a.status) - rank(b.status) || at(a) - at(b) || furthest(b) - furthest(a) || names.compare(a.robot, b.robot);
}
const ORDERS = {
  worst: [t`Worst first`, worstFirst],
  name: [t`Name`, () => (a, b) => names.compare(a.robot, b.robot)],
  test: [t`Longest without a test`, () => (a, b) => (a.last_run_at ?? "").localeCompare(b.last_run_at ?? "") || names.compare(a.robot, b.robot)],
};

function furthest(robot) {
  return Math.max(0, ...robot.joints.map((one) => Math.abs((one.friction_index ?? 1) - 1)));
}

export const robotLink = (robot, joint) => `#/robot/${encodeURIComponent(robot)}${joint ? `?joint=${joint}` : ""}`;

const isAlarm = (one) => one.severity !== "info";

/** The alarms of a robot that are not settled, worst first. */
export const alarmsOf = (anomalies, robot) => anomalies.filter((one) => one.robot === robot && isAlarm(one)).sort(worstAlarmFirst);

/** Since when a robot has been overdue for a test without its status saying so; null while it is not. */
export const staleSince = (robot, now) => (robot.status !== "overdue" && robot.expected_by && Date.parse(robot.expected_by) < now ? robot.expected_by : null);

/** When the next test is overdue, or since when. */
export function overdueNote(by) {
  if (!by) return null;
  return Date.parse(by) < Date.now() ? h("span", { class: "late" }, t`overdue since ${moment(by, "day")}`) : h("span", { class: "muted" }, t`next test overdue after ${moment(by, "day")}`);
}

/** How a joint looks: its status, the number or the word that explains it, and who deals with it. */
export function jointLook(joint, alarms) {
  const own = alarms.filter((one) => one.joint === joint.joint);
  const inAlarm = ["critical", "warning"].includes(joint.status);
  // An alarm of the whole arm is one mark on the arm, not one on each joint.
  const ofArm = inAlarm && !own.length && alarms.some((one) => one.joint === null);
  const answered = inAlarm && own.length && own.every((one) => one.state !== "open") ? stateName(own[0].state) : null;
  const index = change(joint.friction_index);
  const cause = inAlarm && own.length && !isFriction(own[0].quantity) ? kindWord(own[0].kind) : null;
  return { status: ofArm ? "arm" : known(joint.status), word: ofArm ? t`alarm of the whole arm` : statusName(joint.status), value: cause ?? index, index, answered };
}

/** A joint at a glance, as a link to its figures. */
export function jointCell(robot, joint, range, alarms = []) {
  const { status, word, value, index, answered } = jointLook(joint, alarms);
  const words = [`${jointName(joint.joint)}: ${word}`, joint.friction_index === null ? t`no friction index` : t`friction index ${index}`, answered, joint.reason].filter(Boolean);
  const cell = h("a", {
    class: `cell s-${status}`, href: robotLink(robot, joint.joint), title: words.join("\n"), "data-key": `${robot}/${joint.joint}`,
  }, h("span", { class: "cell-head" }, status === "arm" ? null : icon(status), h("span", { class: "cell-joint" }, `J${joint.joint}`),
    status === "ok" || status === "arm" ? hidden(`, ${word}, `) : h("span", { class: "cell-word" }, hidden(", "), word, hidden(", "))),
  h("span", { class: "cell-value" }, value));
  cell.append(spark(joint.history, range));
  if (answered) cell.append(h("span", { class: "cell-mark" }, answered));
  return cell;
}

export function alarmRow(one, now) {
  const onset = one.onset_at ?? one.first_seen_at;
  return h("li", { class: "alarm-row" },
    h("a", { class: "row-link", href: `#/alarm/${one.anomaly_id}`, "data-key": `alarm${one.anomaly_id}` },
      h("span", { class: "alarm-severity" }, badge(one.severity)),
      h("span", { class: "alarm-where" }, h("b", null, one.robot), h("span", null, ` ${jointName(one.joint)}`)),
      h("span", { class: "alarm-text" }, findingOf(one),
        one.state === "open" ? null : h("span", { class: "tag" }, stateText(one, "day")),
        one.provisional ? h("span", { class: "tag" }, t`test still being written`) : null,
        one.state === "open" ? whatToDo(one, { class: "alarm-advice" }) : null),
      h("span", { class: "alarm-since" }, t`since ${moment(onset, "day")}`, h("span", { class: "muted" }, ` ${ago(onset, now)}`))));
}

function robotRow(robot, range, now, alarms) {
  const stale = staleSince(robot, now);
  const arm = alarms.filter((one) => one.joint === null);
  const late = robot.joints.some((one) => one.status === "overdue") || robot.status === "overdue";
  const test = robot.last_run_at
    ? h("p", null, t`Last test ${moment(robot.last_run_at, "day")}`, h("span", { class: "muted" }, `, ${ago(robot.last_run_at, now)}`))
    : h("p", null, t`No complete test yet`);
  return h("li", { class: stale ? "robot-row is-stale" : "robot-row" },
    h("div", { class: "robot-head" },
      h("h3", null, h("a", { href: robotLink(robot.robot), "data-key": `robot/${robot.robot}` }, robot.robot)),
      h("p", { class: "robot-status" }, badge(robot.status), h("span", { class: "muted" }, robot.model || t`model not recognised`),
        stale ? h("b", { class: "late" }, t`stale since ${moment(stale, "day")}`) : null,
        arm.map((one) => badge(one.severity, `${t`${kindName(one.kind)} of the whole arm`}${one.state === "open" ? "" : `, ${stateName(one.state)}`}`)),
        robot.open_alarms ? h("span", null, plural(robot.open_alarms, "open alarm")) : null,
        robot.open_infos ? h("span", { class: "muted" }, t`${count(robot.open_infos)} worth knowing`) : null),
      test,
      late && !stale ? h("p", { class: "late" }, t`overdue since ${moment(robot.expected_by, "day")}`) : null),
    robot.joints.length
      ? h("div", { class: "cells" }, robot.joints.map((joint) => jointCell(robot.robot, joint, range, alarms)))
      : h("p", { class: "muted" }, t`No joint has a figure yet. The first complete test gives them.`));
}

/** Where an export is to be copied. */
export function watchedNote({ watched }) {
  const folders = watched.map((one, index) => [index ? ", " : "", h("code", null, one)]);
  return h("p", null, watched.length > 1 ? t`Copy an export of a test into one of the watched folders: ${folders}.` : t`Copy an export of a test into the watched folder: ${folders}.`);
}

/** How to see the program without a robot. */
export const demoNote = () => h("p", null, t`${h("code", null, "armwatch demo")} shows the program with made-up robots.`);

export function mount({ main, query, choose, title }) {
  title(t`Fleet`);
  let data = null;
  let gone = false;
  let status = query.get("status") ?? "";
  let words = query.get("search") ?? "";
  let order = ORDERS[query.get("order")] ? query.get("order") : "worst";
  let allAlarms = false;
  let pending = 0;
  const rows = new Map();
  const drawn = new Map();
  // A part that says the same is left alone, so that nothing moves under a finger or the focus.
  const differs = (name, ...what) => {
    const text = JSON.stringify(what);
    if (drawn.get(name) === text) return false;
    drawn.set(name, text);
    return true;
  };

  // only a page without robots loads this module
  let drop = null;
  function dropped() {
    if (drop) return drop;
    drop = h("div");
    import("./upload.js").then(({ dropPlace }) => replace(drop, dropPlace(refresh))).catch(() => {});
    return drop;
  }

  const totals = h("dl", { class: "totals" });
  const alarms = h("div");
  const live = h("div");
  const chips = h("div", { class: "chips", role: "group", "aria-label": t`Show robots of a status` });
  const found = h("p", { class: "muted found", role: "status" });
  const list = h("ul", { class: "robots" });
  const search = h("input", { id: "search", type: "search", value: words, placeholder: t`Name or model`, oninput: () => {
    words = search.value;
    choose({ search: words });
    drawRobots();
  } });
  const sort = h("select", { id: "order", onchange: () => {
    order = sort.value;
    choose({ order: order === "worst" ? null : order });
    drawRobots();
  } }, Object.entries(ORDERS).map(([key, [text]]) => h("option", { value: key, selected: key === order }, text)));
  const body = h("div", null, loading());
  const content = [
    h("div", { class: "fleet-head" }, h("h1", { tabindex: -1 }, t`Fleet`), totals),
    alarms, live,
    h("section", { class: "part flush", "aria-labelledby": "robots-title" },
      h("div", { class: "part-head" }, h("h2", { id: "robots-title" }, t`Robots`),
        h("div", { class: "tools" }, h("span", { class: "pair" }, h("label", { for: "search" }, t`Search`), search), h("span", { class: "pair" }, h("label", { for: "order" }, t`Sort by`), sort))),
      chips, found, list,
      h("p", { class: "part-note" }, t`Each cell is a joint: friction at equal speed and temperature against the joint's own baseline, with its latest tests. All curves have one scale.`)),
  ];
  main.replaceChildren(body);

  function total(name, value, href, strong) {
    const number = href ? h("a", { href, "data-key": `total/${name}` }, count(value)) : count(value);
    return h("div", { class: strong ? "total strong" : "total" }, h("dt", null, name), h("dd", null, number));
  }

  function drawHead() {
    const of = data.counts;
    if (differs("totals", of)) replace(totals, total(t`Robots`, of.robots), total(t`Open alarms`, of.open_alarms, null, of.open_alarms > 0),
      of.open_infos ? total(t`Worth knowing`, of.open_infos) : null,
      total(t`In quarantine`, of.quarantined_runs, "#/ingest", of.quarantined_runs > 0), total(t`Live tests`, of.streaming_runs, "#/ingest"));
    const now = Date.parse(data.now);
    const minute = Math.floor(now / 60_000);
    const open = data.anomalies.filter((one) => one.state === "open" && isAlarm(one)).sort(worstAlarmFirst);
    const rest = data.anomalies.filter((one) => !open.includes(one)).sort(worstAlarmFirst);
    const shown = allAlarms ? open : open.slice(0, FIRST_ALARMS);
    const answered = rest.filter(isAlarm);
    const states = [...new Set(answered.map((one) => stateName(one.state)))];
    const counted = states.map((name) => `${answered.filter((one) => stateName(one.state) === name).length} ${name}`).join(", ");
    const none = !data.robots.length ? null
      : answered.length ? h("p", { class: "part-note" }, t`No open alarm. ${plural(answered.length, "alarm")} still shown by tests: ${counted}.`)
        : h("p", { class: "calm" }, icon("ok"), t`No open alarm.`);
    const late = data.robots.filter((one) => one.status === "overdue" || one.joints.some((joint) => joint.status === "overdue"));
    if (differs("alarms", data.anomalies, allAlarms, late.map((one) => one.robot), data.robots.length, minute)) replace(alarms, data.robots.length || data.anomalies.length ? h("section", { class: "part flush", "aria-labelledby": "alarms-title" },
      h("div", { class: "part-head" }, h("h2", { id: "alarms-title" }, t`Open alarms`)),
      open.length ? h("ol", { class: "alarms" }, shown.map((one) => alarmRow(one, now))) : none,
      open.length > FIRST_ALARMS ? h("button", { class: "quiet more", type: "button", "data-key": "all-alarms", "aria-expanded": String(allAlarms), onclick: () => {
        allAlarms = !allAlarms;
        drawHead();
      } }, allAlarms ? t`Show the first only` : t`Show all ${open.length} alarms`) : null,
      rest.length ? h("details", { class: "more", "data-key": "rest" }, h("summary", { "data-key": "rest-summary" },
        [answered.length ? plural(answered.length, "answered alarm") : null, rest.length > answered.length ? plural(rest.length - answered.length, "informational finding") : null].filter(Boolean).join(" + ")),
      h("ol", { class: "alarms" }, rest.map((one) => alarmRow(one, now)))) : null,
      late.length ? h("p", { class: "late-note" }, icon("overdue"), h("span", null, late.length === 1 ? t`1 robot is overdue for its test:` : t`${late.length} robots are overdue for their test:`, " ",
        late.slice(0, 4).map((one, index) => [index ? ", " : "", h("a", { href: robotLink(one.robot), "data-key": `late/${one.robot}` }, one.robot)]),
        late.length > 4 ? [" ", t`and ${late.length - 4} more (filter by overdue).`] : ".")) : null) : null);
    if (differs("live", data.live, minute)) replace(live, data.live.length ? h("section", { class: "part flush", "aria-labelledby": "live-title" },
      h("div", { class: "part-head" }, h("h2", { id: "live-title" }, t`Live tests`)),
      h("ul", { class: "lives" }, data.live.map((one) => h("li", null, h("a", { class: "row-link live-row", href: `#/run/${one.run_id}`, "data-key": `live${one.run_id}` },
        h("span", { class: "badge s-live" }, icon("live"), one.robot),
        h("span", null, t`${plural(one.cycles, "cycle")} so far`),
        h("span", { class: "muted file" }, one.source_name),
        h("span", { class: "muted" }, t`began ${ago(one.started_at, now)}`)))))) : null);
  }

  function drawChips() {
    const of = (name) => data.robots.filter((one) => one.status === name).length;
    const chip = (name, text, number) => h("button", { type: "button", class: `chip ${name ? `s-${name}` : ""}`, "aria-pressed": String(status === name), "data-key": `chip/${name}`, onclick: () => {
      status = status === name ? "" : name;
      choose({ status });
      drawChips();
      drawRobots();
    } }, name ? icon(name) : null, `${text} `, h("b", null, count(number)));
    if (differs("chips", status, data.robots.length, STATUSES.map(of))) replace(chips, chip("", t`All`, data.robots.length), STATUSES.filter((one) => of(one) || one === status).map((one) => chip(one, statusName(one), of(one))));
  }

  function drawRobots() {
    const asked = words.trim().toLowerCase();
    const shown = data.robots.filter((one) => (!status || one.status === status)
      && (!asked || one.robot.toLowerCase().includes(asked) || (one.model ?? "").toLowerCase().includes(asked))).sort(ORDERS[order][1](data.anomalies));
    const range = sparkRange(data.robots);
    const now = Date.parse(data.now);
    const own = ++pending;
    const active = document.activeElement;
    const key = list.contains(active) ? active.dataset.key : null;
    const wanted = [];
    const build = (robot) => {
      const alarms = alarmsOf(data.anomalies, robot.robot);
      const text = `${JSON.stringify([robot, alarms])}${range}${Math.floor(now / 3_600_000)}`;
      let kept = rows.get(robot.robot);
      if (kept?.text !== text) {
        kept = { text, node: robotRow(robot, range, now, alarms) };
        rows.set(robot.robot, kept);
      }
      wanted.push(kept.node);
    };
    // The list is changed in place: a row that stays where it was keeps its focus.
    const place = (whole) => {
      wanted.forEach((node, index) => { if (list.children[index] !== node) list.insertBefore(node, list.children[index] ?? null); });
      if (whole) while (list.children.length > wanted.length) list.lastChild.remove();
      if (key && !list.contains(document.activeElement)) list.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus({ preventScroll: true });
    };
    const ready = (robot) => rows.has(robot.robot);
    let next = 0;
    const step = (size) => {
      for (let made = 0; next < shown.length && made < size; next += 1) {
        if (!ready(shown[next])) made += 1;
        build(shown[next]);
      }
      place(next >= shown.length);
      if (next < shown.length) idle(() => { if (own === pending && !gone) step(CHUNK); });
    };
    list.classList.toggle("many", shown.length > MANY);
    step(AT_ONCE);
    found.textContent = shown.length === data.robots.length ? "" : shown.length
      ? t`${count(shown.length)} of ${plural(data.robots.length, "robot")}` : t`No robot matches. Clear the search or choose “All”.`;
  }

  function draw() {
    if (!data.robots.length && !data.live.length && !data.anomalies.length) {
      drawHead();
      replace(body, content[0], empty(h("h2", null, t`No test yet`),
        watchedNote(data),
        dropped(),
        demoNote(),
        data.counts.quarantined_runs ? h("p", null, h("a", { href: "#/ingest" }, t`${plural(data.counts.quarantined_runs, "export")} in quarantine: see why`)) : null));
      return;
    }
    if (body.children.length !== content.length) body.replaceChildren(...content);
    drawHead();
    drawChips();
    drawRobots();
    for (const name of [...rows.keys()]) if (!data.robots.some((one) => one.robot === name)) rows.delete(name);
  }

  async function refresh() {
    const first = data === null;
    try {
      const fresh = await fleet();
      if (gone) return;
      if (data && fresh.counts.open_alarms > data.counts.open_alarms) announce(t`A new alarm. ${plural(fresh.counts.open_alarms, "open alarm")}.`);
      data = fresh;
      draw();
    } catch (error) {
      if (!gone && (first || error.status === 401)) replace(body, h("h1", { tabindex: -1 }, t`Fleet`), failed(error, () => refresh().catch(() => {})));
      throw error;
    }
  }

  return { refresh, destroy() { gone = true; } };
}
