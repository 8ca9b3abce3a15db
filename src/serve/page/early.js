// A classic script in the head: it runs before the first paint and before the modules are there.
try {
  const kept = localStorage.getItem("armwatch.theme");
  if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
} catch {
  // Without storage the system's setting holds.
}
// The page's language: the choice of before, else the first one of the browser that there is. messages.js loads its texts.
const languages = [...navigator.languages];
try { languages.unshift(localStorage.getItem("armwatch.language") ?? ""); } catch { /* Without storage nothing was chosen. */ }
const language = languages.map((one) => one.slice(0, 2)).find((one) => ["en", "it", "de", "zh"].includes(one)) ?? "en";
document.documentElement.lang = language;
if (language !== "en") document.head.append(Object.assign(document.createElement("link"), { rel: "modulepreload", href: `assets/messages-${language}.js` }));
// A link may carry the token behind "#", which is not sent to any server. It leaves the address at once.
const carried = /^#token=([!-~]+)$/.exec(location.hash);
if (carried) {
  try { sessionStorage.setItem("armwatch.token", carried[1]); } catch { /* Without storage the page asks for it. */ }
  history.replaceState(null, "", `${location.pathname}#/`);
}
// The first data are asked for while the modules are still on their way. api.js takes the answers.
let token = null;
try { token = sessionStorage.getItem("armwatch.token"); } catch { /* Without storage the page asks for the token. */ }
globalThis.early = {};
for (const path of /^(#\/?(\?.*)?)?$/.test(location.hash) ? ["v1/session", language === "en" ? "v1/fleet" : `v1/fleet?language=${language}`] : ["v1/session"]) {
  globalThis.early[path] = fetch(path, token ? { headers: { Authorization: `Bearer ${token}` } } : {});
  globalThis.early[path].catch(() => {});
}
