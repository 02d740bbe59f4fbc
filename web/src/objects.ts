// The right column's list of the frame's objects.

import { byId, fill, h } from "./dom";
import { lookAt } from "./viewing";
import type { Stage } from "./stage";
import { colourOf, on, select, shownBoxes, shownFrame, state, titleOf } from "./state";
import type { BoxRow } from "./protocol";

const MARK: Record<string, string> = { proposed: "?", accepted: "✓", edited: "", rejected: "–" };

function row(one: BoxRow, stage: Stage, worst: Map<string, string>, reached: string): HTMLElement {
  const dot = h("span", { class: "dot" });
  dot.style.background = colourOf(one.class_name);
  const made = one.source === "lidar" ? "" : one.source;
  return h("tr", { class: `one${one.id === state.selection ? " chosen" : ""}`, "data-box": one.id, tabIndex: reached === one.id ? 0 : -1, "aria-selected": one.id === state.selection, onclick: () => select(one.id), ondblclick: () => { select(one.id); lookAt(stage); } },
    h("td", { title: titleOf(one.class_name) }, dot, titleOf(one.class_name)),
    h("td", {}, one.track ?? ""),
    h("td", {}, one.distance_m.toFixed(1)),
    h("td", {}, one.points ?? ""),
    h("td", { title: `${one.state}${made ? `, ${made}` : ""}` }, `${MARK[one.state] ?? ""}${made ? ` ${made.slice(0, 5)}` : ""}`),
    h("td", {}, worst.get(one.id) ?? ""));
}

function draw(stage: Stage): void {
  const list = byId("objects");
  const rows = shownBoxes().sort((a, b) => a.distance_m - b.distance_m);
  const worst = new Map<string, string>();
  for (const found of state.checks) if (found.box && found.ignored === null && found.frame === shownFrame()) worst.set(found.box, found.severity === "info" ? "·" : "!");
  if (rows.length === 0) {
    const none = state.shown?.frame.annotated === false ? "This frame has no annotation." : "No boxes here.";
    fill(list, h("p", {}, state.mode === "annotate" ? `${none} Press N and drag along an object, or put the pointer on it and press C.` : none));
    return;
  }
  const top = list.scrollTop;
  const reached = rows.find((one) => one.id === state.selection) ?? rows[0]!; // by Tab; the others by the arrows
  fill(list, h("table", { role: "grid", "aria-label": "Objects of this frame" }, h("thead", {}, h("tr", {}, ...["class", "track", "m", "points", "state"].map((name) => h("th", {}, name)), h("th", { title: "what the checks say" }, "!"))),
    h("tbody", {}, ...rows.map((one) => row(one, stage, worst, reached.id)))));
  list.scrollTop = top;
  list.querySelector(".chosen")?.scrollIntoView({ block: "nearest" });
}

export function objectsPanel(stage: Stage): void {
  on(["boxes", "selection", "filters", "checks", "tool", "frame"], () => draw(stage));
}
