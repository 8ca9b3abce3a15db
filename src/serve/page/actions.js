import { logIn, post, put, remove, rights, view } from "./api.js";
import { ask, form, whoField } from "./dialog.js";
import { h, toast } from "./dom.js";
import { momentText, plural } from "./format.js";
import { lower, t } from "./messages.js";
import { jointName, kindName } from "./status.js";

const WORKS = [t`gearbox changed`, t`grease renewed`, t`brake changed`, t`motor changed`, t`torque sensor changed`, t`cables renewed`, t`tool or load changed`];

/** The reason why this browser may not change anything, with the remedy; null if it may. */
export function whyNot() {
  if (!rights || rights.act) return null;
  if (!rights.needsToken) return h("p", { class: "muted" }, t`You can only look: the daemon has no token. The operator sets one with serve.token_file.`);
  return h("p", { class: "muted" }, t`You can only look.`, " ", h("button", { type: "button", class: "quiet", "data-key": "log-in", onclick: () => logIn() }, t`Log in to act`));
}

/** A button of an action: disabled if this browser may only read. */
function act(props, text) {
  return h("button", { type: "button", ...props, disabled: rights !== null && !rights.act }, text);
}

function local(at) {
  const shifted = new Date(at.getTime() - at.getTimezoneOffset() * 60_000);
  return shifted.toISOString().slice(0, 16);
}

const inDays = (days) => local(new Date(Date.now() + days * 86_400_000));
const utc = (text) => (text ? new Date(text).toISOString() : null);
const whyField = (hint) => ({ name: "why", label: t`Reason`, hint });

const ARM = "arm";
/** How a place stands in the form: a joint, null for the whole arm, or undefined if nothing suggests one. */
const optionOf = (joint) => (joint === null ? ARM : joint ?? "");
const placeOf = (values) => (values.joint === ARM ? null : Number(values.joint));

function placeField(joints, joint) {
  return { name: "joint", label: t`Where`, required: true, value: optionOf(joint),
    options: [...(joint === undefined ? [["", t`Choose`]] : []), [ARM, t`whole arm`], ...joints.map((one) => [one, jointName(one)])] };
}

/** Says how many tests after the entered time are there already. */
function laterTests(robot) {
  let asked = null;
  return async (at) => {
    if (!at) return "";
    asked ??= view("runs", { robot, kind: "test", status: "complete", order: "-started_at", limit: 1000 });
    const count = (await asked).rows.filter((one) => one.started_at >= utc(at)).length;
    return count ? t`Recorded after this time, and counted for the new baseline: ${plural(count, "test")}.` : "";
  };
}

/** What follows from an entry of work. */
async function next(robot, joint) {
  const { rows } = await view("baseline_changes", { robot, order: "-formed_at", limit: 100 }).catch(() => ({ rows: [] }));
  const most = Math.max(0, ...rows.map((one) => JSON.parse(one.run_ids).length));
  return t`${again()} New baseline of ${jointName(joint)}: the first ${most ? plural(most, "test") : t`tests`} after the work.`;
}

const again = () => t`The history is evaluated again within a minute.`;

function maintenanceFields(robot, joints, joint) {
  return [
    { name: "what", label: t`Work that was done`, required: true, suggest: WORKS.map((one) => [one]) },
    placeField(joints, joint),
    whoField(),
    { name: "at", label: t`When, if not now`, type: "datetime-local", hint: t`In the time zone of this browser.`, note: laterTests(robot) },
  ];
}

async function enter(robot, values, done) {
  const joint = placeOf(values);
  const entered = await post(`v1/robots/${encodeURIComponent(robot)}/maintenance`, { who: values.who, what: values.what, joint, at: utc(values.at) });
  toast(`${t`Work on ${robot} is entered: ${values.what}.`} ${await next(robot, joint)}`, { about: robot, undo: async () => {
    await remove(`v1/maintenance/${entered.maintenance_id}`);
    done();
  } });
}

