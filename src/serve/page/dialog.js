import { h, remember, remembered } from "./dom.js";
import { t } from "./messages.js";

let number = 0;

function field(one) {
  const id = `f${++number}`;
  const hint = one.hint ? h("p", { class: "hint", id: `${id}h` }, one.hint) : null;
  const props = { id, name: one.name, required: one.required, "aria-describedby": hint ? `${id}h` : null, autocomplete: one.autocomplete ?? "off" };
  let input;
  if (one.options) {
    input = h("select", props, one.options.map(([value, text]) => h("option", { value, selected: String(value) === String(one.value) }, text)));
  } else {
    input = h("input", { ...props, type: one.type ?? "text", value: one.value ?? "", maxlength: one.type ? null : 500 });
  }
  // Says the consequence of the value.
  const note = one.note ? h("p", { class: "hint", role: "status" }) : null;
  if (note) {
    const tell = async () => { note.textContent = await one.note(input.value).catch(() => ""); };
    input.addEventListener("input", tell);
    tell();
  }
  const suggestions = (one.suggest ?? []).map(([text, value]) => h("button", {
    type: "button", class: "chip",
    onclick: () => { input.value = value ?? text; input.dispatchEvent(new Event("input", { bubbles: true })); },
  }, text));
  return h("div", { class: "field" },
    h("label", { for: id }, one.label, one.required || one.chosen ? null : h("span", { class: "muted" }, " ", t`(optional)`)),
    suggestions.length ? h("div", { class: "chips", role: "group", "aria-label": t`Suggestions for: ${one.label}` }, suggestions) : null,
    input, hint, note);
}

/** A form that stays unchanged while its work runs, and shows the server's sentence if the work fails. */
export function form({ fields, submit, onsubmit, cancel }) {
  const problem = h("p", { class: "problem", role: "alert", hidden: true });
  const send = h("button", { class: "primary", type: "submit" }, submit);
  const node = h("form", {
    onsubmit: async (event) => {
      event.preventDefault();
      send.disabled = true;
      problem.hidden = true;
      try {
        const values = Object.fromEntries(new FormData(node));
        if (values.who) remember("who", values.who);
        await onsubmit(values);
      } catch (error) {
        problem.textContent = error.message;
        problem.hidden = false;
      } finally {
        send.disabled = false;
      }
    },
  }, fields.map(field), problem, h("div", { class: "actions" }, send,
    cancel ? h("button", { type: "button", class: "quiet", onclick: cancel }, t`Cancel`) : null));
  return node;
}

export const whoField = () => ({ name: "who", label: t`Your name`, required: true, value: remembered("who"), autocomplete: "name" });

/** Opens a dialog with a form; returns true when its work is done. */
export function ask({ title, intro, ...rest }) {
  return new Promise((resolve) => {
    let done = false;
    const heading = `d${++number}`;
    const close = () => dialog.close();
    // "Back" closes a dialog, so that it never covers another page.
    history.pushState({ ...history.state, dialog: true }, "");
    addEventListener("popstate", close);
    const dialog = h("dialog", { "aria-labelledby": heading, onclose: () => {
      removeEventListener("popstate", close);
      if (history.state?.dialog) history.back();
      dialog.remove();
      resolve(done);
    } },
      h("h2", { id: heading }, title), intro ? h("p", { class: "muted" }, intro) : null,
      form({ ...rest, cancel: close, onsubmit: async (values) => { await rest.onsubmit(values); done = true; close(); } }));
    document.body.append(dialog);
    dialog.showModal();
    const first = [...dialog.querySelectorAll("input, select")].find((one) => !one.value) ?? dialog.querySelector(".primary");
    first.focus();
  });
}

/** Asks for a token, and `use` tests it. Returns true when it was accepted. */
export const askToken = (use) => ask({
  title: t`Log in`,
  intro: t`Enter the token that the operator of armwatch gave you. On the daemon's machine, it is in the file that serve.token_file names.`,
  fields: [
    { name: "token", label: t`Token`, type: "password", required: true },
    { name: "keep", label: t`Stay logged in`, chosen: true, options: [["", t`until the browser is closed`], ["yes", t`for 90 days`]] },
  ],
  submit: t`Log in`,
  onsubmit: use,
});
