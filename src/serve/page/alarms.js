import { view } from "./api.js";
import { KINDS } from "./lists.js";
import { h, table } from "./dom.js";
import { robotLink } from "./fleet.js";
import { moment, plural } from "./format.js";
import { t } from "./messages.js";
import { empty, part } from "./part.js";
import { findingOf, stateText, worstAlarmFirst } from "./quantities.js";
import { badge, jointName, kindName, severityName, STATES } from "./status.js";

const MOST = 10_000;
const DAY_MS = 86_400_000;
const SEVERITIES = ["critical", "warning", "info"];
const PERIODS = [["", t`any time`], ["1", t`the last day`], ["7", t`the last 7 days`], ["30", t`the last 30 days`], ["365", t`the last year`]];
const TODO = "todo";

/** All alarms of the fleet, closed ones too, with filters that stay in the address. */
export function mount({ main, query, choose, title }) {
  title(t`Alarms`);
  const wanted = {};
  const pickers = [];

  function pick(name, label, options, missing = "") {
    wanted[name] = query.get(name) ?? missing;
    const select = h("select", { id: `by-${name}`, onchange: () => {
      wanted[name] = select.value;
      choose({ [name]: select.value === missing ? null : select.value });
      list.again();
    } });
    select.replaceChildren(...options.map(([value, text]) => h("option", { value, selected: value === wanted[name] }, text)));
    pickers.push(h("span", { class: "pair" }, h("label", { for: select.id }, label), select));
    return select;
  }

  wanted.search = query.get("search") ?? "";
  const search = h("input", { id: "by-search", type: "search", value: wanted.search, placeholder: t`Robot or text`, oninput: () => {
    wanted.search = search.value;
    choose({ search: search.value });
    list.again();
  } });
  pickers.push(h("span", { class: "pair" }, h("label", { for: "by-search" }, t`Search`), search));
  pick("state", t`State`, [[TODO, t`open or answered`], ["all", t`all states`], ...Object.entries(STATES)], TODO);
  pick("severity", t`Severity`, [["", t`all`], ...SEVERITIES.map((one) => [one, severityName(one)])]);
  pick("kind", t`Kind`, [["", t`all`], ...Object.keys(KINDS).map((one) => [one, kindName(one)])]);
  pick("seen", t`Last seen in`, PERIODS);
  const person = pick("person", t`Person`, [["", t`anybody`]]);

  const shows = (one, who) => {
    const text = wanted.search.trim().toLowerCase();
    return (wanted.state === "all" || (wanted.state === TODO ? !["resolved", "false_alarm"].includes(one.state) : one.state === wanted.state))
      && (!wanted.severity || one.severity === wanted.severity) && (!wanted.kind || one.kind === wanted.kind)
      && (!wanted.seen || Date.parse(one.last_seen_at) > Date.now() - Number(wanted.seen) * DAY_MS)
      && (!wanted.person || who.get(one.anomaly_id)?.has(wanted.person))
      && (!text || one.robot.toLowerCase().includes(text) || one.message.toLowerCase().includes(text));
  };

  const list = part({
    title: t`All alarms`, tools: h("div", { class: "tools" }, pickers),
    load: async (signal) => {
      const [alarms, events] = await Promise.all([view("anomalies", { order: "-last_seen_at", limit: MOST }, signal), view("anomaly_history", { order: "-anomaly_event_id", limit: MOST }, signal)]);
      return { rows: alarms.rows, truncated: alarms.truncated, answers: [...events.rows.filter((one) => one.who).map((one) => [one.anomaly_id, one.who]), ...alarms.rows.filter((one) => one.assignee).map((one) => [one.anomaly_id, one.assignee])] };
    },
    draw: ({ rows, truncated, answers }) => {
      const who = new Map();
      for (const [id, name] of answers) who.set(id, (who.get(id) ?? new Set()).add(name));
      const people = [...new Set(answers.map((one) => one[1]))].sort();
      person.replaceChildren(...[["", t`anybody`], ...people.map((one) => [one, one])].map(([value, text]) => h("option", { value, selected: value === wanted.person }, text)));
      const shown = rows.filter((one) => shows(one, who)).sort(worstAlarmFirst);
      if (!rows.length) return empty(t`No alarm was ever found.`);
      return [
        h("p", { class: "muted found", role: "status" }, shown.length ? t`${shown.length} of ${plural(rows.length, "alarm")}` : t`None of ${plural(rows.length, "alarm")} matches. Change the filters.`),
        truncated ? h("p", { class: "part-note" }, t`The latest ${MOST} alarms are searched.`) : null,
        shown.length ? table({ caption: t`Alarms`, rows: shown, columns: [
          { title: t`Alarm`, cell: (one) => h("a", { href: `#/alarm/${one.anomaly_id}`, "data-key": `alarm${one.anomaly_id}` }, t`alarm ${one.anomaly_id}`) },
          { title: t`Severity`, cell: (one) => badge(one.severity) },
          { title: t`Robot`, cell: (one) => [h("a", { href: robotLink(one.robot, one.joint), "data-key": `of${one.anomaly_id}` }, one.robot), `, ${jointName(one.joint)}`] },
          { title: t`Finding`, wide: true, cell: (one) => findingOf(one) },
          { title: t`Kind`, cell: (one) => kindName(one.kind) },
          { title: t`State`, cell: (one) => [stateText(one), who.has(one.anomaly_id) ? h("small", { class: "muted" }, ` ${[...who.get(one.anomaly_id)].join(", ")}`) : null] },
          { title: t`Assigned to`, cell: (one) => one.assignee ?? "" },
          { title: t`Onset`, cell: (one) => moment(one.onset_at ?? one.first_seen_at, "day") },
          { title: t`Last seen`, cell: (one) => moment(one.last_seen_at, "day") },
        ] }) : null,
      ];
    },
  });

  main.replaceChildren(h("h1", { tabindex: -1 }, t`Alarms`), list.element);
  return { refresh: () => list.refresh(), destroy: () => list.destroy() };
}