/** A button that corrects an entry of work. */
export function editButton(work, joints, done) {
  return act({ class: "quiet", "data-key": `edit/${work.maintenance_id}`, "aria-label": t`Edit the entry: ${work.what}`, onclick: async () => {
    const fields = maintenanceFields(work.robot, joints, work.joint).map((one) => ({ ...one, value: { what: work.what, at: local(new Date(work.at)) }[one.name] ?? one.value }));
    if (!await ask({
      title: t`Edit the entry: ${work.what}`, fields, submit: t`Save`,
      // An unchanged time keeps its seconds.
      onsubmit: (values) => put(`v1/maintenance/${work.maintenance_id}`, {
        who: values.who, what: values.what, joint: placeOf(values),
        at: values.at === local(new Date(work.at)) ? work.at : utc(values.at),
      }),
    })) return;
    toast(`${t`The entry is saved.`} ${again()}`, { about: work.robot });
    done();
  } }, t`Edit`);
}

/** A button that plans a maintenance window. */
export function windowButton(robot, joints, done) {
  return act({ "data-key": "window", onclick: async () => {
    if (!await ask({
      title: t`Plan maintenance of ${robot}`,
      intro: t`While the window lasts, alarms are in maintenance and no message is sent. Those that go on are open again at its end.`,
      fields: [
        { name: "what", label: t`Planned work`, required: true, suggest: WORKS.map((one) => [one]) },
        placeField(joints, null),
        { name: "from", label: t`From`, type: "datetime-local", required: true, value: inDays(0) },
        { name: "until", label: t`Until`, type: "datetime-local", required: true, value: inDays(1), hint: t`In the time zone of this browser.` },
        whoField(),
      ],
      submit: t`Plan the window`,
      onsubmit: (values) => post(`v1/robots/${encodeURIComponent(robot)}/windows`, {
        who: values.who, what: values.what, joint: placeOf(values), from: utc(values.from), until: utc(values.until),
      }),
    })) return;
    toast(t`The window is planned.`, { about: robot });
    done();
  } }, t`Plan maintenance`);
}

/** A button that deletes a planned window. */
export function cancelWindowButton(planned, done) {
  return act({ class: "quiet", "data-key": `cancel/${planned.maintenance_window_id}`, "aria-label": t`Delete the window: ${planned.what}`, onclick: async () => {
    if (!await ask({
      title: t`Delete the window: ${planned.what}`, intro: t`Alarms that it alone holds are open again.`,
      fields: [], submit: t`Delete the window`, onsubmit: () => remove(`v1/windows/${planned.maintenance_window_id}`),
    })) return;
    toast(t`The window is deleted.`, { about: planned.robot });
    done();
  } }, t`Delete`);
}

/** A form below the history of an alarm: a comment changes no state. */
export function commentForm(anomaly, done) {
  if (rights && !rights.act) return null;
  const node = form({
    fields: [{ name: "why", label: t`Comment`, required: true }, whoField()], submit: t`Add the comment`,
    onsubmit: async (values) => {
      await post(`v1/anomalies/${anomaly.anomaly_id}/comment`, values);
      node.querySelector('[name="why"]').value = "";
      done();
    },
  });
  return node;
}

/** A button that assigns an alarm to a person. */
export function assignButton(anomaly, people, done) {
  return act({ "data-key": "assign", onclick: async () => {
    let assigned = "";
    if (!await ask({
      title: t`Assign the alarm: ${nameOf(anomaly)}`, intro: t`An empty field assigns it to nobody.`,
      fields: [{ name: "to", label: t`Assign to`, value: anomaly.assignee ?? "", suggest: people.map((one) => [one]) }, whoField()],
      submit: t`Assign`,
      onsubmit: (values) => {
        assigned = values.to;
        return post(`v1/anomalies/${anomaly.anomaly_id}/assign`, { who: values.who, to: values.to || null });
      },
    })) return;
    toast(assigned ? t`Assigned to ${assigned}.` : t`Assigned to nobody.`, { about: anomaly.robot });
    done();
  } }, t`Assign`);
}

