import { logIn, post, remove, rights } from "./api.js";
import { ask, form, whoField } from "./dialog.js";
import { h, toast } from "./dom.js";
import { jointName, kindName } from "./status.js";

const WORKS = ["gearbox changed", "grease renewed", "brake changed", "motor changed", "torque sensor changed", "cables renewed", "tool or load changed"];

/** Why this browser may not change anything, with the remedy; null where it may. */
export function whyNot() {
  if (!rights || rights.act) return null;
  if (!rights.needsToken) return h("p", { class: "muted" }, "You can only look: the daemon has no token. The operator sets one with serve.token_file.");
  return h("p", { class: "muted" }, "You can only look. ", h("button", { type: "button", class: "quiet", "data-key": "log-in", onclick: () => logIn() }, "Log in to act"));
}

/** A button of an action: disabled where this browser may only look. */
function act(props, text) {
  return h("button", { type: "button", ...props, disabled: rights !== null && !rights.act }, text);
}

function local(at) {
  const shifted = new Date(at.getTime() - at.getTimezoneOffset() * 60_000);
  return shifted.toISOString().slice(0, 16);
}

const inDays = (days) => local(new Date(Date.now() + days * 86_400_000));
const utc = (text) => (text ? new Date(text).toISOString() : null);
const whyField = (hint) => ({ name: "why", label: "Reason", hint });

function maintenanceFields(joints, joint, when) {
  return [
    { name: "what", label: "Work that was done", required: true, suggest: WORKS.map((one) => [one]) },
    { name: "joint", label: "Where", chosen: true, value: joint ?? "", options: [["", "whole arm"], ...joints.map((one) => [one, jointName(one)])] },
    whoField(),
    ...(when ? [{ name: "at", label: "When, if not now", type: "datetime-local", hint: "In the time zone of this browser." }] : []),
  ];
}

async function enter(robot, values, done) {
  const entered = await post(`v1/robots/${encodeURIComponent(robot)}/maintenance`, {
    who: values.who, what: values.what, joint: values.joint ? Number(values.joint) : null, at: utc(values.at),
  });
  toast(`Work on ${robot} is entered: ${values.what}.`, async () => {
    await remove(`v1/maintenance/${entered.maintenance_id}`);
    done();
  });
}

/** A button that deletes an entry of work. */
export function deleteButton(work, done) {
  const name = `${work.what}, ${jointName(work.joint)}`;
  return act({ class: "quiet", "data-key": `delete/${work.maintenance_id}`, "aria-label": `Delete the entry: ${name}`, onclick: async () => {
    if (await ask({
      title: "Delete this entry", intro: `${work.robot}: ${name}. The baseline of before holds again, and alarms that this entry put into maintenance are open again.`,
      fields: [], submit: "Delete the entry", onsubmit: () => remove(`v1/maintenance/${work.maintenance_id}`),
    })) {
      toast(`Deleted: ${name}.`, async () => {
        await post(`v1/robots/${encodeURIComponent(work.robot)}/maintenance`, { who: work.who ?? "unknown", what: work.what, joint: work.joint, at: work.at });
        done();
      });
      done();
    }
  } }, "Delete");
}

/** The form "enter work done" of a robot's page. */
export function maintenanceForm(robot, joints, done) {
  const refusal = whyNot();
  if (refusal) return h("div", null, refusal);
  const node = form({
    fields: maintenanceFields(joints, null, true), submit: "Enter the work",
    onsubmit: async (values) => {
      await enter(robot, values, done);
      node.reset();
      done();
    },
  });
  return node;
}

export function askMaintenance(anomaly, joints, done) {
  return ask({
    title: `Work was done: ${nameOf(anomaly)}`,
    intro: "From this work on, a new baseline is learnt. Earlier alarms of this place are in maintenance until tests show whether they are gone.",
    fields: maintenanceFields(joints, anomaly.joint, true), submit: "Enter the work",
    onsubmit: (values) => enter(anomaly.robot, values, done),
  }).then((entered) => { if (entered) done(); });
}

