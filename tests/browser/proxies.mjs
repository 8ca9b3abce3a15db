// The checks of tests/browser/proxies: node proxies.mjs TOKEN DAEMON_PID NGINX_PID BASE_URL...
import { execFileSync } from "node:child_process";
import puppeteer from "puppeteer-core";

const [token, daemon, nginx, ...bases] = process.argv.slice(2);
const LIVE_MS = 5000;
const LOST_MS = 35_000;

let failures = 0;
function check(holds, what, detail = "") {
  if (!holds) failures += 1;
  console.log(`${holds ? "ok  " : "FAIL"} ${what}${detail === "" ? "" : `: ${detail}`}`);
}

const browser = await puppeteer.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"], acceptInsecureCerts: true });

async function open(base) {
  const page = await (await browser.createBrowserContext()).newPage();
  await page.evaluateOnNewDocument(() => localStorage.setItem("armwatch.who", "A. Tester"));
  await page.goto(base);
  await page.locator("dialog input[name=token]").fill(token);
  await page.click("dialog button[type=submit]");
  await page.waitForSelector(".robot-row", { timeout: 20_000 });
  return page;
}

/** Milliseconds until the page shows this; null if it does not within `most`. */
async function until(page, wanted, most) {
  const began = Date.now();
  const found = await page.waitForFunction(wanted, { timeout: most, polling: 100 }).catch(() => null);
  return found ? Date.now() - began : null;
}

const isLive = () => document.querySelector("#connection").textContent === "Live";
const isStale = () => !document.querySelector("#stale").hidden && document.body.classList.contains("stale");

for (const base of bases) {
  const page = await open(base);
  const live = await until(page, isLive, LIVE_MS);
  check(live !== null, `${base} is live`, `${live} ms`);
  const before = await page.$eval(".alarm-row a", (one) => one.hash);
  await page.click(".alarm-row a");
  await page.locator('[data-key="acknowledge"]').click();
  await page.click("dialog button[type=submit]");
  const done = await until(page, () => /State: acknowledged/.test(document.querySelector(".head-line")?.textContent ?? ""), LIVE_MS);
  check(done !== null, `${base} answers an alarm`, `${before}, ${done} ms`);
  await page.locator(".toast button").click();
  const undone = await until(page, () => /State: open/.test(document.querySelector(".head-line")?.textContent ?? ""), LIVE_MS);
  check(undone !== null, `${base} undoes the answer`, `${undone} ms`);
  await page.click("#login");
  check(await until(page, () => document.querySelector("dialog input[name=token]") !== null, LIVE_MS) !== null, `${base} asks for the token after the log-out`);
  await page.close();
}

async function loses(what, pid, base) {
  const page = await open(base);
  await until(page, isLive, LIVE_MS);
  execFileSync("kill", ["-STOP", pid]);
  const lost = await until(page, isStale, LOST_MS);
  check(lost !== null, `${what}: the page says that it is not live`, lost === null ? "" : `${(lost / 1000).toFixed(1)} s`);
  execFileSync("kill", ["-CONT", pid]);
  const back = await until(page, isLive, LOST_MS);
  check(back !== null, `${what}: the page is live again`, back === null ? "" : `${(back / 1000).toFixed(1)} s`);
  await page.close();
}

/** The daemon freezes while a person changes between tabs and pages. */
async function losesWhileTabsChange(base) {
  const page = await open(base);
  await until(page, isLive, LIVE_MS);
  const hidden = (is) => page.evaluate((value) => {
    Object.defineProperty(document, "hidden", { value, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
  }, is);
  execFileSync("kill", ["-STOP", daemon]);
  const began = Date.now();
  let lost = null;
  while (lost === null && Date.now() - began < LOST_MS) {
    await hidden(true);
    await hidden(false);
    lost = await until(page, isStale, 3000) === null ? null : Date.now() - began;
  }
  check(lost !== null, "the daemon freezes while tabs change: the page says that it is not live", lost === null ? "" : `${(lost / 1000).toFixed(1)} s`);
  await page.click('nav [data-page="alarms"]');
  const said = await until(page, () => /No answer from the daemon/.test(document.querySelector("main").textContent), 8000);
  check(said !== null, "the daemon freezes: another page says that there is no answer", said === null ? "" : `${(said / 1000).toFixed(1)} s`);
  execFileSync("kill", ["-CONT", daemon]);
  const back = await until(page, () => document.querySelector("main table") !== null, LOST_MS);
  check(back !== null, "the page shows its data when the daemon goes on", back === null ? "" : `${(back / 1000).toFixed(1)} s`);
  await page.close();
}
await loses("the daemon freezes", daemon, bases[0]);
await losesWhileTabsChange(bases[0]);
await loses("the proxy passes nothing on", String(Number(nginx)), bases[0]);

const page = await open(bases[0]);
await until(page, isLive, LIVE_MS);
execFileSync("kill", [daemon]);
const lost = await until(page, isStale, LOST_MS);
check(lost !== null, "the daemon ends: the page says that it is not live", lost === null ? "" : `${(lost / 1000).toFixed(1)} s`);
await page.click(".robot-row h3 a");
await page.waitForFunction(() => document.querySelector("main h1") !== null, { timeout: 10_000 });
const said = await page.$eval("main", (one) => one.textContent);
check(/does not answer/.test(said) && !/module/.test(said), "the daemon ends: a link explains itself", said.slice(0, 120));
await browser.close();
console.log(failures ? `${failures} checks failed` : "all checks hold");
process.exitCode = failures ? 1 : 0;
