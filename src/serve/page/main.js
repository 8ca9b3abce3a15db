import { logIn, logOut, readRights, rights } from "./api.js";
import { h, keepLastNotice, logFault, remember, toast } from "./dom.js";
import { follow } from "./live.js";
import { language, LANGUAGES, t } from "./messages.js";
import { failed, loading } from "./part.js";

const PAGES = { "": "fleet", wall: "wall", alarms: "alarms", robot: "robot", alarm: "alarm", run: "run", cycle: "cycle", ingest: "ingest" };
const main = document.getElementById("main");
const scrolled = new Map();
let page = null;
let here = null;
let first = true;

function parse(hash) {
  const [path, query] = hash.replace(/^#\/?/, "").split("?");
  const [name, ...rest] = path.split("/");
  let argument = rest.join("/");
  try { argument = decodeURIComponent(argument); } catch { /* A stray % is taken as it stands. */ }
  return { name, argument, query: new URLSearchParams(query ?? "") };
}

/** Keeps choices of a page in the address, so that a link shows the same. */
function choose(changes) {
  const [path, query] = location.hash.split("?");
  const kept = new URLSearchParams(query ?? "");
  for (const [key, value] of Object.entries(changes)) {
    if (value === null || value === undefined || value === "") kept.delete(key);
    else kept.set(key, value);
  }
  const text = kept.toString();
  history.replaceState(history.state, "", `${path || "#/"}${text ? `?${text}` : ""}`);
  here = location.hash;
}

async function show() {
  if (location.hash !== "" && !location.hash.startsWith("#/")) return;
  const { name, argument, query } = parse(location.hash);
  const file = PAGES[name];
  page?.destroy();
  page = null;
  keepLastNotice();
  here = location.hash;
  for (const link of document.querySelectorAll(".bar nav a")) {
    if (link.dataset.page === file) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (!file) {
    document.title = `${t`There is no such page`} \u2013 armwatch`;
    main.replaceChildren(h("h1", { tabindex: -1 }, t`There is no such page`), h("p", null, h("a", { href: "#/" }, t`Show the fleet`)));
    return;
  }
  const at = here;
  const back = history.state?.seen === true;
  history.replaceState({ seen: true }, "");
  if (!first) main.replaceChildren(loading());
  try {
    const [{ mount }] = await Promise.all([import(`./${file}.js`), ready]);
    if (at !== here) return;
    page = mount({ main, argument, query, choose, title: (text) => { document.title = `${text} \u2013 armwatch`; } });
    const own = page;
    await own.refresh().then(() => stream.reached(), logFault);
    if (own !== page) return;
    if (back) scrollTo(0, scrolled.get(at) ?? 0);
    else scrollTo(0, 0);
    if (!first) main.querySelector("h1")?.focus({ preventScroll: true });
  } catch {
    const error = new Error(t`This page cannot be loaded: the daemon does not answer. Check that armwatch runs and that this device reaches it.`);
    main.replaceChildren(h("h1", { tabindex: -1 }, t`Not loaded`), failed(error, show));
  }
  first = false;
}

history.scrollRestoration = "manual";
addEventListener("scroll", () => { if (here !== null) scrolled.set(here, scrollY); }, { passive: true });
addEventListener("hashchange", show);
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  main.focus();
});

const note = document.getElementById("connection");
const banner = document.getElementById("stale");
const stream = follow({
  changed: async () => { await page?.refresh(); },
  note: (kind, text) => {
    if (note.textContent !== text) note.textContent = text;
    note.className = `connection ${kind}`;
    // Stale content must not look like the present state.
    document.body.classList.toggle("stale", kind === "lost");
    banner.hidden = kind !== "lost";
    const words = kind === "lost" ? t`${text}. The daemon does not answer, or a proxy holds back its events.` : "";
    if (banner.textContent !== words) banner.textContent = words;
  },
});

for (const node of document.querySelectorAll("[data-t]")) node.textContent = t(node.textContent);
const languages = document.getElementById("language");
languages.append(...Object.entries(LANGUAGES).map(([key, name]) => h("option", { value: key, lang: key, selected: key === language }, name)));
languages.addEventListener("change", () => {
  remember("language", languages.value);
  location.reload();
});

const theme = document.getElementById("theme");
const systemDark = matchMedia("(prefers-color-scheme: dark)");
const isDark = () => (document.documentElement.dataset.theme ?? (systemDark.matches ? "dark" : "light")) === "dark";
function nameTheme() {
  theme.textContent = isDark() ? t`Light` : t`Dark`;
  theme.setAttribute("aria-label", t`${theme.textContent} colours`);
  dispatchEvent(new Event("themechange"));
}
theme.addEventListener("click", () => {
  const next = isDark() ? "light" : "dark";
  document.documentElement.dataset.theme = next;
  remember("theme", next);
  nameTheme();
});
systemDark.addEventListener("change", nameTheme);
nameTheme();

const login = document.getElementById("login");
login.addEventListener("click", () => (rights?.loggedIn ? logOut() : logIn()).catch((error) => toast(error.message)));

async function about() {
  try {
    const session = await readRights();
    document.getElementById("about").textContent = t`armwatch ${session.version} · database ${session.database} · times in ${Intl.DateTimeFormat().resolvedOptions().timeZone}`;
    login.hidden = !rights.needsToken;
    login.textContent = rights.loggedIn ? t`Log out` : t`Log in`;
    login.title = rights.act ? t`You may act on alarms.` : rights.loggedIn ? t`This token may only look.` : "";
  } catch { /* The page shows that the daemon does not answer. */ }
}

addEventListener("rightschanged", async () => {
  stream.reconnect();
  await about();
  await show();
});
// Buttons show at once what this browser may do.
const ready = about();
// Other pages can be opened while the daemon does not answer. Their files come after all that the first page needs.
const OTHERS_AFTER_MS = 10_000;
show().finally(() => {
  stream.start();
  setTimeout(async () => {
    for (const name of new Set(Object.values(PAGES))) await import(`./${name}.js`).catch(() => {});
  }, OTHERS_AFTER_MS);
});