/** A button that deletes an entry of work. */
export function deleteButton(work, done) {
  const name = `${work.what}, ${jointName(work.joint)}`;
  return act({ class: "quiet", "data-key": `delete/${work.maintenance_id}`, "aria-label": t`Delete the entry: ${name}`, onclick: async () => {
    if (await ask({
      title: t`Delete this entry`, intro: t`${work.robot}: ${name}. The earlier baseline applies again, and alarms that this entry put into maintenance are open again.`,
      fields: [], submit: t`Delete the entry`, onsubmit: () => remove(`v1/maintenance/${work.maintenance_id}`),
    })) {
      toast(`${t`Deleted: ${name}.`} ${again()} ${t`The earlier baseline applies again.`}`, { about: work.robot, undo: async () => {
        await post(`v1/robots/${encodeURIComponent(work.robot)}/maintenance`, { who: work.who ?? "unknown", what: work.what, joint: work.joint, at: work.at });
        done();
      } });
      done();
    }
  } }, t`Delete`);
}

/** The form "enter work done" of a robot's page. `place` gives the joint that the page is about, as for `optionOf`. */
export function maintenanceForm(robot, joints, place, done) {
  const refusal = whyNot();
  if (refusal) return { node: h("div", null, refusal), suggestPlace() {} };
  const node = form({
    fields: maintenanceFields(robot, joints, undefined), submit: t`Enter the work`,
    onsubmit: async (values) => {
      await enter(robot, values, done);
      for (const name of ["what", "at"]) node.querySelector(`[name="${name}"]`).value = "";
      chosen = false;
      suggestPlace();
      done();
    },
  });
  const select = node.querySelector('[name="joint"]');
  let chosen = false;
  select.addEventListener("change", () => { chosen = true; });
  function suggestPlace() {
    if (!chosen) select.value = String(optionOf(place()));
  }
  suggestPlace();
  return { node, suggestPlace };
}

export function askMaintenance(anomaly, joints, done) {
  return ask({
    title: t`Work was done: ${nameOf(anomaly)}`,
    intro: t`From this work on, a new baseline is learnt. Earlier alarms of this place are in maintenance until tests show whether they are gone.`,
    fields: maintenanceFields(anomaly.robot, joints, anomaly.joint), submit: t`Enter the work`,
    onsubmit: (values) => enter(anomaly.robot, values, done),
  }).then((entered) => { if (entered) done(); });
}

const nameOf = (one) => `${one.robot}, ${jointName(one.joint)}, ${lower(kindName(one.kind))}`;

const ACTIONS = {
  acknowledge: {
    text: t`Acknowledge`, intro: t`Others see that somebody knows of this alarm.`, said: t`acknowledged`, to: "acknowledged", from: ["open", "shelved"], fields: () => [whoField(), whyField()],
  },
  shelve: {
    text: t`Shelve`, intro: t`The alarm is silent until this time, unless its severity rises.`, said: t`shelved`, to: "shelved", from: ["open", "acknowledged", "shelved"],
    fields: () => [{
      name: "until", label: t`Until`, type: "datetime-local", required: true, value: inDays(7), hint: t`In the time zone of this browser.`,
      suggest: [1, 2, 3, 7, 14, 30].map((days) => [plural(days, "day"), inDays(days)]),
    }, whoField(), whyField(t`For example: gearbox comes in two weeks.`)],
  },
  resolve: {
    text: t`Resolve`, intro: t`The cause is gone. A later test that shows it opens the alarm again.`, said: t`resolved`, to: "resolved", from: ["open", "acknowledged", "shelved", "maintenance"], fields: () => [whoField(), whyField()],
  },
  "false-alarm": {
    text: t`False alarm`, intro: t`Nothing was wrong. This episode does not open again.`, said: t`marked as a false alarm`, to: "false_alarm", from: ["open", "acknowledged", "shelved", "maintenance", "resolved"],
    fields: () => [whoField(), whyField(t`What was seen on the robot.`)],
  },
  reopen: {
    text: t`Reopen`, intro: t`Nobody deals with the alarm now.`, said: t`open again`, to: "open", from: ["acknowledged", "shelved", "maintenance", "resolved", "false_alarm"], fields: () => [whoField(), whyField()],
  },
};

