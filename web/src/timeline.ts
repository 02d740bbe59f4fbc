// The bottom line: step, play, scrub; keyframes of the selected track, findings, bookmarks on one strip.

import { byId, clamp, fill, h } from "./dom";
import { show } from "./frames";
import { bind, keyFor, run } from "./keys";
import { onReply, send } from "./socket";
import { changed, on, selected, state } from "./state";

const strip = h("canvas", { tabIndex: 0, "aria-label": "frames", role: "slider", "aria-valuemin": 1, "aria-valuenow": 1 });
const counter = h("span", { class: "count" });
const playButton = h("button", { onclick: () => run("play"), title: "Play or pause (Space)", "aria-label": "Play or pause" }, "▶");
let timer = 0;
let due = 0;

function setPlaying(playing: boolean): void {
  const ends = state.playing && !playing;
  state.playing = playing;
  window.clearTimeout(timer);
  if (ends) show(state.frame);
  if (playing) {
    state.direction = 1;
    due = performance.now();
    if (state.frame >= (state.welcome?.frames ?? 1) - 1) show(0);
    next();
  }
  changed("play");
}

/** The next frame when this one is drawn and its time has come. */
function next(): void {
  if (!state.playing) return;
  const last = (state.welcome?.frames ?? 1) - 1;
  if (state.frame >= last) {
    setPlaying(false);
    return;
  }
  if (state.shown?.frame.index === state.frame && performance.now() >= due) {
    due = Math.max(performance.now() - 20, due) + 1000 / state.rate;
    show(state.frame + 1);
  }
  timer = window.setTimeout(next, 8);
}

function draw(): void {
  const count = state.welcome?.frames ?? 0;
  counter.textContent = count ? `${state.frame + 1} / ${count}` : "";
  [strip.ariaValueMax, strip.ariaValueNow] = [String(Math.max(1, count)), String(state.frame + 1)];
  playButton.textContent = state.playing ? "❚❚" : "▶";
  const ratio = Math.min(2, window.devicePixelRatio);
  const { width, height } = strip.getBoundingClientRect();
  if (width < 2 || count === 0) return;
  strip.width = width * ratio;
  strip.height = height * ratio;
  const paper = strip.getContext("2d")!;
  paper.scale(ratio, ratio);
  const x = (frame: number): number => 6 + (frame / Math.max(1, count - 1)) * (width - 12);
  paper.fillStyle = "#2a323c";
  paper.fillRect(6, 14, width - 12, 4);
  for (const drive of (state.welcome?.drives ?? []).slice(0, 400)) paper.fillRect(x(drive.frames[0] ?? 0), 9, 1, 14);
  track(paper, x);
  marks(paper, x, [...new Set(state.checks.filter((row) => row.ignored === null && row.severity !== "info").map((row) => row.frame))], "#f0c040", 2, 6);
  marks(paper, x, state.bookmarks.map((mark) => mark.frame), "#56b4e9", 24, 7);
  paper.fillStyle = "#ffffff";
  paper.fillRect(x(state.frame) - 1.5, 5, 3, 22);
  wrongs(paper, x);
}

function marks(paper: CanvasRenderingContext2D, x: (frame: number) => number, frames: number[], colour: string, y: number, size: number): void {
  paper.fillStyle = colour;
  for (const frame of frames) paper.fillRect(x(frame) - 1.5, y, 3, size);
}

/** Frames of each set where something is missed or found without a truth. */
const matches = new Map<string, Map<number, { missed: number; wrong: number }>>();
let asked = "";
let waiting = 0;

/** Frames in which a set that is shown misses something or finds what is not there. */
export const wrongFrames = (): number[] => [...matches].filter(([set]) => !state.hiddenSets.has(set)).flatMap(([, rows]) => [...rows.keys()]);

/** Ask anew when sets or the least score changed, a detection ended, or the connection came back. */
function askMatches(): void {
  const ended = [...state.jobs.values()].filter((job) => job.kind === "infer" && job.state !== "running" && job.state !== "queued").length;
  const wanted = JSON.stringify([state.predictions.map((set) => set.name), state.filters.score, ended, state.connected]);
  if (state.predictions.length === 0 || wanted === asked) return;
  window.clearTimeout(waiting);
  waiting = window.setTimeout(() => {
    if (send({ op: "match.list", threshold: state.filters.score })) asked = wanted;
  }, 400);
}

/** A cross where a truth is missed, a pink tick where something was found that is not there. */
function wrongs(paper: CanvasRenderingContext2D, x: (frame: number) => number): void {
  for (const [set, rows] of matches) {
    if (state.hiddenSets.has(set)) continue;
    for (const [frame, { missed, wrong }] of rows) {
      const at = x(frame);
      if (wrong > 0) {
        paper.fillStyle = "#cc79a7";
        paper.fillRect(at - 1, 19, 2, 4);
      }
      if (missed === 0) continue;
      paper.strokeStyle = "#ffffff";
      paper.lineWidth = 1.5;
      paper.beginPath();
      for (const side of [-3, 3]) paper.moveTo(at - side, 7), paper.lineTo(at + side, 13);
      paper.stroke();
    }
  }
}

function track(paper: CanvasRenderingContext2D, x: (frame: number) => number): void {
  const number = selected()?.track;
  const row = number === null || number === undefined ? undefined : state.tracks.get(number);
  if (!row) return;
  paper.fillStyle = "#3f7ea8";
  for (const frame of row.frames) paper.fillRect(x(frame) - 1, 14, 2, 4);
  marks(paper, x, row.keyframes, "#00c08b", 11, 10);
}

function scrub(): void {
  const go = (event: PointerEvent): void => {
    const box = strip.getBoundingClientRect();
    const count = state.welcome?.frames ?? 1;
    const frame = Math.round(clamp((event.clientX - box.x - 6) / (box.width - 12), 0, 1) * (count - 1));
    if (frame !== state.frame) show(frame);
  };
  strip.addEventListener("pointerdown", (event) => { strip.setPointerCapture(event.pointerId); setPlaying(false); go(event); });
  strip.addEventListener("pointermove", (event) => { if (event.buttons & 1) go(event); });
}

export function timeline(): void {
  const step = (text: string, id: string, title: string): HTMLElement => h("button", { class: "quiet", title: `${title} (${keyFor(id)})`, "aria-label": title, onclick: () => run(id) }, text);
  const rate = h("select", { title: "frames a second", "aria-label": "frames a second", name: "rate", onchange: () => (state.rate = Number(rate.value)) },
    ...[1, 2, 5, 10, 20].map((value) => h("option", { value, selected: value === state.rate }, `${value} Hz`)));
  fill(byId("timeline"), step("«", "frame.first", "first frame"), step("‹", "frame.previous", "previous frame"), playButton, step("›", "frame.next", "next frame"), step("»", "frame.last", "last frame"), rate, strip, counter);
  bind("play", () => setPlaying(!state.playing));
  scrub();
  new ResizeObserver(draw).observe(strip);
  on(["play", "frame", "checks", "bookmarks", "selection", "tracks", "welcome", "filters", "looks"], draw);
  on(["welcome", "jobs", "filters", "connection", "frame"], askMatches);
  onReply("matches", (message) => {
    if (message.first || !matches.has(message.set)) matches.set(message.set, new Map());
    for (const { frame, missed, wrong } of message.rows) matches.get(message.set)!.set(frame, { missed, wrong });
    draw();
  });
  onReply("bookmarks", (message) => { state.bookmarks = [...message.rows]; changed("bookmarks"); });
}

export { setPlaying };
