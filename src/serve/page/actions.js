import { post } from "./api.js";
import { ask, form, whoField } from "./dialog.js";
import { h, remember, remembered, toast } from "./dom.js";
import { jointName } from "./status.js";

const WORKS = ["gearbox changed", "grease renewed", "brake changed", "motor changed", "torque sensor changed", "cables renewed", "tool or load changed"];

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

async function enter(robot, values) {
  await post(`v1/robots/${encodeURIComponent(robot)}/maintenance`, {
    who: values.who, what: values.what, joint: values.joint ? Number(values.joint) : null, at: utc(values.at),
  });
  toast(`Work on ${robot} is entered: ${values.what}.`);
}

/** The form "enter work done" of a robot's page. */
export function maintenanceForm(robot, joints, done) {
  const node = form({
    fields: maintenanceFields(joints, null, true), submit: "Enter the work",
    onsubmit: async (values) => {
      await enter(robot, values);
      node.reset();
      done();
    },
  });
  return node;
}

export function askMaintenance(anomaly, joints, done) {
  return ask({
    title: "Enter work that was done",
    intro: `${anomaly.robot}, ${jointName(anomaly.joint)}. From this work on, a new baseline is learnt. Alarms of this place from before are silent, in maintenance, until tests show whether they are gone.`,
    fields: maintenanceFields(joints, anomaly.joint, true), submit: "Enter the work",
    onsubmit: (values) => enter(anomaly.robot, values),
  }).then((entered) => { if (entered) done(); });
}

const ACTIONS = {
  acknowledge: {
    title: "Acknowledge", intro: "Others see that somebody knows of this alarm.", submit: "Acknowledge", said: "acknowledged", fields: () => [whoField(), whyField()],
  },
  shelve: {
    title: "Shelve", intro: "The alarm is silent until this time, unless its severity rises.", submit: "Shelve", said: "shelved",
    fields: () => [{
      name: "until", label: "Until", type: "datetime-local", required: true, value: inDays(7), hint: "In the time zone of this browser.",
      suggest: [["1 day", inDays(1)], ["7 days", inDays(7)], ["14 days", inDays(14)], ["30 days", inDays(30)]],
    }, whoField(), whyField("For example: gearbox comes in two weeks.")],
  },
  resolve: {
    title: "Resolve", intro: "The cause is gone. A later test that shows it opens the alarm again.", submit: "Resolve", said: "resolved", fields: () => [whoField(), whyField()],
  },
  "false-alarm": {
    title: "False alarm", intro: "Nothing was wrong. This episode does not open again.", submit: "Mark as false alarm", said: "marked as a false alarm", fields: () => [whoField(), whyField("What was seen on the robot.")],
  },
};

export function askAction(name, anomaly, done) {
  const action = ACTIONS[name];
  return ask({
    title: action.title, intro: action.intro, fields: action.fields(), submit: action.submit,
    onsubmit: async (values) => {
      await post(`v1/anomalies/${anomaly.anomaly_id}/${name}`, { who: values.who, why: values.why || null, ...(values.until ? { until: utc(values.until) } : {}) });
      toast(`Alarm ${anomaly.anomaly_id} is ${action.said}.`);
    },
  }).then((entered) => { if (entered) done(); });
}

/** A button that asks for another attempt of an export in quarantine. */
export function retryButton(fault, done) {
  const send = (who) => post(`v1/quarantine/${fault.run_id}/retry`, { who });
  const said = () => {
    toast(`Another attempt of ${fault.source_name} is asked for.`);
    done();
  };
  const button = h("button", { type: "button", "data-key": `retry/${fault.fault_id}`, "aria-label": `Retry ${fault.source_name}`, onclick: async () => {
    const who = remembered("who");
    if (who) {
      button.disabled = true;
      try {
        await send(who);
        said();
        return;
      } catch (error) {
        await ask({ title: "The retry was refused", intro: error.message, fields: [whoField()], submit: "Try again", onsubmit: (values) => send(values.who) })
          .then((entered) => { if (entered) said(); });
      } finally {
        button.disabled = false;
      }
      return;
    }
    if (await ask({ title: "Retry", intro: `The daemon reads ${fault.source_name} again.`, fields: [whoField()], submit: "Retry",
      onsubmit: async (values) => { remember("who", values.who); await send(values.who); } })) said();
  } }, "Retry");
  return button;
}
