// What stands over the pictures of the close-ups: scales in metres, the ground, the radar's echoes.

import { sample } from "./colours";
import type { Box } from "./boxes";
import type { Name } from "./closeviews";
import type { Rect } from "./eye";
import { label } from "./overlay";
import type { Projector } from "./project";
import type { Echo } from "./radarblock";

const STEPS_M = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20];
const APART_PX = 26;
const FASTEST_M_S = 5; // of the colours of Doppler

/** Lines at round metres: heights of the frame where the view has them, else metres from the middle of the object. */
export function scales(paper: CanvasRenderingContext2D, name: Name, rect: Rect, box: Box, pan: [number, number], metresPerPixel: number): void {
  const step = STEPS_M.find((one) => one / metresPerPixel >= APART_PX) ?? 50;
  const digits = step < 1 ? 1 : 0;
  const middle = [rect.x + rect.width / 2, rect.y + rect.height / 2] as const;
  const half = [(rect.width / 2) * metresPerPixel, (rect.height / 2) * metresPerPixel] as const;
  const zero = name === "top" ? 0 : box[2];
  paper.save();
  paper.lineWidth = 1;
  paper.font = "10px system-ui, sans-serif";
  paper.strokeStyle = "rgba(150, 170, 190, 0.16)";
  paper.fillStyle = "rgba(175, 192, 208, 0.85)";
  paper.beginPath();
  const [low, high] = [zero + pan[1] - half[1], zero + pan[1] + half[1]];
  for (let n = Math.ceil(low / step); n * step <= high; n += 1) {
    const y = middle[1] - (n * step - zero - pan[1]) / metresPerPixel;
    paper.moveTo(rect.x, y);
    paper.lineTo(rect.x + rect.width, y);
    if (y > rect.y + 18 && y < rect.y + rect.height - 14) paper.fillText(`${(n * step).toFixed(digits)}${name === "top" ? "" : " m"}`, rect.x + 3, y - 2);
  }
  for (let n = Math.ceil((pan[0] - half[0]) / step); n * step <= pan[0] + half[0]; n += 1) {
    const x = middle[0] + (n * step - pan[0]) / metresPerPixel;
    paper.moveTo(x, rect.y);
    paper.lineTo(x, rect.y + rect.height);
    if (x > rect.x + 34 && x < rect.x + rect.width - 14 && rect.height > 70) paper.fillText(Math.abs(n * step).toFixed(digits), x + 2, rect.y + rect.height - 4);
  }
  paper.stroke();
  paper.restore();
}

/** The ground by what the LiDAR sees before the object. */
export function groundLine(paper: CanvasRenderingContext2D, rect: Rect, view: Projector, box: Box, ground: number): void {
  const at = view.point([box[0], box[1], ground]);
  if (!at || at[1] < rect.y || at[1] > rect.y + rect.height) return;
  paper.save();
  paper.strokeStyle = "#8fd18f";
  paper.lineWidth = 1;
  paper.setLineDash([8, 4]);
  paper.beginPath();
  paper.moveTo(rect.x, at[1]);
  paper.lineTo(rect.x + rect.width, at[1]);
  paper.stroke();
  paper.restore();
  const text = `ground ${ground.toFixed(2)} m`;
  label(paper, text, rect.x + rect.width - 6 - text.length * 6, Math.min(rect.y + rect.height - 4, at[1] + 13), "#8fd18f");
}

/** Rings at echoes, larger where they are stronger, coloured by their Doppler: blue comes nearer, orange goes away. */
export function drawEchoes(paper: CanvasRenderingContext2D, view: Projector, echoes: Echo[]): void {
  paper.save();
  paper.lineWidth = 1.5;
  for (const { at, over_db, doppler_m_s } of echoes) {
    const p = view.point(at);
    if (!p) continue;
    const [r, g, b] = doppler_m_s === null ? [255, 255, 255] : sample("signed", 0.5 + doppler_m_s / (2 * FASTEST_M_S));
    paper.strokeStyle = `rgb(${r | 0}, ${g | 0}, ${b | 0})`;
    paper.beginPath();
    paper.arc(...p, Math.min(12, 3 + over_db / 3), 0, 2 * Math.PI);
    paper.stroke();
  }
  paper.restore();
}
