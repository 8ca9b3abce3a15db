import { svg } from "./dom.js";
import { isNumber } from "./format.js";

const WIDTH = 100;
const HEIGHT = 24;

/** One scale for all joints, so that a flat curve means no change. Outliers are cut off. */
export function sparkRange(robots) {
  let low = 0.95;
  let high = 1.1;
  for (const robot of robots) {
    for (const joint of robot.joints) {
      for (const value of joint.history ?? []) {
        if (!isNumber(value)) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
  }
  return [Math.max(low, 0.7), Math.min(high, 1.5)];
}

/** A small curve of the latest tests around the line of no change. */
export function spark(history, [low, high]) {
  const values = history ?? [];
  const y = (value) => (HEIGHT - 2 - (Math.min(high, Math.max(low, value)) - low) / (high - low) * (HEIGHT - 4)).toFixed(1);
  const x = (index) => (values.length < 2 ? WIDTH : index / (values.length - 1) * WIDTH).toFixed(1);
  let path = "";
  let drawn = false;
  values.forEach((value, index) => {
    if (!isNumber(value)) {
      drawn = false;
      return;
    }
    path += `${drawn ? "L" : "M"}${x(index)} ${y(value)}`;
    drawn = true;
  });
  const node = svg("svg", { class: "spark", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", "aria-hidden": "true" });
  node.append(svg("path", { class: "spark-base", d: `M0 ${y(1)}H${WIDTH}` }));
  if (path) node.append(svg("path", { class: "spark-line", d: path }));
  return node;
}
