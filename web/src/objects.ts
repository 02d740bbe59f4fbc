// The right column's lists: the objects of the frame and what the checks found.

import { byId, degrees, fill, h } from "./dom";
import { lookAt } from "./viewing";
import { newId, onReply, send } from "./socket";
import type { Stage } from "./stage";
import { changed, colourOf, on, select, shownBoxes, state, titleOf } from "./state";
import type { BoxRow } from "./protocol";

const MARK: Record<string, string> = { proposed: "?", accepted: "✓", edited: "", rejected: "–" };

function row(one: BoxRow, stage: Stage, worst: Map<string, string>): HTMLElement {
  const dot = h("span", { class: "dot" });
  dot.style.background = colourOf(one.class_name);
  const made = one.source === "lidar" ? "" : one.source;
  return h("tr", { class: `one${one.id === state.selection ? " chosen" : ""}`, "data-box": one.id, onclick: () => select(one.id), ondblclick: () => { select(one.id); lookAt(stage); } },
    h("td", {}, dot, titleOf(one.class_name)),
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
  for (const found of state.checks) if (found.box && found.ignored === null && found.frame === state.frame) worst.set(found.box, found.severity === "info" ? "·" : "!");
  if (rows.length === 0) {
    const none = state.shown?.frame.annotated === false ? "This frame has no annotation." : "No boxes here.";
    fill(list, h("p", {}, state.mode === "annotate" ? `${none} Press N and drag along an object, or put the pointer on it and press C.` : none));
    return;
  }
  const top = list.scrollTop;
  fill(list, h("table", {}, h("thead", {}, h("tr", {}, ...["class", "track", "m", "points", "state", ""].map((name) => h("th", {}, name)))),
    h("tbody", {}, ...rows.map((one) => row(one, stage, worst)))));
  list.scrollTop = top;
  list.querySelector(".chosen")?.scrollIntoView({ block: "nearest" });
}

function drawChecks(stage: Stage): void {
  const rows = state.checks.filter((found) => found.ignored === null && found.frame === state.frame);
  fill(byId("checks"), ...rows.map((found) =>
    h("div", { class: `finding ${found.severity}`, onclick: () => { if (found.box) select(found.box); lookAt(stage); } },
      h("span", {}, found.sentence),
      state.mode === "annotate" ? h("button", { class: "quiet", title: "Let it stand, with a reason", onclick: (event: Event) => { event.stopPropagation(); ignore(event.currentTarget as HTMLElement, found.id); } }, "ignore") : null)));
}

function ignore(button: HTMLElement, id: string): void {
  const input = h("input", { placeholder: "reason", onkeydown: (event: KeyboardEvent) => {
    if (event.key !== "Enter" || !input.value.trim()) return;
    send({ op: "check.ignore", id: newId(), check: id, reason: input.value.trim() });
    const found = state.checks.find((one) => one.id === id);
    if (found) found.ignored = input.value.trim();
    changed("checks");
  } });
  input.addEventListener("click", (event) => event.stopPropagation());
  button.replaceWith(input);
  input.focus();
}

onReply("checks", (message) => {
  state.checks = message.frame === null ? [...message.rows] : [...state.checks.filter((found) => found.frame !== message.frame), ...message.rows];
  changed("checks");
});

export function objectsPanel(stage: Stage): void {
  on(["boxes", "selection", "filters", "checks", "tool", "frame"], () => draw(stage));
  on(["checks", "frame", "tool"], () => drawChecks(stage));
}

export const headingOf = (row: BoxRow): string => `${degrees(row.box[6]!).toFixed(1)}°`;
