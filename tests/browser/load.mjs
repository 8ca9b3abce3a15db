// A daemon under load: node load.mjs ARMWATCH FOLDER [--minutes N] [--robots N] [--rate HZ]. FOLDER holds armwatch.db.
// Called by tests/browser/load.
import { execFileSync, spawn } from "node:child_process";
import { closeSync, mkdirSync, openSync, readFileSync, readdirSync, renameSync, writeFileSync, writeSync } from "node:fs";
import { createServer } from "node:net";
import { join } from "node:path";
import { performance } from "node:perf_hooks";
import { parseArgs } from "node:util";
import puppeteer from "puppeteer-core";

const { values: options, positionals: [armwatch, folder] } = parseArgs({
  allowPositionals: true,
  options: { minutes: { type: "string", default: "6" }, robots: { type: "string", default: "4" }, rate: { type: "string", default: "250" } },
});
const minutes = Number(options.minutes);
const rateHz = Number(options.rate);
const names = Array.from({ length: Number(options.robots) }, (_, index) => `Stream${index + 1}`);
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const quantile = (values, share) => values.length ? [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(share * values.length))] : NaN;

// exports that the robots will write; they begin at different positions of a cycle
const inbox = join(folder, "inbox");
mkdirSync(inbox);
const exports_ = names.map((name, index) => {
  const out = join(folder, name);
  const cycles = Math.max(2, Math.ceil(minutes / 2.2));
  execFileSync(armwatch, ["simulate", "-o", out, "--name", name, "--seed", String(index + 7), "--runs", "1", "--cycles", String(cycles),
    "--rate-hz", options.rate, "--warming-s", String(10 + 7 * index)], { stdio: "ignore" });
  const file = readdirSync(out).find((one) => one.endsWith(".csv"));
  const [head, ...rows] = readFileSync(join(out, file), "utf8").trimEnd().split("\n");
  const column = head.split(",").indexOf("cycle");
  return { name, file, head, rows, cycleOf: rows.map((row) => Number(row.split(",", column + 1)[column])), next: 0, ended: new Map() };
});

const port = await new Promise((resolve) => {
  const server = createServer().listen(0, "127.0.0.1", () => { const { port: free } = server.address(); server.close(() => resolve(free)); });
});
const config = join(folder, "config");
execFileSync(armwatch, ["config", "init", config], { stdio: "ignore" });
writeFileSync(join(folder, "armwatch.toml"), `database = "${folder}/armwatch.db"
[watch]
folders = ["${inbox}"]
[serve]
listen = "127.0.0.1:${port}"
[[robot]]
name = "*"
description = "${config}/robots/er3a.toml"
layout = "${config}/exports/native.toml"
`);
const daemon = spawn(armwatch, ["run", "--config", join(folder, "armwatch.toml")], { cwd: folder, stdio: ["ignore", "ignore", openSync(join(folder, "daemon.log"), "w")] });
process.on("exit", () => daemon.kill());
const base = `http://127.0.0.1:${port}/`;
for (let turn = 0; ; turn += 1) {
  if (await fetch(`${base}ready`).then((answer) => answer.ok, () => false)) break;
  if (turn > 150 || daemon.exitCode !== null) throw new Error(readFileSync(join(folder, "daemon.log"), "utf8"));
  await pause(200);
}
const residentMb = () => Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${daemon.pid}/status`, "utf8"))[1]) / 1024;
const cpuSeconds = () => readFileSync(`/proc/${daemon.pid}/stat`, "utf8").split(") ")[1].split(" ").slice(11, 13).reduce((sum, one) => sum + Number(one), 0) / 100;

const browser = await puppeteer.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
const pages = [];
for (const hash of ["#/", `#/robot/${names[0]}`]) {
  const context = await browser.createBrowserContext();
  const page = await context.newPage();
  page.problems = [];
  page.on("pageerror", (error) => page.problems.push(error.message));
  await page.goto(base + hash);
  pages.push({ hash, page, heapsMb: [] });
}

const begun = performance.now();
const running = () => performance.now() - begun < minutes * 60_000;

