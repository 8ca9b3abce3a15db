// Checks the dashboard's files without a browser: lint.mjs REPOSITORY. A browser reports a name that no module declares only
// when it reaches the line. Pages must recognise what to do among the clauses of a message in each language.
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { ESLint } from "eslint";
import globals from "globals";

const repository = process.argv[2];
const page = join(repository, "src/serve/page");
const linter = new ESLint({
  cwd: page,
  overrideConfigFile: true,
  overrideConfig: [{
    files: ["*.js"],
    ignores: ["uPlot*"],
    languageOptions: { globals: globals.browser },
    rules: { "no-undef": "error", "no-unused-vars": "error" },
  }],
});
const results = await linter.lintFiles(["*.js"]);
const faults = results.flatMap((file) => file.messages.map((one) => `${file.filePath}:${one.line}: ${one.message}`));
if (results.length < 20) faults.push(`only ${results.length} modules were found`);

const advice = new RegExp(/const ADVICE = \/(.*)\/;/.exec(await readFile(join(page, "quantities.js"), "utf8"))[1]);
const findings = (await readFile(join(repository, "src/language/findings.tsv"), "utf8")).trim().split("\n").slice(1).map((line) => line.split("\t"));
const advising = findings.filter((row) => advice.test(row[0]));
if (advising.length < 20) faults.push(`findings.tsv: only ${advising.length} clauses say what to do`);
for (const row of findings) for (const text of row) if (advice.test(text) !== advice.test(row[0])) faults.push(`findings.tsv: what to do is not recognised alike in "${row[0]}" and "${text}"`);

for (const one of faults) console.log(`FAIL ${one}`);
if (!faults.length) console.log(`ok   ${results.length} modules declare all their names, and ${advising.length} clauses say what to do`);
process.exitCode = faults.length ? 1 : 0;