/** Names of the actions that are possible in the state of an alarm. */
export function possibleActions(one) {
  const names = Object.keys(ACTIONS).filter((name) => ACTIONS[name].from.includes(one.state));
  // an alarm that later tests no longer show needs no answer
  return one.ended ? names.filter((name) => name === "false-alarm") : names;
}

const BACK = { open: "reopen", acknowledged: "acknowledge", shelved: "shelve", resolved: "resolve", false_alarm: "false-alarm" };

/** A button for one of `possibleActions`. */
export function actionButton(name, anomaly, done) {
  const action = ACTIONS[name];
  const send = (path, values) => post(`v1/anomalies/${anomaly.anomaly_id}/${path}`, values);
  return act({ "data-key": name, onclick: () => ask({
    title: `${action.text}: ${nameOf(anomaly)}`, intro: action.intro, fields: action.fields(), submit: action.text,
    onsubmit: async (values) => {
      // The state to go back to: the page may not have it yet.
      const before = (await view("anomalies", { anomaly_id: anomaly.anomaly_id, limit: 1 })).rows[0] ?? anomaly;
      await send(name, { who: values.who, why: values.why || null, ...(values.until ? { until: utc(values.until) } : {}) });
      const back = BACK[before.state];
      toast(t`The alarm of ${nameOf(anomaly)} is ${values.until ? t`shelved until ${momentText(new Date(values.until))}` : action.said}.`, { about: anomaly.robot, alarm: anomaly.anomaly_id, state: action.to, undo: back ? async () => {
        // A closed alarm cannot be shelved.
        if (back === "shelve") await send("reopen", { who: values.who, why: "undone" });
        await send(back, { who: values.who, why: "undone", ...(back === "shelve" ? { until: before.shelved_until } : {}) });
        done();
      } : null });
    },
  }).then((entered) => { if (entered) done(); }) }, action.text);
}

/** The button of the usual next step after a repair. */
export function workButton(anomaly, joints, done) {
  return act({ "data-key": "work", onclick: () => askMaintenance(anomaly, joints, done) }, t`Work was done`);
}

/** A button that dismisses an export in quarantine. */
export function dismissButton(fault, done) {
  return act({ "data-key": `dismiss/${fault.fault_id}`, "aria-label": t`Dismiss ${fault.source_name}`, onclick: async () => {
    const dismissed = await ask({
      title: t`Dismiss ${fault.source_name}`, intro: t`Nothing is to be done about this file. It stays where it is and is no longer counted.`,
      fields: [whoField(), { name: "why", label: t`Reason`, required: true, suggest: [[t`not an export`], [t`recorded again`], [t`recording is broken`]] }], submit: t`Dismiss`,
      onsubmit: (values) => post(`v1/quarantine/${fault.run_id}/dismiss`, values),
    });
    if (!dismissed) return;
    toast(t`${fault.source_name} is dismissed.`, { about: fault.run_id, undo: async () => {
      await post(`v1/quarantine/${fault.run_id}/retry`, {});
      done();
    } });
    done();
  } }, t`Dismiss`);
}

/** A button that has an export in quarantine read again. */
export function retryButton(fault, done) {
  const button = act({ "data-key": `retry/${fault.fault_id}`, "aria-label": t`Retry ${fault.source_name}`, onclick: async () => {
    button.disabled = true;
    try {
      await post(`v1/quarantine/${fault.run_id}/retry`, {});
      toast(t`${fault.source_name} is read again at the next scan.`, { about: fault.run_id });
      done();
    } catch (error) {
      toast(error.message);
    } finally {
      button.disabled = false;
    }
  } }, t`Retry`);
  return button;
}
