import { askToken } from "./dialog.js";
import { checkNotices } from "./dom.js";
import { language, t } from "./messages.js";

const KEY = "armwatch.token";
let refused = false;
let asking = null;

// The token of a link, for this tab. A log-in gives a cookie, which scripts cannot read.
function token() {
  try { return sessionStorage.getItem(KEY); } catch { return null; }
}

function forget() {
  try { sessionStorage.removeItem(KEY); } catch { /* Nothing was kept. */ }
}

/** An answer that is not what was asked for, with the server's sentence. */
export class Failure extends Error {
  constructor(sentence, status) {
    super(sentence);
    this.status = status;
  }
}

export function headers() {
  const held = token();
  return held ? { Authorization: `Bearer ${held}` } : {};
}

async function failure(answer) {
  let sentence = "";
  try { sentence = (await answer.json()).error; } catch { /* Not JSON: the sentence below. */ }
  return new Failure(sentence || t`The daemon answered ${answer.status} ${answer.statusText}.`, answer.status);
}

async function send(path, options) {
  try {
    const early = options.method ? null : globalThis.early?.[path];
    if (early) {
      delete globalThis.early[path];
      return await early;
    }
    return await fetch(new URL(path, document.baseURI), { ...options, headers: { ...options.headers, ...headers() } });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Failure(t`The daemon does not answer. Check that armwatch runs and that this device reaches it.`, 0);
  }
}

async function answered(path, options) {
  let answer = await send(path, options);
  while (answer.status === 401) {
    const sentence = (await failure(answer)).message;
    if (refused) throw new Failure(t`A token is needed: ${sentence}`, 401);
    if (!await logIn()) {
      refused = true;
      throw new Failure(t`The daemon needs a token. Press “Try again” to enter it.`, 401);
    }
    answer = await send(path, options);
  }
  if (!answer.ok) throw await failure(answer);
  return answer;
}

async function request(path, options = {}) {
  const answer = await answered(path, options);
  return answer.status === 204 ? null : answer.json();
}

/** The bytes of a file. */
export const getFile = async (path) => (await answered(path, {})).blob();

/** What this browser may do; null until the daemon has said so. */
export let rights = null;

export async function readRights() {
  const session = await get("v1/session");
  rights = { act: session.may_act, upload: session.may_upload, loggedIn: session.needs_token && session.may_read, needsToken: session.needs_token };
  return session;
}

/** Exchanges a token for a cookie. Gives false where the person cancels. */
export function logIn() {
  asking ??= askToken(async (values) => {
    forget();
    const answer = await send("v1/session", { method: "POST", body: JSON.stringify({ token: values.token, keep: values.keep === "yes" }), headers: { "Content-Type": "application/json" } });
    if (!answer.ok) throw await failure(answer);
    refused = false;
  }).then((done) => {
    if (done) dispatchEvent(new Event("rightschanged"));
    return done;
  }).finally(() => { asking = null; });
  return asking;
}

export async function logOut() {
  forget();
  await request("v1/session", { method: "DELETE" });
  dispatchEvent(new Event("rightschanged"));
}

export function mayAskAgain() {
  refused = false;
}

export const get = (path, signal) => request(path, { signal });

/** The fleet at a glance, with messages in the language of the page. */
export async function fleet(signal) {
  const asked = Date.now();
  const answer = await get(language === "en" ? "v1/fleet" : `v1/fleet?language=${language}`, signal);
  checkNotices(answer.anomalies, asked);
  return answer;
}

/** Rows of an SQL view. A view that an older daemon does not have gives no rows. */
export async function view(name, query = {}, signal) {
  const wanted = new URLSearchParams();
  for (const [key, value] of Object.entries(query)) wanted.set(key, value === null ? "null" : value);
  if (language !== "en") wanted.set("language", language);
  const text = wanted.toString();
  const asked = Date.now();
  try {
    const answer = await get(`v1/views/${name}${text ? `?${text}` : ""}`, signal);
    if (name === "anomalies") checkNotices(answer.rows, asked);
    return answer;
  } catch (error) {
    if (error.status !== 404) throw error;
    return { view: name, rows: [], truncated: false, missing: true };
  }
}

function write(method, path, body) {
  mayAskAgain();
  return request(path, { method, body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
}

/** Sends the bytes of a file; gives the daemon's answer. */
export function sendFile(path, file) {
  mayAskAgain();
  return request(path, { method: "PUT", body: file, headers: { "Content-Type": "application/octet-stream" } });
}

export const post = (path, body) => write("POST", path, body);
export const put = (path, body) => write("PUT", path, body);

export function remove(path) {
  mayAskAgain();
  return request(path, { method: "DELETE" });
}