const nameOf = (one) => `${one.robot}, ${jointName(one.joint)}, ${kindName(one.kind).toLowerCase()}`;

const ACTIONS = {
  acknowledge: {
    text: "Acknowledge", intro: "Others see that somebody knows of this alarm.", said: "acknowledged", from: ["open", "shelved"], fields: () => [whoField(), whyField()],
  },
  shelve: {
    text: "Shelve until", intro: "The alarm is silent until this time, unless its severity rises.", said: "shelved", from: ["open", "acknowledged", "shelved"],
    fields: () => [{
      name: "until", label: "Until", type: "datetime-local", required: true, value: inDays(7), hint: "In the time zone of this browser.",
      suggest: [["1 day", inDays(1)], ["7 days", inDays(7)], ["14 days", inDays(14)], ["30 days", inDays(30)]],
    }, whoField(), whyField("For example: gearbox comes in two weeks.")],
  },
  resolve: {
    text: "Resolve", intro: "The cause is gone. A later test that shows it opens the alarm again.", said: "resolved", from: ["open", "acknowledged", "shelved", "maintenance"], fields: () => [whoField(), whyField()],
  },
  "false-alarm": {
    text: "False alarm", intro: "Nothing was wrong. This episode does not open again.", said: "marked as a false alarm", from: ["open", "acknowledged", "shelved", "maintenance", "resolved"],
    fields: () => [whoField(), whyField("What was seen on the robot.")],
  },
  reopen: {
    text: "Reopen", intro: "Nobody deals with the alarm now.", said: "open again", from: ["acknowledged", "shelved", "maintenance", "resolved", "false_alarm"], fields: () => [whoField(), whyField()],
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
      await send(name, { who: values.who, why: values.why || null, ...(values.until ? { until: utc(values.until) } : {}) });
      const back = BACK[anomaly.state];
      toast(`The alarm of ${nameOf(anomaly)} is ${action.said}.`, back ? async () => {
        // A closed alarm cannot be shelved.
        if (back === "shelve") await send("reopen", { who: values.who, why: "undone" });
        await send(back, { who: values.who, why: "undone", ...(back === "shelve" ? { until: anomaly.shelved_until } : {}) });
        done();
      } : null);
    },
  }).then((entered) => { if (entered) done(); }) }, action.text);
}

/** The button of the usual next step after a repair. */
export function workButton(anomaly, joints, done) {
  return act({ "data-key": "work", onclick: () => askMaintenance(anomaly, joints, done) }, "Work was done");
}

/** A button that dismisses an export in quarantine. */
export function dismissButton(fault, done) {
  return act({ "data-key": `dismiss/${fault.fault_id}`, "aria-label": `Dismiss ${fault.source_name}`, onclick: async () => {
    const dismissed = await ask({
      title: `Dismiss ${fault.source_name}`, intro: "Nothing is to be done about this file. It stays where it is and is no longer counted.",
      fields: [whoField(), { name: "why", label: "Reason", required: true, suggest: [["not an export"], ["recorded again"], ["recording is broken"]] }], submit: "Dismiss",
      onsubmit: (values) => post(`v1/quarantine/${fault.run_id}/dismiss`, values),
    });
    if (!dismissed) return;
    toast(`${fault.source_name} is dismissed.`, async () => {
      await post(`v1/quarantine/${fault.run_id}/retry`, {});
      done();
    });
    done();
  } }, "Dismiss");
}

/** A button that asks for another attempt of an export in quarantine. */
export function retryButton(fault, done) {
  const button = act({ "data-key": `retry/${fault.fault_id}`, "aria-label": `Retry ${fault.source_name}`, onclick: async () => {
    button.disabled = true;
    try {
      await post(`v1/quarantine/${fault.run_id}/retry`, {});
      toast(`${fault.source_name} is read again at the next scan.`);
      done();
    } catch (error) {
      toast(error.message);
    } finally {
      button.disabled = false;
    }
  } }, "Retry");
  return button;
}
