import { h, svg } from "./dom.js";
import { clock, dayText, digits, isNumber, momentText } from "./format.js";
import { language, t } from "./messages.js";

let library = null;
function uplot() {
  library ??= new Promise((resolve, reject) => {
    document.head.append(h("link", { rel: "stylesheet", href: "assets/uPlot.min.css" }));
    document.head.append(h("script", {
      src: "assets/uPlot.iife.min.js", onload: () => resolve(globalThis.uPlot), onerror: () => reject(new Error("uPlot")),
    }));
  });
  return library;
}

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const JOINT_COLORS = ["--c1", "--c2", "--c3", "--c4", "--c5", "--c6", "--c7", "--c8"];
export const JOINT_DASHES = [[], [6, 3], [2, 2], [8, 3, 2, 3], [12, 3], [4, 2, 1, 2], [1, 3], [10, 2, 2, 2]];
const RAMP = ["--r0", "--r1", "--r2", "--r3"];
const FONT = "12px system-ui, -apple-system, sans-serif";
const TABLE_ROWS = 400;

/** A colour between cold (0) and hot (1). It is read at each drawing, because the theme may change. */
export function ramp(share) {
  return () => {
    const stops = RAMP.map((one) => css(one).match(/[0-9a-f]{2}/gi).map((two) => parseInt(two, 16)));
    const at = Math.max(0, Math.min(1, share)) * (stops.length - 1);
    const low = Math.min(stops.length - 2, Math.floor(at));
    return `rgb(${[0, 1, 2].map((one) => Math.round(stops[low][one] + (stops[low + 1][one] - stops[low][one]) * (at - low))).join(" ")})`;
  };
}

const paint = (color) => (typeof color === "function" ? color() : css(color ?? "--plot"));

/** Maps series with different x to one common, ascending x. */
function joined(series) {
  const all = new Float64Array(series.reduce((sum, one) => sum + one.x.length, 0));
  let next = 0;
  for (const one of series) for (const x of one.x) all[next++] = x;
  const x = [...new Set(all.sort())];
  const place = new Map(x.map((value, index) => [value, index]));
  const ys = series.map((one) => {
    const y = new Array(x.length);
    one.x.forEach((value, index) => { y[place.get(value)] = isNumber(one.y[index]) ? one.y[index] : null; });
    return y;
  });
  return [x, ...ys];
}

function extent(spec) {
  if (spec.yRange) return spec.yRange;
  let low = Infinity;
  let high = -Infinity;
  const take = (value) => {
    if (!isNumber(value) || (spec.log && value <= 0)) return;
    if (value < low) low = value;
    if (value > high) high = value;
  };
  for (const one of spec.series) {
    one.y.forEach(take);
    one.low?.forEach(take);
    one.high?.forEach(take);
  }
  for (const one of spec.limits ?? []) take(one.value);
  if (low > high) return spec.log ? [0.01, 1] : [0, 1];
  if (spec.log) return [low / 1.15, high * 1.15];
  if (spec.zero && low > 0) low = 0;
  const gap = (high - low || Math.abs(high) || 1) * 0.06;
  return [spec.zero && low === 0 ? 0 : low - gap, high + gap];
}

/** Marks of a logarithmic axis: 1, 2, 5 of each decade, or more if the range is small. */
function logTicks(low, high) {
  const steps = Math.log10(high / low) < 1 ? [1, 1.5, 2, 3, 4, 5, 6, 8] : [1, 2, 5];
  const found = [];
  for (let decade = Math.floor(Math.log10(low)); decade <= Math.ceil(Math.log10(high)); decade += 1) {
    for (const one of steps) {
      const value = one * 10 ** decade;
      if (value >= low && value <= high) found.push(value);
    }
  }
  return found;
}

/** Entries of a legend without those whose marks are all outside of the plot. */
export const inside = (entries, [from, to]) => entries?.filter((one) => !one.at || one.at.some((x) => x >= from && x <= to));

