// Checks of the dashboard's files that need no browser: node names.mjs. Finds names that no module declares, which a browser
// reports only when it reaches the line, and imports that do not exist or are not used. Pages must recognise what to do
// among the clauses of a message in each language.
import { readdir, readFile } from "node:fs/promises";

const folder = new URL("../../src/serve/page/", import.meta.url);
// What src/serve/page.rs makes.
const MADE = { "lists.js": ["QUANTITIES", "KINDS"] };
const WORDS = new Set(`async await break case catch class const continue default delete do else export extends false finally for from function if import
  in instanceof let new null of return super switch this throw true try typeof undefined var void while yield as`.split(/\s+/));
const GLOBALS = new Set(`AbortController Array Blob Boolean CSS Date Error Event Float64Array FormData Infinity IntersectionObserver Intl
  JSON Map Math Node Number Object Promise ResizeObserver Set String TextDecoderStream URL URLSearchParams WeakSet addEventListener clearTimeout
  console decodeURIComponent devicePixelRatio dispatchEvent document encodeURIComponent fetch getComputedStyle globalThis history localStorage location
  matchMedia navigator parseInt removeEventListener requestIdleCallback scrollTo scrollY sessionStorage setInterval setTimeout
  window`.split(/\s+/));
const NO_PARAMETERS = new Set(["if", "for", "while", "switch", "with"]);
const isName = (text) => /^[\p{L}_$][\p{L}\p{N}_$]*$/u.test(text);

