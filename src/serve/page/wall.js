import { fleet } from "./api.js";
import { h, hidden, icon } from "./dom.js";
import { alarmsOf, jointLook, robotLink, staleSince, watchedNote, worstFirst } from "./fleet.js";
import { moment, plural } from "./format.js";
import { t } from "./messages.js";
import { empty, part } from "./part.js";
import { jointName, kindName, known, STATUSES, statusName } from "./status.js";

/** The fleet on a screen at the wall: one tile per robot, the worst first, without scrolling for 60 robots. */
export function mount({ main, title }) {
  title(t`Wall`);
  const full = document.documentElement.requestFullscreen
    ? h("button", { type: "button", onclick: () => (document.fullscreenElement ? document.exitFullscreen() : main.requestFullscreen()) }, t`Full screen`) : null;

  function tile(robot, anomalies, now) {
    const alarms = alarmsOf(anomalies, robot.robot);
    const stale = staleSince(robot, now);
    const looks = robot.joints.map((joint) => [joint, jointLook(joint, alarms)]);
    const arm = alarms.find((one) => one.joint === null);
    return h("li", null, h("a", { class: `tile s-${known(robot.status)}${stale ? " is-stale" : ""}`, href: robotLink(robot.robot), "data-key": robot.robot },
      h("span", { class: "tile-head" }, icon(known(robot.status)), h("b", null, robot.robot), hidden(`, ${statusName(robot.status)}`)),
      h("span", { class: "tile-joints" }, looks.map(([joint, look]) => h("span", { class: `tile-joint s-${look.status}`, title: `${jointName(joint.joint)}: ${look.word}` },
        ["ok", "arm"].includes(look.status) ? h("span", { "aria-hidden": "true" }, joint.joint) : h("b", { "aria-hidden": "true" }, joint.joint), hidden(`${jointName(joint.joint)} ${look.word}, `)))),
      h("span", { class: "tile-note" }, arm && !looks.some(([, look]) => look.status === robot.status) ? t`${kindName(arm.kind)} of the whole arm` : worstWord(robot, looks)),
      stale ? h("span", { class: "tile-note late" }, t`stale since ${moment(stale, "day")}`) : null));
  }

  function worstWord(robot, looks) {
    const worst = looks.find(([, look]) => look.status === robot.status);
    if (!worst || robot.status === "ok") return statusName(robot.status);
    const [joint, look] = worst;
    return `J${joint.joint} ${look.value}${look.answered ? `, ${look.answered}` : ""}`;
  }

  const tiles = part({
    className: "bare", load: (signal) => fleet(signal),
    draw: (data) => {
      if (!data.robots.length) return empty(h("h2", null, t`No test yet`), watchedNote(data));
      const counts = STATUSES.map((name) => [name, data.robots.filter((one) => one.status === name).length]).filter(([, of]) => of);
      return [
        h("p", { class: "wall-head" }, counts.map(([name, of]) => h("span", { class: `badge s-${name}` }, icon(name), `${of} ${statusName(name)}`)),
          h("span", null, t`${plural(data.counts.open_alarms, "open alarm")}, ${data.counts.quarantined_runs} in quarantine`), full),
        h("ul", { class: "wall" }, [...data.robots].sort(worstFirst(data.anomalies)).map((one) => tile(one, data.anomalies, Date.parse(data.now)))),
      ];
    },
  });
  main.replaceChildren(h("h1", { tabindex: -1 }, t`Wall`), tiles.element);
  return { refresh: () => tiles.refresh(), destroy: () => tiles.destroy() };
}