/** Writes rows as time passes, ten times a second. */
async function stream(one) {
  const path = join(inbox, one.file);
  const handle = openSync(`${path}.part`, "w");
  writeSync(handle, `${one.head}\n`);
  renameSync(`${path}.part`, path);
  while (running() && one.next < one.rows.length) {
    const until = Math.min(one.rows.length, Math.floor(((performance.now() - begun) / 1000) * rateHz));
    if (until > one.next) {
      writeSync(handle, `${one.rows.slice(one.next, until).join("\n")}\n`);
      for (let row = Math.max(1, one.next); row < until; row += 1) {
        if (one.cycleOf[row] !== one.cycleOf[row - 1]) one.ended.set(one.cycleOf[row - 1], performance.now());
      }
      one.next = until;
    }
    await pause(100);
  }
  closeSync(handle);
}

const times = new Map();
async function ask(path) {
  const from = performance.now();
  const answer = await fetch(base + path);
  const body = await answer.text();
  if (!answer.ok) throw new Error(`${path}: ${answer.status} ${body}`);
  if (!times.has(path)) times.set(path, []);
  times.get(path).push(performance.now() - from);
  return JSON.parse(body);
}

const delays = [];
/** Looks for the cycles that have ended, as soon as the API has them. */
async function watchCycles() {
  const seen = new Set();
  while (running()) {
    const { rows } = await ask("v1/views/runs?status=streaming");
    for (const one of exports_) {
      const cycles = rows.find((run) => run.robot === one.name)?.cycles ?? 0;
      for (const [cycle, at] of one.ended) {
        if (cycle <= cycles && !seen.has(`${one.name}/${cycle}`)) {
          seen.add(`${one.name}/${cycle}`);
          delays.push((performance.now() - at) / 1000);
        }
      }
    }
    await pause(50);
  }
}

async function askInTurn() {
  const paths = ["v1/fleet", "v1/views/anomalies?limit=200", `v1/views/friction_index?robot=${names[0]}&limit=1000`,
    `v1/views/cycles?robot=${names[0]}&order=-cycle&limit=50`, "v1/views/fleet_health", "v1/views/quarantine"];
  for (let turn = 0; running(); turn += 1) {
    await ask(paths[turn % paths.length]);
    await pause(200);
  }
}

const residentAt = [];
async function weigh() {
  for (let minute = 0; running(); minute += 1) {
    residentAt.push(residentMb());
    for (const one of pages) {
      const client = await one.page.createCDPSession();
      await client.send("HeapProfiler.collectGarbage");
      await client.detach();
      one.heapsMb.push((await one.page.metrics()).JSHeapUsedSize / 1e6);
    }
    await pause(60_000);
  }
}

const cpuBefore = cpuSeconds();
await Promise.all([...exports_.map(stream), watchCycles(), askInTurn(), weigh()]);
const cpu = cpuSeconds() - cpuBefore;

console.log(`${names.length} robots at ${rateHz} Hz, 2 browsers, ${minutes} min; the daemon used ${(cpu / (minutes * 60) * 100).toFixed(0)} % of one core`);
const all = [...times.values()].flat();
const line = (name, values) => console.log(`${name.padEnd(56)} ${String(values.length).padStart(6)} ${[0.5, 0.9, 0.99, 1].map((share) => quantile(values, share).toFixed(1).padStart(7)).join("")}`);
console.log(`\n${"answers of the API, ms".padEnd(56)}  count    50 %   90 %   99 %    max`);
for (const [path, values] of times) line(path, values);
line("together", all);
console.log(`\nseconds from the first row of the next cycle to the cycle in SQL: ${delays.length} cycles, median ${quantile(delays, 0.5).toFixed(2)}, max ${Math.max(...delays).toFixed(2)}`);
console.log(`memory of the daemon, MB, each minute: ${residentAt.map((one) => one.toFixed(0)).join(" ")}`);
for (const { hash, heapsMb, page } of pages) console.log(`heap of the page ${hash}, MB, each minute: ${heapsMb.map((one) => one.toFixed(1)).join(" ")}${page.problems.length ? `; errors: ${page.problems.join("; ")}` : ""}`);
await browser.close();
const ended = exports_.reduce((sum, one) => sum + one.ended.size, 0);
const holds = quantile(all, 0.99) < 100 && Math.max(...delays) < 1 && delays.length >= ended - names.length && pages.every((one) => one.page.problems.length === 0);
console.log(holds ? "99 % of the answers came within 100 ms, and each cycle within a second" : "an aim is missed: 99 % of the answers within 100 ms, each cycle within a second, no error in a page");
process.exit(holds ? 0 : 1);
