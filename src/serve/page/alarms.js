import { view } from "./api.js";
import { KINDS } from "./lists.js";
import { h, table } from "./dom.js";
import { robotLink } from "./fleet.js";
import { finding, moment, plural } from "./format.js";
import { empty, part } from "./part.js";
import { badge, jointName, kindName, STATES, stateName } from "./status.js";

const MOST = 10_000;
const DAY_MS = 86_400_000;
const SEVERITIES = ["critical", "warning", "info"];
const PERIODS = [["", "any time"], ["1", "the last day"], ["7", "the last 7 days"], ["30", "the last 30 days"], ["365", "the last year"]];
const TODO = "todo";

/** All alarms of the fleet, settled ones too, with filters that stay in the address. */
export function mount({ main, query, choose, title }) {
  title("Alarms");
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
  const search = h("input", { id: "by-search", type: "search", value: wanted.search, placeholder: "Robot or text", oninput: () => {
    wanted.search = search.value;
    choose({ search: search.value });
    list.again();
  } });
  pickers.push(h("span", { class: "pair" }, h("label", { for: "by-search" }, "Search"), search));
  pick("state", "State", [[TODO, "open or answered"], ["all", "all states"], ...Object.entries(STATES)], TODO);
  pick("severity", "Severity", [["", "all"], ...SEVERITIES.map((one) => [one, one])]);
  pick("kind", "Kind", [["", "all"], ...Object.keys(KINDS).map((one) => [one, kindName(one)])]);
  pick("seen", "Last seen in", PERIODS);
  const person = pick("person", "Answered by", [["", "anybody"]]);

  const shows = (one, who) => {
    const text = wanted.search.trim().toLowerCase();
    return (wanted.state === "all" || (wanted.state === TODO ? !["resolved", "false_alarm"].includes(one.state) : one.state === wanted.state))
      && (!wanted.severity || one.severity === wanted.severity) && (!wanted.kind || one.kind === wanted.kind)
      && (!wanted.seen || Date.parse(one.last_seen_at) > Date.now() - Number(wanted.seen) * DAY_MS)
      && (!wanted.person || who.get(one.anomaly_id)?.has(wanted.person))
      && (!text || one.robot.toLowerCase().includes(text) || one.message.toLowerCase().includes(text));
  };

  const list = part({
    title: "All alarms", tools: h("div", { class: "tools" }, pickers),
    load: async (signal) => {
      const [alarms, events] = await Promise.all([view("anomalies", { order: "-last_seen_at", limit: MOST }, signal), view("anomaly_history", { order: "-anomaly_event_id", limit: MOST }, signal)]);
      return { rows: alarms.rows, truncated: alarms.truncated, answers: events.rows.filter((one) => one.who).map((one) => [one.anomaly_id, one.who]) };
    },
    draw: ({ rows, truncated, answers }) => {
      const who = new Map();
      for (const [id, name] of answers) who.set(id, (who.get(id) ?? new Set()).add(name));
      const people = [...new Set(answers.map((one) => one[1]))].sort();
      person.replaceChildren(...[["", "anybody"], ...people.map((one) => [one, one])].map(([value, text]) => h("option", { value, selected: value === wanted.person }, text)));
      const shown = rows.filter((one) => shows(one, who));
      if (!rows.length) return empty("No alarm was ever found.");
      return [
        h("p", { class: "muted found", role: "status" }, shown.length ? `${shown.length} of ${plural(rows.length, "alarm")}` : `None of ${plural(rows.length, "alarm")} matches. Change the filters.`),
        truncated ? h("p", { class: "part-note" }, `The latest ${MOST} alarms are searched.`) : null,
        shown.length ? table({ caption: "Alarms", rows: shown, columns: [
          { title: "Alarm", cell: (one) => h("a", { href: `#/alarm/${one.anomaly_id}`, "data-key": `alarm${one.anomaly_id}` }, `alarm ${one.anomaly_id}`) },
          { title: "Severity", cell: (one) => badge(one.severity) },
          { title: "Robot", cell: (one) => [h("a", { href: robotLink(one.robot, one.joint), "data-key": `of${one.anomaly_id}` }, one.robot), `, ${jointName(one.joint)}`] },
          { title: "Finding", wide: true, cell: (one) => finding(one.message) },
          { title: "Kind", cell: (one) => kindName(one.kind) },
          { title: "State", cell: (one) => [stateName(one.state), who.has(one.anomaly_id) ? h("small", { class: "muted" }, ` ${[...who.get(one.anomaly_id)].join(", ")}`) : null] },
          { title: "Onset", cell: (one) => moment(one.onset_at ?? one.first_seen_at, "day") },
          { title: "Last seen", cell: (one) => moment(one.last_seen_at, "day") },
        ] }) : null,
      ];
    },
  });

  main.replaceChildren(h("h1", { tabindex: -1 }, "Alarms"), list.element);
  return { refresh: () => list.refresh(), destroy: () => list.destroy() };
}
