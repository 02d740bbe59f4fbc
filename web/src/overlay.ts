// Boxes, labels, rings, trails and the tape: lines on a second canvas, so that moving a box never redraws a point.
// State is shown by line style too: truth solid, detection dashed, track dotted, missed truth thick with an x.

import { corners, EDGES, heading, type Box, type Vec3 } from "./boxes";
import type { Rect } from "./eye";
import { Projector } from "./project";
import { boxOf, colourOf, shownBoxes, shownPredictions, state, titleOf } from "./state";

export interface Style {
  colour: string;
  width: number;
  dash: number[];
  cross?: boolean;
}

/** Where labels stand already in the pane being drawn: far ones give way to near ones. */
let taken: [number, number, number][] = [];

const FONT = "11px system-ui, sans-serif";

export function strokeBox(paper: CanvasRenderingContext2D, view: Projector, box: Box, style: Style): void {
  paper.strokeStyle = style.colour;
  paper.lineWidth = style.width;
  paper.setLineDash(style.dash);
  const eight = corners(box);
  paper.beginPath();
  const lines: [Vec3, Vec3][] = EDGES.map(([i, j]) => [eight[i]!, eight[j]!]);
  lines.push(heading(box));
  if (style.cross) lines.push([eight[4]!, eight[6]!], [eight[5]!, eight[7]!]);
  for (const [a, b] of lines) trace(paper, view, a, b);
  paper.stroke();
  paper.setLineDash([]);
}

function trace(paper: CanvasRenderingContext2D, view: Projector, a: Vec3, b: Vec3): void {
  const cut = view.segment(a, b);
  if (!cut) return;
  paper.moveTo(cut[0], cut[1]);
  paper.lineTo(cut[2], cut[3]);
}

export function label(paper: CanvasRenderingContext2D, text: string, x: number, y: number, colour: string): void {
  paper.font = FONT;
  const width = paper.measureText(text).width;
  paper.fillStyle = "rgba(8, 11, 15, 0.72)";
  paper.fillRect(x - 2, y - 11, width + 4, 14);
  paper.fillStyle = colour;
  paper.fillText(text, x, y);
}

function clipped(paper: CanvasRenderingContext2D, rect: Rect, draw: () => void): void {
  paper.save();
  paper.beginPath();
  paper.rect(rect.x, rect.y, rect.width, rect.height);
  paper.clip();
  draw();
  paper.restore();
}

/** Everything over one pane of the main view. */
export function drawPane(paper: CanvasRenderingContext2D, rect: Rect, view: Projector, pane: number, ground: number): void {
  taken = [];
  clipped(paper, rect, () => {
    if (state.showRings) rings(paper, view, ground);
    if (state.showTrails) trails(paper, view);
    truths(paper, view, pane);
    predictions(paper, view, pane);
    tape(paper, view);
  });
}

const RINGS = [10, 25, 50, 75, 100, 150, 200, 250];

function rings(paper: CanvasRenderingContext2D, view: Projector, z: number): void {
  paper.strokeStyle = "rgba(140, 160, 180, 0.28)";
  paper.lineWidth = 1;
  for (const r of RINGS) {
    paper.beginPath();
    for (let i = 0; i < 96; i += 1) {
      const [a, b] = [(i * Math.PI) / 48, ((i + 1) * Math.PI) / 48];
      trace(paper, view, [r * Math.cos(a), r * Math.sin(a), z], [r * Math.cos(b), r * Math.sin(b), z]);
    }
    paper.stroke();
    const at = view.point([r, 0, z]);
    if (at) {
      paper.font = FONT;
      paper.fillStyle = "rgba(160, 180, 200, 0.75)";
      paper.fillText(`${r} m`, at[0] + 3, at[1] - 3);
    }
  }
}

function trails(paper: CanvasRenderingContext2D, view: Projector): void {
  for (const trail of state.shown?.trails ?? []) {
    if (state.hiddenSets.has(trail.set)) continue;
    const chosen = state.boxes.find((row) => row.id === state.selection)?.track === trail.track;
    paper.strokeStyle = trail.set === "" ? (chosen ? "#ffffff" : "rgba(220, 230, 240, 0.5)") : "rgba(120, 200, 255, 0.6)";
    paper.lineWidth = chosen ? 2 : 1;
    paper.beginPath();
    for (let i = 1; i < trail.points.length; i += 1)
      trace(paper, view, trail.points[i - 1]!.slice(1) as Vec3, trail.points[i]!.slice(1) as Vec3);
    paper.stroke();
  }
}

