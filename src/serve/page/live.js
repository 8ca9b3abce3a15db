import { headers } from "./api.js";
import { announce, logFault } from "./dom.js";
import { span } from "./format.js";
import { t } from "./messages.js";

// The server sends "alive" at once and then every 10 s. After three missing ones the connection counts as lost: a proxy
// that buffers answers forwards nothing, not even the status.
const SILENCE_MS = 30_000;
const PAUSE_MS = 1000;
// Interval of the page's own requests while there is no stream.
const POLL_MS = 10_000;

/** Follows the daemon's events, and calls `changed` at most once a second and never twice at a time. */
export function follow({ changed, note }) {
  let stream = null;
  let retry = 0;
  let timer = null;
  // When the present connection was asked for, and the last sign of life of any. Only the latter says that the page is live.
  let asked = 0;
  let heard = 0;
  let connected = null;
  let said = false;
  let fresh = Date.now();
  let due = false;
  let busy = false;
  let began = 0;

  const isSilent = () => Date.now() - heard > SILENCE_MS;

  function tell(now) {
    connected = now;
    words();
  }

  function lost() {
    if (!said) announce(t`The connection to the daemon is lost. Trying again.`);
    said = true;
    tell(false);
  }

  function words() {
    if (document.hidden) return;
    if (connected === null) note("", "");
    else if (connected) note("live", t`Live`);
    else note("lost", t`Not live; data is ${span((Date.now() - fresh) / 1000)} old`);
  }

  async function run() {
    if (busy || !due || document.hidden) return;
    busy = true;
    due = false;
    began = Date.now();
    try {
      await changed();
      fresh = Date.now();
    } catch (error) {
      logFault(error);
    }
    setTimeout(() => { busy = false; run(); }, Math.max(0, began + PAUSE_MS - Date.now()));
  }

  function take(block) {
    const kind = /^event: ?(.*)$/m.exec(block)?.[1];
    if (kind === "changed") {
      due = true;
      run();
    }
  }

  async function connect() {
    clearTimeout(timer);
    const own = new AbortController();
    const old = stream;
    stream = own;
    old?.abort();
    asked = Date.now();
    try {
      const answer = await fetch(new URL("v1/events", document.baseURI), {
        headers: { Accept: "text/event-stream", ...headers() }, signal: own.signal, cache: "no-store",
      });
      if (!answer.ok || !answer.body) throw new Error(String(answer.status));
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      heard = Date.now();
      if (connected === false) {
        due = true;
        run();
      }
      if (said) announce(t`Connected again.`);
      said = false;
      tell(true);
      retry = 0;
      const opened = heard;
      let text = "";
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        heard = Date.now();
        if (connected) fresh = busy ? fresh : Date.now();
        text += value.replaceAll("\r\n", "\n");
        const blocks = text.split("\n\n");
        text = blocks.pop();
        for (const block of blocks) take(block);
      }
      // The daemon ends a long stream regularly. The next one follows without a message.
      if (own === stream && Date.now() - opened > SILENCE_MS) {
        connect();
        return;
      }
      throw new Error("ended");
    } catch {
      if (own !== stream) return;
      lost();
      retry = Math.min(retry + 1, 5);
      timer = setTimeout(connect, Math.min(15_000, 500 * 2 ** retry));
    }
  }

  function pause() {
    const old = stream;
    stream = null;
    clearTimeout(timer);
    old?.abort();
  }

  setInterval(() => {
    if (stream && isSilent() && Date.now() - asked > SILENCE_MS) stream.abort();
    if (connected && isSilent() && !document.hidden) lost();
    if (connected !== false) return;
    words();
    if (Date.now() - began > POLL_MS) {
      due = true;
      run();
    }
  }, 1000);
  // A hidden tab would occupy one of the few connections that a browser opens to a host.
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) pause();
    else if (stream === null) {
      // Not announced: usually the daemon answers at once.
      if (connected && isSilent()) tell(false);
      due = true;
      run();
      connect();
    }
  });
  return { start: connect, reached() { fresh = Date.now(); }, reconnect() { pause(); connect(); } };
}
