// Browser test of the dashboard: node check.mjs BASE_URL OUT_FOLDER [--token TOKEN] [--act] [--budget MS] [--only NAME,...] [--pages NAME,...] [--export FILE]
// Looks at every page in light, dark and at phone width. --act also enters things, so it changes the database. A first
// paint that takes longer than --budget is a fault. --pages are those that are looked at.
// --export is a sound one for dropping.
import { mkdir, readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { basename } from "node:path";
import { parseArgs } from "node:util";
import puppeteer from "puppeteer-core";

const { values: options, positionals: [base = "http://127.0.0.1:8750/", out = "shots"] } = parseArgs({
  allowPositionals: true,
  options: { token: { type: "string" }, act: { type: "boolean" }, budget: { type: "string" }, only: { type: "string" }, export: { type: "string" }, pages: { type: "string" } },
});
const AXE = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const LOOKS = [["light", 1280, "light"], ["dark", 1280, "dark"], ["phone", 390, "light"], ["phone-dark", 320, "dark"]];
const SETTLE_MS = 60_000;

let failures = 0;
function check(holds, what, detail = "") {
  if (!holds) failures += 1;
  console.log(`${holds ? "ok  " : "FAIL"} ${what}${detail === "" ? "" : `: ${detail}`}`);
}

const ask = async (path) => {
  const answer = await fetch(new URL(path, base), { headers: options.token ? { Authorization: `Bearer ${options.token}` } : {} });
  if (!answer.ok) throw new Error(`${path}: ${answer.status} ${await answer.text()}`);
  return answer.json();
};
const fleet = await ask("v1/fleet");
const run = (await ask("v1/views/runs?status=complete&order=-run_id&limit=1")).rows[0];
const alarm = fleet.anomalies[0];
const pages = [["fleet", "#/"], ["wall", "#/wall"], ["alarms", "#/alarms?state=all"], ["ingest", "#/ingest"]];
if (fleet.robots.length) {
  const robot = `#/robot/${encodeURIComponent(alarm?.robot ?? fleet.robots[0].robot)}`;
  pages.push(["robot", robot], ["robot-runs", `${robot}?tab=runs`], ["robot-engineering", `${robot}?tab=engineering`]);
}
if (alarm) pages.push(["alarm", `#/alarm/${alarm.anomaly_id}`]);
const whole = fleet.anomalies.find((one) => one.joint === null);
if (whole) pages.push(["alarm-of-the-arm", `#/alarm/${whole.anomaly_id}`]);
if (run) pages.push(["run", `#/run/${run.run_id}`], ["cycle", `#/cycle/${run.run_id}/1`]);
pages.push(["robot-unknown", "#/robot/nobody"], ["run-unknown", "#/run/999999"], ["cycle-unknown", "#/cycle/999999/1"], ["alarm-unknown", "#/alarm/999999"], ["no-page", "#/nothing"]);

const browser = await puppeteer.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });

async function open(hash, { width = 1280, scheme = "light", token = options.token, language = "en" } = {}) {
  const context = await browser.createBrowserContext();
  const page = await context.newPage();
  page.problems = [];
  page.on("console", (message) => {
    if (["error", "warn"].includes(message.type())) page.problems.push(`${message.text()} ${message.location()?.url ?? ""}`);
  });
  page.on("pageerror", (error) => page.problems.push(error.message));
  page.on("request", (request) => { if (!/^(data|blob):/.test(request.url()) && !request.url().startsWith(new URL(base).origin)) page.problems.push(`external request ${request.url()}`); });
  await page.setViewport({ width, height: 900 });
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }, { name: "prefers-reduced-motion", value: "reduce" }]);
  await page.evaluateOnNewDocument((text, language) => {
    Object.defineProperty(navigator, "languages", { get: () => [language, "en"] });
    if (text && location.protocol !== "about:") sessionStorage.setItem("armwatch.token", text);
    new MutationObserver((_, observer) => {
      if (!document.querySelector(".robot-row, .empty")) return;
      observer.disconnect();
      requestAnimationFrame(() => setTimeout(() => { globalThis.usefulAt = performance.now(); }));
    }).observe(document, { childList: true, subtree: true });
  }, token ?? null, language);
  await page.goto(new URL(hash, base).href);
  return { page, context };
}

/** Waits until every part has its data. Parts that wait until they are seen are scrolled to, also where the page grows. */
async function settle(page) {
  await page.waitForSelector("main h1", { timeout: SETTLE_MS, polling: 50 });
  const loaded = await page.waitForFunction(() => {
    const waiting = [...document.querySelectorAll(".loading")].find((one) => one.offsetParent !== null);
    waiting?.scrollIntoView({ block: "center" });
    return !waiting;
  }, { timeout: SETTLE_MS, polling: 50 }).catch(() => null);
  if (!loaded) check(false, `${page.url()} has its data after ${SETTLE_MS / 1000} s`);
  await page.evaluate(() => scrollTo(0, 0));
  await new Promise((resolve) => setTimeout(resolve, 150));
}