export function legend(entries) {
  const line = (one) => {
    const node = svg("svg", { viewBox: "0 0 20 10", "aria-hidden": "true" });
    if (one.band) node.append(svg("rect", { x: 0, y: 1, width: 20, height: 8, fill: `var(${one.color})`, opacity: .25 }));
    const stroke = `var(${one.color})`;
    if (one.upright) node.append(svg("path", { d: "M10 0V10", stroke, "stroke-width": 2, "stroke-dasharray": (one.dash ?? []).join(" ") }));
    else if (one.line !== false) node.append(svg("path", { d: "M0 5H20", stroke, "stroke-width": 2, "stroke-dasharray": (one.dash ?? []).join(" ") }));
    if (one.dot) node.append(svg("circle", { cx: 10, cy: 5, r: 3, fill: stroke }));
    return node;
  };
  return entries?.length ? h("ul", { class: "legend" }, entries.map((one) => h("li", null,
    one.ramp ? h("span", { class: "ramp" }) : line(one), one.label))) : null;
}

/** The plot's values as a table, for readers who cannot see the plot. It is built when it is opened. */
function figures(spec) {
  const box = h("div");
  const shown = spec.series.filter((one) => !one.derived);
  const details = h("details", { "data-key": `table/${spec.title}`, ontoggle: () => {
    if (!details.open || box.firstChild) return;
    const rows = shown.flatMap((one) => one.x.map((x, index) => ({ one, x, y: one.y[index], low: one.low?.[index], high: one.high?.[index] })));
    const bounds = rows.some((row) => isNumber(row.low));
    const body = rows.slice(0, TABLE_ROWS).map((row) => h("tr", null, h("th", { scope: "row" }, spec.formatX(row.x)), h("td", null, row.one.label),
      h("td", { class: "number" }, spec.format(row.y)),
      bounds ? h("td", { class: "number" }, isNumber(row.low) ? t`${spec.format(row.low)} to ${spec.format(row.high)}` : "") : null));
    box.append(h("div", { class: "scroll tall", tabindex: 0, role: "group", "aria-label": t`Figures of ${spec.title}` }, h("table", null,
      h("caption", { class: rows.length > TABLE_ROWS ? null : "hidden" }, rows.length > TABLE_ROWS ? t`The first ${TABLE_ROWS} of ${rows.length} rows` : spec.title),
      h("thead", null, h("tr", null, [spec.xLabel, t`Series`, spec.yLabel, bounds ? spec.boundsLabel ?? t`Interval` : null].filter(Boolean)
        .map((text) => h("th", { scope: "col" }, text)))), h("tbody", null, body))));
  } }, h("summary", { "data-key": `summary/${spec.title}` }, t`Figures as a table`), box);
  return details;
}

/**
 * A plot: series [{label, x, y, low, high, color, dash, width, points, line, band, bars, muted}], limits [{value, label}],
 * marks [{x, label, color, dash}]. `owned` receives the objects that must be destroyed with the part of the page.
 */
