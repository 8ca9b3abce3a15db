import { h } from "./dom.js";
import { language, t, unbroken } from "./messages.js";

const MINUS = "\u2212";
const THIN = "\u202f";
const NONE = "\u2013";
const LOCALE = { en: "en-GB", zh: "zh-CN" }[language] ?? language;
// Decimal mark.
const POINT = language === "it" || language === "de" ? "," : ".";
const dayAndTime = new Intl.DateTimeFormat(LOCALE, { day: "numeric", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit" });
const dayOnly = new Intl.DateTimeFormat(LOCALE, { day: "numeric", month: "short", year: "numeric" });
const timeOnly = new Intl.DateTimeFormat(LOCALE, { hour: "2-digit", minute: "2-digit", second: "2-digit" });

export const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const sign = (text) => text.replace("-", MINUS).replace(".", POINT);

/** A number with so many significant digits. */
export function digits(value, significant = 3) {
  if (!isNumber(value)) return NONE;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-4) {
    const [mantissa, exponent] = value.toExponential(Math.max(0, significant - 1)).split("e");
    const raised = [...String(Number(exponent))].map((one) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(one)]).join("");
    return `${sign(mantissa)}${THIN}×${THIN}10${raised}`;
  }
  const places = Math.max(0, Math.min(8, significant - 1 - Math.floor(Math.log10(size))));
  return sign(value.toFixed(places));
}

export function fixed(value, places) {
  return isNumber(value) ? sign(value.toFixed(places)) : NONE;
}

export function count(value) {
  return isNumber(value) ? new Intl.NumberFormat("en", { useGrouping: "always" }).format(value).replaceAll(",", THIN) : NONE;
}

/** A friction index as its change: 1.28 is +28.0 %. */
export function change(index, places = 1) {
  if (!isNumber(index)) return NONE;
  const percent = (index - 1) * 100;
  const text = Math.abs(percent).toFixed(places);
  const none = Number(text) === 0;
  return `${none ? "±" : percent > 0 ? "+" : MINUS}${text.replace(".", POINT)}${THIN}%`;
}

/** A mark of an axis: a number without zeros at its end. */
export const tick = (value) => digits(value, 3).replace(/([.,]\d*?)0+$/, "$1").replace(/[.,]$/, "");

export function percent(fraction, places = 1) {
  return isNumber(fraction) ? `${sign((fraction * 100).toFixed(places))}${THIN}%` : NONE;
}

export function unit(text) {
  return (text ?? "").replace(/\^2/g, "²").replace(/\^3/g, "³").replaceAll(" ", "\u00a0");
}

/** A number with a noun: the form for one, then that for more. */
export function plural(number, noun) {
  const [one, many = one] = t(`{0} ${noun}`, `{0} ${noun}|{0} ${noun}s`).split("|");
  return (number === 1 ? one : many).replace("{0}", count(number));
}

export function sentence(text) {
  return text ? unbroken(text[0].toUpperCase() + text.slice(1)) : "";
}

/** The clauses of a message: the finding, then figures and advice. A semicolon inside brackets parts nothing. */
export function clauses(message) {
  return (message ?? "").split(/; (?![^()]*\))/);
}

/** A message without its joint, which stands beside it. */
export const withoutJoint = (message, joint) => unbroken(message?.startsWith(`${joint}: `) ? message.slice(joint.length + 2) : message ?? "");

function utcTitle(text) {
  return `${text.replace("T", " ").replace(/\.000Z$/, "Z").replace("Z", "")} UTC`;
}

/** A moment in the browser's time zone, with UTC in its title. */
export function moment(text, style = "time") {
  const at = Date.parse(text ?? "");
  if (Number.isNaN(at)) return document.createTextNode(NONE);
  const form = style === "day" ? dayOnly : dayAndTime;
  return h("time", { datetime: text, title: utcTitle(text) }, form.format(at));
}

export const clock = (at) => timeOnly.format(at);
export const dayText = (at) => dayOnly.format(at);
export const momentText = (at) => dayAndTime.format(at);

const relative = new Intl.RelativeTimeFormat(LOCALE);

/** How long ago, in one rounded unit. */
export function ago(text, now = Date.now()) {
  const seconds = (now - Date.parse(text ?? "")) / 1000;
  if (!Number.isFinite(seconds)) return "";
  if (seconds >= 0 && seconds < 45) return t`just now`;
  const [number, unit] = rounded(Math.abs(seconds));
  return relative.format(seconds < 0 ? number : -number, unit);
}

export const span = (seconds) => plural(...rounded(seconds));

function rounded(seconds) {
  for (const [size, unit] of [[31557600, "year"], [2629800, "month"], [86400, "day"], [3600, "hour"], [60, "minute"]]) {
    // One month, for example, is told in days.
    if (seconds >= size * (size >= 86400 ? 2 : 1)) return [Math.floor(seconds / size), unit];
  }
  return [Math.max(1, Math.round(seconds)), "second"];
}

/** Odds as a likelihood in words, with the figure. */
export function likelihood(odds) {
  if (!isNumber(odds) || odds < 0) return t`not known`;
  const share = odds / (1 + odds);
  const word = share > 0.999 ? t`almost certain` : share > 0.95 ? t`very likely` : share > 0.66 ? t`likely`
    : share > 0.33 ? t`as likely as not` : share > 0.05 ? t`unlikely` : share > 0.001 ? t`very unlikely` : t`almost excluded`;
  const figure = odds >= 1e6 ? t`more than a million to 1` : odds >= 1 ? t`${digits(odds, 2)} to 1`
    : odds >= 1e-6 ? t`1 to ${digits(1 / odds, 2)}` : t`less than 1 to a million`;
  return `${word} (${figure})`;
}