/** Hides the page and shows it again: it reads its data anew and follows the events anew. */
async function wake(page) {
  await page.evaluate(() => {
    Object.defineProperty(document, "hidden", { value: true, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
    delete document.hidden;
    document.dispatchEvent(new Event("visibilitychange"));
  });
}

async function looksRight(name, hash) {
  for (const [look, width, scheme] of LOOKS) {
    const { page, context } = await open(hash, { width, scheme });
    await settle(page);
    await page.screenshot({ path: `${out}/${name}-${look}.png`, fullPage: true });
    const failed = await page.$$eval(".failure", (all) => all.map((one) => one.textContent));
    check(failed.length === 0, `${name} ${look} shows all its parts`, failed.join("; "));
    const torn = await page.evaluate(() => document.body.innerText.match(/.{0,20}\d %.{0,10}/g) ?? []);
    check(torn.length === 0, `${name} ${look} keeps numbers with their "%"`, torn.join("; "));
    const word = await page.$eval(".connection", (one) => [one.innerText, getComputedStyle(one).fontSize]);
    check(word[0] === "Live" && parseInt(word[1], 10) >= 12, `${name} ${look} says "Live"`, word.join(", "));
    const tooWide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    check(tooWide <= 0, `${name} ${look} fits the width`, tooWide > 0 ? `${tooWide} px too wide` : "");
    await page.evaluate(AXE);
    const found = await page.evaluate(() => globalThis.axe.run({ resultTypes: ["violations"] }).then((result) => result.violations.map((one) => `${one.id} x${one.nodes.length} (${one.nodes[0].target.join(" ")} ${one.nodes[0].failureSummary?.split("\n")[1] ?? ""})`)));
    check(found.length === 0, `${name} ${look} has no violations of axe`, found.join("; "));
    check(page.problems.length === 0, `${name} ${look} has a clean console`, page.problems.join("; "));
    await context.close();
  }
}

/** Pages with robots and alarms in every state. The daemon's answer is changed on its way to the page. */
async function everyState() {
  if (!alarm) return;
  const ofArm = { ...alarm, joint: null, kind: "payload", quantity: "load_kg", unit: "kg", value: 0.8, baseline: 0 };
  const states = ["open", "acknowledged", "shelved", "maintenance", "resolved", "false_alarm"];
  const cases = ["critical", "warning", "overdue", "unknown", "learning", "ok"].flatMap((status) => [
    [`all joints ${status} and an alarm of the arm`, (joint) => ({ ...joint, status }), [ofArm]],
    [`joint 1 ${status}, the others learning, and an alarm of the arm`, (joint) => ({ ...joint, status: joint.joint === 1 ? status : "learning", friction_index: null }), [ofArm]],
  ]).concat(states.map((state) => [`alarms ${state}`, (joint) => joint, [{ ...ofArm, state }, { ...alarm, state, provisional: 1, onset_at: null, score: null, threshold: null }]]));
  const rank = ["critical", "warning", "overdue", "unknown", "learning", "ok"];
  for (const [name, change, anomalies] of cases) {
    const robots = fleet.robots.map((one) => {
      const joints = one.joints.map(change);
      const worst = [...joints.map((joint) => joint.status), ...anomalies.filter((of) => of.robot === one.robot).map((of) => of.severity)];
      return { ...one, joints, status: rank.find((status) => worst.includes(status)) ?? "unknown", model: null, expected_by: "2020-01-01T00:00:00.000Z" };
    });
    const { page, context } = await open("about:blank");
    await page.setRequestInterception(true);
    page.on("request", (request) => (/\/v1\/fleet/.test(request.url())
      ? request.respond({ contentType: "application/json", body: JSON.stringify({ ...fleet, robots, anomalies }) }) : request.continue()));
    for (const hash of ["#/wall", "#/", `#/robot/${encodeURIComponent(alarm.robot)}`]) {
      await page.goto(new URL(hash, base).href);
      await settle(page);
      const failed = await page.$$eval(".failure", (all) => all.map((one) => one.textContent));
      check(failed.length === 0 && page.problems.length === 0, `${name}: ${hash} shows all its parts`, [...failed, ...page.problems].join("; "));
      page.problems.length = 0;
    }
    await context.close();
  }
}

const LANGUAGES = { it: "Parco", de: "Flotte", zh: "机队" };

/** All that a phone on a slow network loads until the fleet is shown and followed: files of one language, and data once. */
async function firstPage(language, fleetName) {
  const { page, context } = await open("about:blank", { language });
  const client = await page.createCDPSession();
  await client.send("Network.enable");
  const urls = new Map();
  const loaded = [];
  client.on("Network.requestWillBeSent", (event) => urls.set(event.requestId, event.request.url));
  client.on("Network.loadingFinished", (event) => loaded.push([urls.get(event.requestId), event.encodedDataLength]));
  await page.goto(new URL("#/", base).href);
  await page.waitForSelector(".robot-row, .empty", { timeout: SETTLE_MS, polling: 50 });
  await page.waitForSelector(".connection.live", { timeout: SETTLE_MS, polling: 50 });
  await new Promise((resolve) => setTimeout(resolve, 3000));
  const bytes = loaded.reduce((sum, [, size]) => sum + size, 0);
  check(bytes > 10_000 && bytes <= 60_000, `the first page in ${language} takes at most 60 kB`, `${bytes} bytes`);
  const whole = loaded.filter(([url, size]) => /v1[/]fleet/.test(url) && size > 1000);
  check(whole.length === 1, `the fleet is transferred once in ${language}`, loaded.filter(([url]) => /v1[/]fleet/.test(url)).map(([, size]) => size).join(", "));
  check(await page.$eval("h1", (one) => one.textContent) === fleetName, `the fleet is called ${fleetName}`);
  const text = await page.$eval("main", (one) => one.textContent);
  check(language === "en" || !/friction|smoothed|check /.test(text), `messages of alarms are in ${language}`, text.match(/.{20}(friction|smoothed|check ).{20}/)?.[0] ?? "");
  await context.close();
}

/** Pages in a language: no text of the table is left in English, and all fit a small phone. */
async function languages() {
  for (const language of Object.keys(LANGUAGES)) {
    const texts = await (await fetch(new URL(`assets/messages-${language}.js`, base))).text();
    const table = JSON.parse(texts.replace(/^export default /, "").replace(/;\s*$/, ""));
    const english = Object.keys(table).filter((key) => !key.includes("{") && key.length > 3 && table[key] !== key);
    for (const [name, hash] of pages) {
      if (options.pages && !options.pages.split(",").includes(name)) continue;
      const { page, context } = await open(hash, { width: 320, language });
      await settle(page);
      await page.screenshot({ path: `${out}/${name}-${language}.png`, fullPage: true });
      const tooWide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      check(tooWide <= 0, `${name} in ${language} fits 320 px`, tooWide > 0 ? `${tooWide} px too wide` : "");
      const left = await page.evaluate((keys) => {
        const known = new Set(keys);
        const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
        const found = new Set();
        while (walker.nextNode()) {
          const node = walker.currentNode;
          if (!node.parentElement.closest("noscript, code, [lang=en], select#parameter") && known.has(node.textContent.trim().replaceAll("\u00a0", " "))) found.add(node.textContent.trim());
        }
        return [...found];
      }, english);
      check(left.length === 0, `${name} has no English left in ${language}`, left.join("; "));
      check(await page.evaluate(() => document.documentElement.lang) === language, `${name} says that it is in ${language}`);
      await page.evaluate(AXE);
      const found = await page.evaluate(() => globalThis.axe.run({ resultTypes: ["violations"] }).then((result) => result.violations.map((one) => `${one.id} ${one.nodes[0].target.join(" ")}`)));
      check(found.length === 0, `${name} in ${language} has no violations of axe`, found.join("; "));
      check(page.problems.length === 0, `${name} in ${language} has a clean console`, page.problems.join("; "));
      await context.close();
    }
  }
  const { page, context } = await open("#/");
  await settle(page);
  await Promise.all([page.waitForNavigation(), page.select("#language", "de")]);
  await page.reload();
  await settle(page);
  check(await page.$eval("h1", (one) => one.textContent) === "Flotte", "the chosen language is remembered");
  if (alarm) {
    await page.goto(new URL(`#/alarm/${alarm.anomaly_id}`, base).href);
    await settle(page);
    const name = await page.$eval("h1", (one) => one.textContent.split(": ")[1]);
    await page.click('[data-key="shelve"]');
    await page.waitForSelector("dialog[open]");
    const title = await page.$eval("dialog h2", (one) => one.textContent);
    check(title.startsWith("Zurückstellen: ") && title.endsWith(name), "a title in German keeps the capital of the kind", title);
  }
  await context.close();
}

async function paintsSoon() {
  const times = [];
  for (let turn = 0; turn < 15; turn += 1) {
    // Chromium has work of its own after its start and after a page is closed
    await new Promise((resolve) => setTimeout(resolve, 500));
    const { page, context } = await open("#/");
    await page.waitForFunction(() => globalThis.usefulAt !== undefined, { timeout: SETTLE_MS, polling: 50 });
    times.push(await page.evaluate(() => globalThis.usefulAt));
    await context.close();
  }
  const { page, context } = await open("health");
  const empty = await page.evaluate(() => new Promise((resolve) => {
    new PerformanceObserver((list) => resolve(list.getEntries()[0].startTime)).observe({ type: "paint", buffered: true });
  }));
  await context.close();
  times.sort((a, b) => a - b);
  const median = times[(times.length - 1) / 2];
  const text = `median ${median.toFixed(0)} ms of ${times.map((one) => one.toFixed(0)).join(", ")}; ${(median / empty).toFixed(1)} times the ${empty.toFixed(0)} ms of an empty page`;
  check(!options.budget || median <= Number(options.budget), `first useful paint of ${fleet.robots.length} robots`, text);
}

async function keyboard() {
  const { page, context } = await open("#/");
  await settle(page);
  await page.keyboard.press("Tab");
  check(await page.evaluate(() => document.activeElement.classList.contains("skip")), "the first stop of the keyboard is the skip link");
  await page.keyboard.press("Enter");
  check(await page.evaluate(() => document.activeElement.id === "main"), "the skip link leads to the content");
  const visible = await page.evaluate(() => {
    const link = document.querySelector("main a, main input");
    if (!link) return true;
    link.focus({ focusVisible: true });
    return getComputedStyle(link).outlineStyle !== "none";
  });
  check(visible, "the focus is visible");
  await page.click("#theme");
  const theme = await page.evaluate(() => document.documentElement.dataset.theme);
  await page.reload();
  check(theme === "dark" && await page.evaluate(() => document.documentElement.dataset.theme) === "dark", "the theme is remembered");
  await context.close();
}

/** Alarms and robots have one order on all pages: the worst first. */
async function worstFirst() {
  const open_ = fleet.anomalies.filter((one) => one.state === "open" && one.severity !== "info");
  if (!open_.length) return;
  const { page, context } = await open("#/");
  await settle(page);
  const keys = (selector) => page.$$eval(selector, (all) => all.map((one) => one.dataset.key.replace(/^\D+/, "")));
  await page.$eval('[data-key="all-alarms"]', (one) => one.click()).catch(() => {});
  const first = (await keys(".alarms > li > .row-link")).filter((id) => open_.some((one) => String(one.anomaly_id) === id));
  const rows = first.map((id) => open_.find((one) => String(one.anomaly_id) === id));
  const size = (one) => [one.severity === "critical" ? 0 : 1, one.threshold > 0 ? -Math.abs(one.score) / one.threshold : 0];
  check(rows.every((one, index) => !index || size(rows[index - 1])[0] < size(one)[0] || (size(rows[index - 1])[0] === size(one)[0] && size(rows[index - 1])[1] <= size(one)[1])),
    "alarms of the fleet are sorted by severity and size", rows.map((one) => `${one.anomaly_id} ${size(one).join(" ")}`).join(", "));
  const robots = await page.$$eval(".robot-head h3 a", (all) => all.map((one) => one.textContent));
  const named = [...new Set(rows.map((one) => one.robot))];
  const status = (name) => fleet.robots.find((one) => one.robot === name).status;
  for (const of of ["critical", "warning"]) {
    const [ofAlarms, ofRobots] = [named, robots.filter((name) => named.includes(name))].map((all) => all.filter((name) => status(name) === of).join(", "));
    check(ofAlarms === ofRobots, `robots in ${of} stand in the order of their alarms`, ofRobots);
  }
  await page.evaluate(() => { location.hash = "#/alarms?state=open"; });
  await page.waitForSelector('tbody [data-key^="alarm"]', { timeout: SETTLE_MS, polling: 50 });
  const listed = (await keys('tbody [data-key^="alarm"]')).filter((id) => first.includes(id));
  check(listed.join() === first.join(), "the list of alarms has the same order", listed.join(", "));
  await context.close();
}

/** Two torques that one can follow, their difference and the velocity, of the joint that is chosen. */
async function cycleTorque() {
  if (!run) return;
  const { page, context } = await open(`#/run/${run.run_id}`);
  await settle(page);
  await page.locator('[data-key="cycle1"]').setTimeout(SETTLE_MS).click();
  await page.waitForSelector(".plot canvas, .empty", { timeout: SETTLE_MS, polling: 50 });
  await settle(page);
  const plots = await page.$$eval(".plot-box", (all) => all.map((one) => one.getAttribute("aria-label").split(".")[0]));
  check(plots.length === 3 && /^Torque, joint 1/.test(plots[0]) && /^Residual/.test(plots[1]) && /^Velocity/.test(plots[2]), "a cycle shows torque, residual and velocity", plots.join("; "));
  if (plots.length === 3) {
    await page.select("#joint", "2");
    await page.waitForFunction(() => document.querySelector(".plot-box")?.getAttribute("aria-label").includes("joint 2"), { timeout: SETTLE_MS, polling: 50 });
    check(await page.evaluate(() => location.hash.includes("joint=2")), "the address keeps the joint");
  }
  check(page.problems.length === 0, "a cycle leaves a clean console", page.problems.join("; "));
  await context.close();
}

async function noLeaks() {
  if (!alarm) return;
  const { page, context } = await open("#/");
  const sizes = [];
  for (let turn = 0; turn < 9; turn += 1) {
    for (const hash of [`#/robot/${encodeURIComponent(alarm.robot)}`, "#/"]) {
      await page.evaluate((to) => { location.hash = to; }, hash);
      for (let step = 0; step < 8; step += 1) {
        await page.evaluate(() => scrollBy(0, innerHeight));
        await new Promise((resolve) => setTimeout(resolve, 120));
      }
    }
    const client = await page.createCDPSession();
    await client.send("HeapProfiler.collectGarbage");
    await client.detach();
    const { JSHeapUsedSize, JSEventListeners, Nodes } = await page.metrics();
    sizes.push([JSHeapUsedSize / 1e6, JSEventListeners, Nodes]);
  }
  const [first, last] = [sizes[3], sizes.at(-1)];
  check(last[0] < first[0] * 1.15 + 0.5 && last[1] <= first[1] * 1.1 + 20, "pages leave nothing behind", `heap ${first[0].toFixed(1)} to ${last[0].toFixed(1)} MB, listeners ${first[1]} to ${last[1]}, nodes ${first[2]} to ${last[2]}`);
  await context.close();
}

async function connectionLost() {
  const { page, context } = await open("#/");
  await page.waitForFunction(() => document.querySelector(".connection")?.textContent === "Live", { timeout: SETTLE_MS, polling: 50 }).catch(() => {});
  check(await page.$eval(".connection", (one) => one.textContent) === "Live", "the page follows the daemon's events");
  const client = await page.createCDPSession();
  await client.send("Fetch.enable", { patterns: [{ urlPattern: "*/v1/*" }] });
  client.on("Fetch.requestPaused", ({ requestId }) => client.send("Fetch.failRequest", { requestId, errorReason: "ConnectionRefused" }).catch(() => {}));
  await wake(page);
  await new Promise((resolve) => setTimeout(resolve, 2500));
  const lost = await page.$eval(".connection", (one) => one.textContent);
  check(/^Not live; data is \d+ seconds? old$/.test(lost), "a lost connection is said", lost);
  check(await page.$(".robot-row, .empty") !== null, "what was shown stays");
  await page.screenshot({ path: `${out}/lost.png` });
  await client.send("Fetch.disable");
  await page.waitForFunction(() => document.querySelector(".connection")?.textContent === "Live", { timeout: 20_000, polling: 50 }).catch(() => {});
  check(await page.$eval(".connection", (one) => one.textContent) === "Live", "the page connects again");
  await context.close();
}

/** The daemon is there and answers nothing. Changing between tabs must not put off the note that the page is not live. */
async function connectionHangs() {
  const { page, context } = await open("#/");
  const connection = () => page.$eval(".connection", (one) => one.textContent);
  await page.waitForSelector(".connection.live", { timeout: SETTLE_MS, polling: 50 });
  const client = await page.createCDPSession();
  await client.send("Fetch.enable", { patterns: [{ urlPattern: "*/v1/*" }] });
  const hidden = (is) => page.evaluate((value) => {
    Object.defineProperty(document, "hidden", { value, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
  }, is);
  const began = Date.now();
  while (Date.now() - began < 45_000 && await connection() === "Live") {
    await hidden(true);
    await new Promise((resolve) => setTimeout(resolve, 1000));
    await hidden(false);
    await new Promise((resolve) => setTimeout(resolve, 2000));
  }
  check(/^Not live/.test(await connection()), "a silent daemon is said while tabs change", `${await connection()} after ${Math.round((Date.now() - began) / 1000)} s`);
  await client.send("Fetch.disable");
  await page.waitForSelector(".connection.live", { timeout: 40_000, polling: 50 });
  await hidden(true);
  await client.send("Fetch.enable", { patterns: [{ urlPattern: "*/v1/*" }] });
  await new Promise((resolve) => setTimeout(resolve, 31_000));
  await hidden(false);
  check(/^Not live/.test(await connection()), "a page that was hidden for long says at once that it is not live", await connection());
  for (const hash of ["#/alarms", `#/robot/${encodeURIComponent(fleet.robots[0]?.robot ?? "R01")}`]) {
    await page.evaluate((to) => { location.hash = to; }, hash);
    const said = await page.waitForFunction(() => [...document.querySelectorAll(".loading")].some((one) => one.offsetParent !== null && /^No answer/.test(one.textContent)), { timeout: 8000, polling: 100 }).catch(() => null);
    check(said !== null, `${hash} says that there is no answer yet`);
  }
  await page.screenshot({ path: `${out}/hangs.png` });
  await context.close();
}

async function staysOnChange() {
  if (!alarm) return;
  const { page, context } = await open(`#/alarm/${alarm.anomaly_id}`);
  await settle(page);
  await page.click('[data-key="shelve"]');
  await page.waitForSelector("dialog[open]");
  await page.type('dialog input[name="who"]', "A. Tester");
  await wake(page);
  await new Promise((resolve) => setTimeout(resolve, 1500));
  check(await page.$eval('dialog input[name="who"]', (one) => one.value) === "A. Tester", "an open dialog stays while the page is read again");
  await page.evaluate(AXE);
  const found = await page.evaluate(() => globalThis.axe.run({ resultTypes: ["violations"] }).then((result) => result.violations.map((one) => `${one.id} ${one.nodes[0].target.join(" ")}`)));
  check(found.length === 0, "dialog has no violations of axe", found.join("; "));
  await page.screenshot({ path: `${out}/dialog.png` });
  check(await page.$eval("dialog h2", (one) => one.textContent) === `Shelve: ${alarm.robot}, ${alarm.joint === null ? "whole arm" : `joint ${alarm.joint}`}, ${await page.$eval("h1", (one) => one.textContent.split(": ")[1])}`, "a dialog names its alarm");
  await page.keyboard.press("Escape");
  check(await page.$("dialog") === null, "Escape closes the dialog");
  const at = page.url();
  for (const name of ["acknowledge", "shelve", "resolve", "false-alarm", "work"]) {
    await page.click(`[data-key="${name}"]`);
    await page.waitForSelector("dialog[open]");
    await page.goBack();
    await page.waitForFunction(() => document.querySelector("dialog") === null, { timeout: SETTLE_MS, polling: 50 });
    check(page.url() === at, `Back closes the dialog of ${name} and leaves the page`);
  }
  await context.close();
}

async function enters() {
  const open_ = fleet.anomalies.find((one) => one.state === "open" && one.joint !== null);
  if (!open_) return;
  const { page, context } = await open("#/");
  await page.evaluate(() => localStorage.setItem("armwatch.who", "A. Tester"));
  let clicks = 0;
  const click = async (selector) => {
    await page.locator(selector).setTimeout(SETTLE_MS).click();
    clicks += 1;
  };
  await click(`[data-key="alarm${open_.anomaly_id}"]`);
  await click('[data-key="work"]');
  await click("dialog .chip");
  await click('dialog button[type="submit"]');
  await page.waitForFunction(() => document.querySelector("dialog") === null, { timeout: SETTLE_MS, polling: 50 });
  const log = (await ask(`v1/views/maintenance_log?robot=${encodeURIComponent(open_.robot)}&order=-maintenance_id&limit=1`)).rows[0];
  check(log?.what === "gearbox changed" && log.joint === open_.joint, `a gearbox change is entered with ${clicks} clicks`, JSON.stringify(log));
  check(clicks <= 5, "five clicks are enough");
  const said = await page.$eval(".toast:last-child", (one) => one.textContent);
  check(/evaluated again within a minute.*New baseline of joint \d: the first \d+ tests/.test(said), "the page says what follows from work", said);
  await click(".toast:last-child button");
  await page.waitForFunction(() => document.querySelector(".head-line b")?.textContent === "open", { timeout: SETTLE_MS, polling: 50 });
  const left = (await ask(`v1/views/maintenance_log?robot=${encodeURIComponent(open_.robot)}`)).rows;
  check(!left.some((one) => one.maintenance_id === log.maintenance_id), "the entry of work is undone");
  await context.close();
}

async function answers() {
  const open_ = fleet.anomalies.find((one) => one.state === "open" && one.joint !== null);
  if (!open_) return;
  const { page, context } = await open(`#/alarm/${open_.anomaly_id}`);
  await page.evaluate(() => localStorage.setItem("armwatch.who", "A. Tester"));
  const click = (selector) => page.locator(selector).setTimeout(SETTLE_MS).click();
  for (const name of ["acknowledge", "shelve", "resolve", "false-alarm"]) {
    await click(`[data-key="${name}"]`);
    await click('dialog button[type="submit"]');
    await page.waitForFunction(() => document.querySelector("dialog") === null, { timeout: SETTLE_MS, polling: 50 });
    const state = (await ask(`v1/views/anomalies?anomaly_id=${open_.anomaly_id}`)).rows[0]?.state;
    check(state === { acknowledge: "acknowledged", shelve: "shelved", resolve: "resolved", "false-alarm": "false_alarm" }[name], `${name} is done`, state);
    if (name === "shelve") {
      const until = (await ask(`v1/views/anomalies?anomaly_id=${open_.anomaly_id}`)).rows[0].shelved_until;
      const said = await page.waitForFunction((wanted) => document.querySelector(`.head-line time[datetime="${wanted}"]`)
        && document.querySelector(`.log time[datetime="${wanted}"]`), { timeout: 5000, polling: 50 }, until).then(() => true, () => false);
      check(said, "state and history say until when an alarm is shelved", until);
    }
    const notices = await page.$$eval(".toast", (all) => all.map((one) => one.textContent));
    check(notices.length === 1, `${name} leaves one notice`, notices.join("; "));
    if (name === "false-alarm") continue;
    // Undo gives the state of before, then the answer is given again for the next one.
    await click(".toast:last-child button");
    const before = { acknowledge: "open", shelve: "acknowledged", resolve: "shelved" }[name];
    await page.waitForFunction((wanted) => document.querySelector(".head-line b")?.textContent.startsWith(wanted), { timeout: SETTLE_MS, polling: 50 }, before);
    check((await ask(`v1/views/anomalies?anomaly_id=${open_.anomaly_id}`)).rows[0]?.state === before, `${name} is undone`);
    await click(`[data-key="${name}"]`);
    await click('dialog button[type="submit"]');
    await page.waitForFunction(() => document.querySelector("dialog") === null, { timeout: SETTLE_MS, polling: 50 });
  }
  await click('[data-key="reopen"]');
  await click('dialog button[type="submit"]');
  await page.waitForFunction(() => document.querySelector(".head-line b")?.textContent === "open", { timeout: SETTLE_MS, polling: 50 });
  check(true, "a false alarm is reopened");
  await page.evaluate((to) => { location.hash = to; }, `#/robot/${encodeURIComponent(open_.robot)}`);
  await settle(page);
  check((await page.$$(".toast")).length === 1, "the latest notice follows to another page");
  await page.goBack();
  await settle(page);
  const headers = { "Content-Type": "application/json", ...(options.token ? { Authorization: `Bearer ${options.token}` } : {}) };
  await fetch(new URL(`v1/anomalies/${open_.anomaly_id}/acknowledge`, base), { method: "POST", headers, body: JSON.stringify({ who: "B. Tester" }) });
  check(await page.waitForFunction(() => document.querySelector(".toast") === null, { timeout: 5000, polling: 50 }).then(() => true, () => false), "a notice goes when another person changes the state");
  await click('[data-key="reopen"]');
  await click('dialog button[type="submit"]');
  await page.waitForFunction(() => document.querySelector(".head-line b")?.textContent === "open", { timeout: SETTLE_MS, polling: 50 });
  await new Promise((resolve) => setTimeout(resolve, 1500));
  await page.screenshot({ path: `${out}/acted.png`, fullPage: true });
  check(page.problems.length === 0, "actions leave a clean console", page.problems.join("; "));
  await context.close();
}

/** Comments and persons of an alarm, a planned window, and a corrected entry of work. */
async function notes() {
  const of = (await ask("v1/views/anomalies?state=open&ended=0")).rows.find((one) => one.joint !== null);
  if (!of) return;
  const { page, context } = await open(`#/alarm/${of.anomaly_id}`);
  await page.evaluate(() => localStorage.setItem("armwatch.who", "A. Tester"));
  await page.reload();
  const click = (selector) => page.locator(selector).setTimeout(SETTLE_MS).click();
  const submit = async () => {
    await click('dialog button[type="submit"]');
    await page.waitForFunction(() => document.querySelector("dialog") === null, { timeout: SETTLE_MS, polling: 50 });
  };
  const row = async () => (await ask(`v1/views/anomalies?anomaly_id=${of.anomaly_id}`)).rows[0];
  const reads = (text) => page.waitForFunction((wanted) => document.querySelector("main").textContent.includes(wanted), { timeout: SETTLE_MS, polling: 50 }, text).then(() => true, () => false);
  await page.locator('form input[name="why"]').setTimeout(SETTLE_MS).fill("Fett ist bestellt");
  await click('form button[type="submit"]');
  check(await reads("“Fett ist bestellt”"), "a comment is in the history");
  await click('[data-key="assign"]');
  await page.locator('dialog input[name="to"]').fill("Lena");
  await submit();
  check(await page.$eval(".toast:last-child", (one) => one.textContent) === "Assigned to Lena.", "the notice names the person");
  check(await reads("Assigned to Lena") && (await row()).assignee === "Lena", "an alarm is assigned");
  await page.screenshot({ path: `${out}/notes.png`, fullPage: true });
  await page.evaluate(() => { location.hash = "#/alarms?person=Lena"; });
  await page.waitForSelector('tbody [data-key^="alarm"]', { timeout: SETTLE_MS, polling: 50 });
  check((await page.$$('tbody [data-key^="alarm"]')).length === 1, "alarms are filtered by person");
  await page.evaluate((to) => { location.hash = to; }, `#/robot/${encodeURIComponent(of.robot)}?tab=runs`);
  await click('[data-key="window"]');
  await click("dialog .chip");
  await page.screenshot({ path: `${out}/window.png` });
  await submit();
  check(await reads("Planned") && (await row()).state === "maintenance", "a planned window holds the alarm");
  await click('[data-key^="cancel/"]');
  await submit();
  await page.waitForFunction(() => document.querySelector('[data-key^="cancel/"]') === null, { timeout: SETTLE_MS, polling: 50 });
  check((await row()).state === "open", "without the window the alarm is open");
  const joints = fleet.robots.find((one) => one.robot === of.robot).joints.map((one) => one.joint);
  const place = () => page.$eval('form select[name="joint"]', (one) => one.value);
  check(await place() === String(of.joint), "the form suggests the only joint in alarm", await place());
  await page.goto(new URL(`#/robot/${encodeURIComponent(of.robot)}?tab=runs&joint=${joints.at(-1)}`, base).href);
  await page.waitForFunction((wanted) => document.querySelector('form select[name="joint"]')?.value === wanted, { timeout: SETTLE_MS, polling: 50 }, String(joints.at(-1)));
  check(true, "the form suggests the joint that the address names");
  const calm = fleet.robots.find((one) => !fleet.anomalies.some((anomaly) => anomaly.robot === one.robot));
  if (calm) {
    await page.evaluate((to) => { location.hash = to; }, `#/robot/${encodeURIComponent(calm.robot)}?tab=runs`);
    await page.waitForFunction((name) => document.querySelector("h1")?.textContent === name && document.querySelector('form select[name="joint"]'), { timeout: SETTLE_MS, polling: 50 }, calm.robot);
    check(await place() === "" && await page.$eval('form select[name="joint"]', (one) => one.required), "the form asks where work was done on a robot without alarms", await place());
  }
  await page.goto(new URL(`#/robot/${encodeURIComponent(of.robot)}?tab=runs`, base).href);
  await settle(page);
  await page.locator('form input[name="what"]').setTimeout(SETTLE_MS).fill("grease renewed");
  await click('form button[type="submit"]');
  await click('[data-key^="edit/"]');
  await page.locator('dialog input[name="what"]').fill("gearbox changed");
  await submit();
  check(await reads("Gearbox changed"), "an entry of work is corrected");
  await click('[data-key^="edit/"]');
  const tests = (await ask(`v1/views/runs?robot=${encodeURIComponent(of.robot)}&kind=test&status=complete&order=-started_at`)).rows;
  const shifted = new Date(Date.parse(tests[0].started_at) - new Date().getTimezoneOffset() * 60_000);
  await page.$eval('dialog input[name="at"]', (one, value) => { one.value = value; one.dispatchEvent(new Event("input")); }, shifted.toISOString().slice(0, 16));
  check(await page.waitForFunction(() => /counted for the new baseline: 1 test\./.test(document.querySelector("dialog").textContent), { timeout: 5000, polling: 50 }).then(() => true, () => false), "a test after the time of the work is said");
  await page.screenshot({ path: `${out}/later-test.png` });
  await page.keyboard.press("Escape");
  await click('[data-key^="delete/"]');
  await submit();
  await page.waitForFunction(() => document.querySelector('[data-key^="delete/"]') === null, { timeout: SETTLE_MS, polling: 50 });
  check(page.problems.length === 0, "notes leave a clean console", page.problems.join("; "));
  await context.close();
}

/** An export is dropped: explained, then sent. */
async function dropped() {
  if (!options.export) return;
  const { page, context } = await open("#/ingest");
  const reads = (text) => page.waitForFunction((wanted) => document.querySelector(".drop").textContent.includes(wanted), { timeout: SETTLE_MS, polling: 50 }, text).then(() => true, () => false);
  const runs = async () => (await ask("v1/views/runs")).rows.filter((one) => one.source_name === basename(options.export));
  const whole = await readFile(options.export, "utf8");
  const drop = (content) => page.$eval(".drop", (place, name, text) => {
    const dropped = new DataTransfer();
    dropped.items.add(new File([text], name));
    place.dispatchEvent(new DragEvent("drop", { dataTransfer: dropped, bubbles: true, cancelable: true }));
  }, basename(options.export), content);
  await page.waitForSelector(".drop", { timeout: SETTLE_MS, polling: 50 });
  await drop(whole.replace(/^(.*\n){99}/, "$&abc"));
  check(await reads("would go into quarantine") && await reads("line 100"), "a broken export is explained");
  await page.screenshot({ path: `${out}/dropped-broken.png`, fullPage: true });
  await drop(whole);
  check(await reads("can be stored"), "a sound export is explained");
  await page.evaluate(AXE);
  const found = await page.evaluate(() => globalThis.axe.run(".drop").then((result) => result.violations.map((one) => `${one.id} ${one.nodes[0].target.join(" ")}`)));
  check(found.length === 0, "the explanation has no violations of axe", found.join("; "));
  await page.screenshot({ path: `${out}/dropped.png`, fullPage: true });
  check((await runs()).length === 0, "an explained export is not stored");
  await page.locator('[data-key="send"]').setTimeout(SETTLE_MS).click();
  const until = Date.now() + SETTLE_MS;
  while (Date.now() < until && (await runs())[0]?.status !== "complete") await new Promise((resolve) => setTimeout(resolve, 250));
  check((await runs())[0]?.status === "complete", "a sent export is stored");
  check(page.problems.length === 0, "a dropped export leaves a clean console", page.problems.join("; "));
  await context.close();
}

async function tokenIsAsked() {
  if (!options.token) return;
  const { page, context } = await open("#/", { token: null });
  await page.waitForSelector("dialog input[name=token]", { timeout: SETTLE_MS, polling: 50 });
  await page.screenshot({ path: `${out}/token.png` });
  await page.type("dialog input[name=token]", "wrong");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.querySelector("dialog .problem")?.hidden === false, { timeout: SETTLE_MS, polling: 50 });
  check(/token/.test(await page.$eval("dialog .problem", (one) => one.textContent)), "a wrong token is named");
  await page.locator("dialog input[name=token]").fill(options.token);
  await page.keyboard.press("Enter");
  await page.waitForSelector(".robot-row, .empty", { timeout: SETTLE_MS, polling: 50 });
  check(true, "the token opens the page");
  await page.reload();
  await page.waitForSelector(".robot-row, .empty", { timeout: SETTLE_MS, polling: 50 });
  check(await page.$("dialog") === null && await page.evaluate(() => document.cookie) === "", "the log-in lasts, in a cookie that scripts cannot read");
  await page.click("#login");
  await page.waitForSelector("dialog input[name=token]", { timeout: SETTLE_MS, polling: 50 });
  check(true, "the log-out closes the page");
  await context.close();
}

/** A link may carry the token behind "#", as that of the demo does. */
async function linkCarriesToken() {
  if (!options.token) return;
  const { page, context } = await open(`#token=${options.token}`, { token: null });
  await page.waitForSelector(".robot-row, .empty", { timeout: SETTLE_MS, polling: 50 });
  check(await page.evaluate(() => location.hash) === "#/", "a token in the link opens the page and leaves the address");
  await context.close();
}

await mkdir(out, { recursive: true });
try {
  const checks = {
    looks: async () => { for (const [name, hash] of pages) if (!options.pages || options.pages.split(",").includes(name)) await looksRight(name, hash); },
    states: everyState, order: worstFirst, paint: paintsSoon, keyboard, lost: connectionLost, hangs: connectionHangs, change: staysOnChange, cycle: cycleTorque, leaks: noLeaks, token: tokenIsAsked, link: linkCarriesToken,
    first: async () => { for (const [language, name] of Object.entries({ en: "Fleet", ...LANGUAGES })) await firstPage(language, name); },
    languages, notes: options.act ? notes : () => {}, drop: dropped, work: options.act ? enters : () => {}, answers: options.act ? answers : () => {},
  };
  const only = options.only?.split(",");
  for (const [name, run_] of Object.entries(checks)) if (!only || only.includes(name)) await run_();
} finally {
  await browser.close();
}
console.log(failures ? `${failures} checks failed` : "all checks hold");
process.exitCode = failures ? 1 : 0;
