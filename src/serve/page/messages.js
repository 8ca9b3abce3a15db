/** Languages of the pages with their own names. English is the text in the code; the table contains the others. */
export const LANGUAGES = { en: "English", it: "Italiano", de: "Deutsch", zh: "中文" };

// early.js has selected it.
export const language = document.documentElement.lang;
const table = language === "en" ? {} : (await import(`./messages-${language}.js`)).default;

/** Text in which a number stays with its sign or unit, and with its other digits, at the end of a line. */
export const unbroken = (text) => text.replace(/([\d}]) (?=%|(?:kg|Nm|N|m|s|min|h|rad|Hz)\b|\d{3}\b)/g, "$1\u00a0");

/**
 * A message in the language of the page: t`Run ${id} of ${robot}`, or t(text) for text from another place. Returns
 * text, or parts for `h` if a value is a node.
 */
export function t(parts, ...values) {
  if (typeof parts === "string") return unbroken(table[parts] ?? values[0] ?? parts);
  const english = parts.reduce((text, part, index) => `${text}{${index - 1}}${part}`);
  const pieces = unbroken(table[english] ?? english).split(/\{(\d)\}/).map((piece, index) => (index % 2 ? values[piece] : piece));
  return values.some((one) => typeof one === "object") ? pieces : pieces.join("");
}

/** A name inside a sentence. German nouns keep their capital. */
export const lower = (text) => (language === "de" ? text : text.toLowerCase());