/** Names, numbers as "0", texts as "''" and signs. The values of a template follow it in brackets. */
function tokens(code) {
  const found = [];
  let at = 0;
  const afterValue = () => {
    const last = found.at(-1);
    return last !== undefined && (last === ")" || last === "]" || last === "}" || last === "''" || last === "0" || (isName(last) && !["return", "typeof", "case", "of", "in", "await"].includes(last)));
  };
  function template() {
    found.push("''");
    for (at += 1; code[at] !== "`"; at += 1) {
      if (code[at] === "\\") at += 1;
      else if (code.startsWith("${", at)) {
        at += 2;
        found.push(";", "(");
        read("}");
        found.push(")", ";");
      }
    }
    at += 1;
    found.push("''");
  }
  function read(end) {
    let depth = 0;
    while (at < code.length) {
      const rest = code.slice(at, at + 200);
      const plain = /^(\s+|\/\/.*|\/\*[^]*?\*\/)/.exec(rest) ?? (rest.startsWith("/*") ? [code.slice(at, code.indexOf("*/", at) + 2)] : null);
      const name = /^[\p{L}_$][\p{L}\p{N}_$]*/u.exec(rest);
      const number = /^\d[\w.]*/.exec(rest);
      const text = /^(["'])(?:\\[^]|(?!\1)[^\\])*\1/.exec(code.slice(at, at + 2000));
      const pattern = rest[0] === "/" && !afterValue() ? /^\/(?:\\.|\[(?:\\.|[^\]\\])*\]|[^/\\[])+\/[a-z]*/.exec(rest) : null;
      if (plain) at += plain[0].length;
      else if (rest[0] === "`") template();
      else if (text || number || pattern) {
        found.push(number ? "0" : "''");
        at += (text ?? number ?? pattern)[0].length;
      } else if (name) {
        found.push(name[0]);
        at += name[0].length;
      } else {
        if (rest[0] === end && depth === 0) return;
        depth += { "{": 1, "}": -1 }[rest[0]] ?? 0;
        const sign = /^(\?\?=|\.\.\.|=>|\?\.(?!\d)|===|!==|\?\?|\|\||&&|==|!=|<=|>=)/.exec(rest)?.[0] ?? rest[0];
        found.push(sign);
        at += sign.length;
      }
    }
  }
  read(null);
  return found;
}

/** Names that a pattern binds, such as `{ a, b: [c] = 1 }`: no keys and no defaults. */
function bound(pattern) {
  const names = [];
  let depth = 0;
  let valueAt = null;
  pattern.forEach((one, index) => {
    if ("([{".includes(one)) depth += 1;
    if (valueAt !== null && (depth < valueAt || (depth === valueAt && (one === "," || ")]}".includes(one))))) valueAt = null;
    if (")]}".includes(one)) depth -= 1;
    if (one === "=" && valueAt === null) valueAt = depth;
    if (valueAt === null && isName(one) && !WORDS.has(one) && pattern[index + 1] !== ":") names.push(one);
  });
  return names;
}

const closing = (list, from) => {
  for (let at = from, depth = 0; at < list.length; at += 1) {
    depth += "([{".includes(list[at]) ? 1 : ")]}".includes(list[at]) ? -1 : 0;
    if (depth === 0) return at;
  }
  return list.length;
};

function read(code) {
  const list = tokens(code);
  const declared = new Set();
  const imports = [];
  const exported = new Set();
  const used = new Set();
  const skip = new Set();
  const sources = [...code.matchAll(/^import .* from "\.\/(.+)";$/gm)].map((one) => one[1]);
  list.forEach((one, at) => {
    if (one === "import" && list[at + 1] === "{") {
      const end = closing(list, at + 1);
      const source = sources[new Set(imports.map((of) => of.at)).size];
      for (let of = at + 2; of < end; of += 2) {
        const name = list[of];
        if (list[of + 1] === "as") of += 2;
        imports.push({ at, name, own: list[of], source });
        declared.add(list[of]);
      }
      for (let of = at; of <= end; of += 1) skip.add(of);
    }
    if (["const", "let", "var"].includes(one)) {
      const rest = list.slice(at + 1);
      let end = 0;
      for (let depth = 0; end < rest.length && !(depth === 0 && [";", "of"].includes(rest[end])); end += 1) depth += "([{".includes(rest[end]) ? 1 : ")]}".includes(rest[end]) ? -1 : 0;
      const names = bound(rest.slice(0, end));
      for (const name of names) declared.add(name);
      if (list[at - 1] === "export") for (const name of names) exported.add(name);
    }
    if (["function", "class"].includes(one) && isName(list[at + 1] ?? "")) {
      declared.add(list[at + 1]);
      if (list[at - 1] === "export" || (list[at - 1] === "async" && list[at - 2] === "export")) exported.add(list[at + 1]);
    }
    if (one === "(") {
      const end = closing(list, at);
      const isBody = list[end + 1] === "{" && (isName(list[at - 1] ?? "")) && !NO_PARAMETERS.has(list[at - 1]);
      if (isBody || list[end + 1] === "=>") for (const name of bound(list.slice(at, end + 1))) declared.add(name);
      if (isBody) skip.add(at - 1);
    }
    if (one === "=>" && isName(list[at - 1] ?? "")) declared.add(list[at - 1]);
  });
  list.forEach((one, at) => {
    const before = list[at - 1];
    const isKey = list[at + 1] === ":" && ["{", ","].includes(before);
    if (isName(one) && !WORDS.has(one) && !skip.has(at) && ![".", "?."].includes(before) && !isKey) used.add(one);
  });
  return { declared, imports, exported, used };
}

const names = (await readdir(folder)).filter((one) => one.endsWith(".js") && !one.startsWith("uPlot"));
const modules = new Map(await Promise.all(names.map(async (name) => [name, read(await readFile(new URL(name, folder), "utf8"))])));
const faults = [];
for (const [file, { declared, imports, used }] of modules) {
  for (const name of used) if (!declared.has(name) && !GLOBALS.has(name)) faults.push(`${file}: ${name} is not declared`);
  for (const { name, own, source } of imports) {
    const offered = MADE[source] ?? modules.get(source)?.exported;
    if (!offered || ![...offered].includes(name)) faults.push(`${file}: ${source} does not export ${name}`);
    if (!used.has(own)) faults.push(`${file}: ${own} is imported and not used`);
  }
}
const advice = new RegExp(/const ADVICE = \/(.*)\/;/.exec(await readFile(new URL("quantities.js", folder), "utf8"))[1]);
const findings = (await readFile(new URL("../../src/language/findings.tsv", import.meta.url), "utf8")).trim().split("\n").slice(1).map((line) => line.split("\t"));
const advising = findings.filter((row) => advice.test(row[0]));
if (advising.length < 20) faults.push(`findings.tsv: only ${advising.length} clauses say what to do`);
for (const row of findings) for (const text of row) if (advice.test(text) !== advice.test(row[0])) faults.push(`findings.tsv: what to do is not recognised alike in "${row[0]}" and "${text}"`);
for (const one of faults) console.log(`FAIL ${one}`);
if (!faults.length) console.log(`ok   ${modules.size} modules declare all their names, and ${advising.length} clauses say what to do`);
process.exitCode = faults.length ? 1 : 0;