export function plot(given, owned) {
  const spec = { height: 200, format: (value) => digits(value), ...given };
  spec.formatX ??= spec.time ? (value) => momentText(value * 1000) : (value) => digits(value);
  const tip = h("div", { class: "plot-tip", hidden: true });
  const box = h("div", { class: "plot-box", role: "img", tabindex: 0, "aria-label": t`${spec.label ?? spec.title}. ${spec.yLabel} over ${spec.xLabel}. The figures follow as a table. Arrow keys move the cursor.` }, tip);
  box.style.height = `${spec.height}px`;
  const data = joined(spec.series);
  const first = data[0][0] ?? 0;
  const last = data[0][data[0].length - 1] ?? 1;
  const pad = (last - first || (spec.time ? 86400 * 2 : 1)) * 0.03;
  const bounds = spec.xRange ?? [first - pad, last + pad];
  spec.legend = inside(spec.legend, bounds);
  const element = h("figure", { class: "plot" }, spec.hideTitle ? null : h("figcaption", { class: "plot-title" }, spec.head ?? spec.title), box, legend(spec.legend), figures(spec));
  let chart = null;
  let gone = false;

  const lines = spec.series.map((one) => ({
    label: one.label, stroke: () => paint(one.color), width: one.width ?? 2, dash: one.dash?.length ? one.dash : undefined, spanGaps: one.spanGaps ?? false,
    paths: one.line === false ? () => null : undefined,
    points: { show: Boolean(one.points), size: one.size ?? 6, width: 1, fill: () => paint(one.color), stroke: () => paint(one.color) },
  }));

  function under(u) {
    const { ctx } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    ctx.clip();
    const toX = (value) => u.valToPos(value, "x", true);
    const toY = (value) => u.valToPos(value, "y", true);
    for (const one of spec.series) {
      if (!one.low) continue;
      const points = one.x.map((x, index) => [x, one.low[index], one.high[index]]).filter(([, low, high]) => isNumber(low) && isNumber(high));
      if (one.band) {
        ctx.fillStyle = paint(one.color);
        ctx.globalAlpha = 0.2;
        ctx.beginPath();
        points.forEach(([x, , high], index) => ctx[index ? "lineTo" : "moveTo"](toX(x), toY(high)));
        for (const [x, low] of points.reverse()) ctx.lineTo(toX(x), toY(low));
        ctx.fill();
        ctx.globalAlpha = 1;
      } else {
        ctx.strokeStyle = paint(one.color);
        ctx.lineWidth = devicePixelRatio;
        for (const [x, low, high] of points) {
          ctx.beginPath();
          ctx.moveTo(toX(x), toY(low));
          ctx.lineTo(toX(x), toY(high));
          ctx.stroke();
        }
      }
    }
    ctx.restore();
  }

  function over(u) {
    const { ctx } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    ctx.clip();
    const toX = (value) => u.valToPos(value, "x", true);
    const toY = (value) => u.valToPos(value, "y", true);
    for (const one of spec.limits ?? []) {
      ctx.strokeStyle = paint(one.color ?? "--muted");
      ctx.lineWidth = devicePixelRatio * 1.25;
      ctx.setLineDash((one.dash ?? [5, 4]).map((part) => part * devicePixelRatio));
      ctx.beginPath();
      ctx.moveTo(u.bbox.left, toY(one.value));
      ctx.lineTo(u.bbox.left + u.bbox.width, toY(one.value));
      ctx.stroke();
    }
    for (const one of spec.marks ?? []) {
      ctx.strokeStyle = paint(one.color ?? "--plot-mark");
      ctx.lineWidth = devicePixelRatio * 1.75;
      ctx.setLineDash((one.dash ?? []).map((part) => part * devicePixelRatio));
      ctx.beginPath();
      ctx.moveTo(toX(one.x), u.bbox.top);
      ctx.lineTo(toX(one.x), u.bbox.top + u.bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  function readOut(u) {
    const { idx, left } = u.cursor;
    if (idx === null || idx === undefined || left < 0) {
      tip.hidden = true;
      return;
    }
    // The value of each series that is nearest to the cursor, unless it is too far away.
    const near = [];
    spec.series.forEach((one, index) => {
      if (one.derived) return;
      const values = u.data[index + 1];
      let best = -1;
      for (let step = 0; step < 400; step += 1) {
        if (isNumber(values[idx - step])) best = idx - step;
        if (isNumber(values[idx + step]) && (best < 0 || Math.abs(u.valToPos(u.data[0][idx + step], "x") - left) < Math.abs(u.valToPos(u.data[0][best], "x") - left))) best = idx + step;
        if (best >= 0 || (idx - step < 0 && idx + step >= values.length)) break;
      }
      if (best < 0) return;
      const distance = Math.abs(u.valToPos(u.data[0][best], "x") - left);
      if (distance < 40) near.push({ one, x: u.data[0][best], y: values[best], distance, dy: Math.abs(u.valToPos(values[best], "y") - u.cursor.top) });
    });
    if (!near.length) {
      tip.hidden = true;
      return;
    }
    near.sort((a, b) => a.distance - b.distance || a.dy - b.dy);
    const x = near[0].x;
    const shown = near.filter((one) => Math.abs(one.distance - near[0].distance) < 6).sort((a, b) => a.dy - b.dy).slice(0, 8);
    tip.replaceChildren(h("p", null, spec.formatX(x)), ...shown.map(({ one, y }) => {
      const dot = h("i");
      dot.style.background = paint(one.color);
      const at = one.x.indexOf(x);
      const bounds = one.low && isNumber(one.low[at]) ? ` (${t`${spec.format(one.low[at])} to ${spec.format(one.high[at])}`})` : "";
      return h("p", null, h("span", null, dot, one.label), h("b", null, `${spec.format(y)}${bounds}`));
    }));
    tip.hidden = false;
    const where = u.over.offsetLeft + left;
    const to = where + 12 + tip.offsetWidth > box.clientWidth ? where - 12 - tip.offsetWidth : where + 12;
    tip.style.transform = `translate(${Math.max(0, to)}px, 8px)`;
  }

  function build(UPlot) {
    const axis = { stroke: () => css("--muted"), font: FONT, grid: { stroke: () => css("--plot-grid"), width: 1 }, ticks: { show: false } };
    const [low, high] = extent(spec);
    chart = new UPlot({
      width: Math.max(120, box.clientWidth), height: spec.height, legend: { show: false }, pxAlign: 0,
      padding: [8, 12, 0, 0],
      cursor: { y: false, points: { size: 8 }, drag: { x: true, y: false }, sync: spec.sync ? { key: spec.sync, setSeries: false } : undefined },
      scales: {
        x: { time: Boolean(spec.time), range: (u, from, to) => (from === null || (from === first && to === last) ? bounds : [from, to]) },
        y: { distr: spec.log ? 3 : 1, range: () => [low, high] },
      },
      axes: [
        { ...axis, size: spec.time ? 44 : 28, space: spec.time ? 72 : 48, incrs: spec.whole ? [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000] : spec.time ? (u, axis, from, to) => (to - from < SHORT_S ? MINUTES : DAYS) : undefined, values: spec.time ? (u, at) => timeTicks(at, u.scales.x) : (u, at) => at.map((value) => digits(value, 3).replace(/\.0+$/, "").replace(/(\.\d*[1-9])0+$/, "$1")) },
        { ...axis, size: (u, values) => Math.max(40, ...(values ?? []).map((one) => one.length * 7 + 12)), space: 32, splits: spec.log ? () => logTicks(low, high) : undefined, filter: spec.log ? (u, at) => at : undefined, values: (u, at) => at.map((value) => (spec.formatTick ?? spec.format)(value)) },
      ],
      series: [{}, ...lines],
      hooks: { drawClear: [under], drawAxes: [over], setCursor: [readOut] },
    }, data, box);
  }

  // The browser reports the width before it paints, so that the first picture has the right size.
  const watcher = new ResizeObserver(() => {
    if (gone || !box.clientWidth) return;
    if (chart) {
      if (chart.width !== box.clientWidth) chart.setSize({ width: box.clientWidth, height: spec.height });
    } else if (!building) {
      building = true;
      uplot().then((UPlot) => { if (!gone) build(UPlot); }, () => { box.textContent = t`The plot cannot be drawn. Reload the page.`; });
    }
  });
  let building = false;
  watcher.observe(box);
  const repaint = () => chart?.redraw(false);
  addEventListener("themechange", repaint);
  box.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step || !chart || !data[0].length) return;
    event.preventDefault();
    const at = Math.max(0, Math.min(data[0].length - 1, chart.cursor.left >= 0 && isNumber(chart.cursor.idx) ? chart.cursor.idx + step : 0));
    const y = data.slice(1).map((one) => one[at]).find(isNumber);
    chart.setCursor({ left: chart.valToPos(data[0][at], "x"), top: isNumber(y) ? chart.valToPos(y, "y") : 0 });
  });
  box.addEventListener("blur", () => chart?.setCursor({ left: -10, top: -10 }));
  owned.push({ destroy() {
    gone = true;
    watcher.disconnect();
    removeEventListener("themechange", repaint);
    chart?.destroy();
  } });
  return element;
}

const month = new Intl.DateTimeFormat(language, { month: "short" });
// Shorter axes show the time of day, longer ones show each day once.
const SHORT_S = 2 * 86400;
const MINUTES = [1, 2, 5, 10, 15, 30, 60, 120, 180, 360, 720].map((minutes) => 60 * minutes);
const DAYS = [1, 2, 3, 5, 7, 10, 15, 30, 60, 90, 180, 365, 730, 1825].map((days) => 86400 * days);

function timeTicks(at, scale) {
  const short = scale.max - scale.min < SHORT_S;
  let year = null;
  return at.map((value) => {
    const day = new Date(value * 1000);
    if (short) return clock(day).slice(0, 5);
    const text = `${day.getDate()} ${month.format(day)}`;
    const now = day.getFullYear();
    const shown = year === now ? text : `${text}\n${now}`;
    year = now;
    return shown;
  });
}

export const seconds = (text) => Date.parse(text) / 1000;
export { dayText };