function truths(paper: CanvasRenderingContext2D, view: Projector, pane: number): void {
  if (!state.showTruth) return;
  const missed = new Set(state.showMissed ? shownPredictions(pane).flatMap((found) => found.missed) : []);
  const chosenFirst = (row: { id: string; distance_m: number }): number => (row.id === state.selection ? -1 : row.distance_m);
  for (const row of shownBoxes().sort((a, b) => chosenFirst(a) - chosenFirst(b))) {
    const chosen = row.id === state.selection;
    const box = boxOf(row);
    const lost = missed.has(row.id);
    const colour = chosen ? "#ffffff" : colourOf(row.class_name);
    const dash = row.state === "proposed" ? [6, 4] : row.source === "interpolated" ? [2, 2] : [];
    strokeBox(paper, view, box, { colour: lost && !chosen ? "#ff5c5c" : colour, width: chosen ? 2.2 : lost ? 3 : 1.3, dash, cross: lost });
    if (state.showLabels) tag(paper, view, box, caption(row, lost), colour);
  }
}

function caption(row: { class_name: string; track: number | null; distance_m: number; state: string }, lost: boolean): string {
  const track = row.track === null ? "" : ` ${row.track}`;
  return `${titleOf(row.class_name)}${track} ${row.distance_m.toFixed(0)} m${row.state === "proposed" ? " ?" : ""}${lost ? " missed" : ""}`;
}

function tag(paper: CanvasRenderingContext2D, view: Projector, box: Box, text: string, colour: string): void {
  const at = view.point([box[0], box[1], box[2] + box[5] / 2 + 0.3]);
  if (!at) return;
  const [x, y] = [at[0] + 4, at[1] - 4];
  const width = text.length * 6 + 4;
  if (taken.some(([tx, ty, tw]) => Math.abs(ty - y) < 13 && x < tx + tw && tx < x + width)) return;
  taken.push([x, y, width]);
  label(paper, text, x, y, colour);
}

function predictions(paper: CanvasRenderingContext2D, view: Projector, pane: number): void {
  for (const { set, rows } of shownPredictions(pane)) {
    const tracked = set?.kind === "tracks";
    for (const row of [...rows].sort((a, b) => a.distance_m - b.distance_m)) {
      const box = boxOf(row);
      const wrong = row.match === "false";
      const colour = wrong ? "#ff7ad9" : (set?.colour ?? "#e69f00");
      strokeBox(paper, view, box, { colour, width: wrong ? 2 : 1.3, dash: tracked ? [1.5, 3] : [6, 4] });
      if (row.velocity && Math.hypot(...(row.velocity as [number, number])) > 0.5) arrow(paper, view, box, row.velocity as [number, number], colour);
      const score = row.score === null ? "" : ` ${row.score.toFixed(2)}`;
      const name = tracked && row.track !== null ? `#${row.track}` : titleOf(row.class_name);
      if (state.showLabels) tag(paper, view, box, `${name}${score} ${row.distance_m.toFixed(0)} m${wrong ? " no truth" : ""}`, colour);
    }
  }
}

function arrow(paper: CanvasRenderingContext2D, view: Projector, box: Box, velocity: [number, number], colour: string): void {
  paper.strokeStyle = colour;
  paper.lineWidth = 2;
  paper.beginPath();
  trace(paper, view, [box[0], box[1], box[2]], [box[0] + velocity[0], box[1] + velocity[1], box[2]]);
  paper.stroke();
}

function tape(paper: CanvasRenderingContext2D, view: Projector): void {
  paper.strokeStyle = "#7fffd4";
  paper.lineWidth = 2;
  const points = state.tape;
  for (const p of points) {
    const at = view.point(p);
    if (at) paper.strokeRect(at[0] - 3, at[1] - 3, 6, 6);
  }
  if (points.length < 2) return;
  const [a, b] = [points[0]!, points[1]!];
  paper.beginPath();
  trace(paper, view, a, b);
  paper.stroke();
  const d = [b[0] - a[0], b[1] - a[1], b[2] - a[2]] as const;
  const at = view.point([(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2]);
  if (at) label(paper, `${Math.hypot(d[0], d[1]).toFixed(2)} m   dx ${d[0].toFixed(2)}  dy ${d[1].toFixed(2)}  dz ${d[2].toFixed(2)}`, at[0] + 6, at[1] - 6, "#7fffd4");
}
