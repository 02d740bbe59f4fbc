// The page: parts made, joined, started.

import "./style.css";
import { bindAnnotation, drawGesture, fromRadar, sketch, underPointer } from "./annotate";
import { report } from "./bar";
import { camerasPanel } from "./cameras";
import { CloseUps } from "./closeups";
import type { PointSet } from "./cloud";
import { byId, fill, h } from "./dom";
import { open } from "./edits";
import { neededLayers, onShown, refresh, show } from "./frames";
import { header } from "./header";
import { bindHelp, close } from "./help";
import { inspectorPanel } from "./inspector";
import { bind, listen, readLayout } from "./keys";
import { layersPanel } from "./layers";
import { hold, ready, states } from "./loader";
import { objectsPanel } from "./objects";
import { drawPane, strokeBox } from "./overlay";
import { stageGround } from "./picking";
import { listenToMain } from "./pointer";
import { Projector } from "./project";
import type { FrameState, Welcome } from "./protocol";
import { slicesPanel } from "./slices";
import { connect, onReply } from "./socket";
import { Stage } from "./stage";
import { held } from "./standalone";
import { changed, on, selected, state } from "./state";
import { offerTest } from "./testhook";
import { timeline } from "./timeline";
import { timeBoxes } from "./timing";
import { bindViewing, hint, lookAt } from "./viewing";
import { acceptAll, openWall, wallOpen, wallPanel } from "./wall";
import type { Payload } from "./wire";

function overlay(stage: Stage, closeUps: CloseUps): void {
  const paper = stage.lines.getContext("2d")!;
  paper.clearRect(0, 0, window.innerWidth, window.innerHeight);
  const ground = stageGround(stage);
  for (const pane of stage.panes()) {
    const view = new Projector(pane.camera, pane.rect);
    drawPane(paper, pane.rect, view, pane.index, ground);
    if (sketch.points.length > 1) drawSketch(paper, view);
  }
  closeUps.drawLines(paper);
  corner(stage);
}

function drawSketch(paper: CanvasRenderingContext2D, view: Projector): void {
  paper.strokeStyle = "#7fffd4";
  paper.lineWidth = 2;
  paper.beginPath();
  const points = sketch.closed ? [...sketch.points, sketch.points[0]!] : sketch.points;
  points.forEach((p, i) => {
    const at = view.point(p);
    if (at) i ? paper.lineTo(...at) : paper.moveTo(...at);
  });
  paper.stroke();
  if (sketch.box) strokeBox(paper, view, sketch.box, { colour: "#7fffd4", width: 1, dash: [4, 4] });
}

function corner(stage: Stage): void {
  const { points, whole } = stage.drawn;
  const main = byId("main").getBoundingClientRect();
  const element = byId("corner");
  element.style.left = `${main.x + 8}px`;
  element.style.top = `${main.y + 6}px`;
  fill(element, `${points.toLocaleString("en")} points${whole ? "" : " while moving"}${stage.eye.top ? " · from above" : ""}${state.onlySelection ? " · selection only" : ""}`);
}

function drawFrame(stage: Stage): void {
  const found = state.shown!;
  const points: Parameters<Stage["setFrame"]>[1] = [];
  const radar: Parameters<Stage["setFrame"]>[2] = [];
  for (const layer of neededLayers(found)) {
    const data = ready(layer);
    if (data && layer.kind === "points") points.push({ layer, set: data as PointSet });
    else if (data && layer.kind === "bev") radar.push({ layer, payload: data as Payload });
  }
  stage.setFrame(found.frame.index, points, radar);
  if (state.follow) follow(stage);
}

function follow(stage: Stage): void {
  const row = selected();
  if (row) stage.eye.target = [row.box[0]!, row.box[1]!, row.box[2]!];
}

/** A selected object stays selected in the next frame by its track number. */
function keepSelection(): void {
  let track: number | null = null;
  on("selection", () => (track = selected()?.track ?? track));
  on("frame", () => {
    if (selected() || track === null) return;
    const row = state.boxes.find((one) => one.track === track);
    if (row) state.selection = row.id, changed("selection");
  });
}

function welcomed(message: Welcome): void {
  const again = state.welcome !== null;
  Object.assign(state, {
    welcome: message, predictions: message.predictions, bookmarks: message.bookmarks, windows: message.windows, undo: message.undo, redo: message.redo,
    tracks: new Map(message.tracks.map((row) => [row.track, row])), everConnected: true,
  });
  if (!again) {
    state.mode = message.mode;
    state.chosenClass = message.classes[0]?.name ?? "";
    const asked = new URL(location.href).searchParams.get("frame");
    state.frame = asked === null ? message.first : Number(asked);
  }
  void open(message.data);
  changed("welcome", "tool", "connection", "tracks", "bookmarks");
  if (message.frames === 0) fill(byId("main"), h("div", { class: "empty-state" }, "This data set has no frames. Open another folder: farfield view PATH"));
  else if (again) refresh();
  else show(state.frame);
}

function cancelled(): boolean {
  if (!wallOpen()) return false;
  close();
  return true;
}

function start(): void {
  const stage = new Stage();
  const closeUps = new CloseUps(stage);
  stage.overlay = () => overlay(stage, closeUps);
  onShown(() => drawFrame(stage));
  header(stage);
  layersPanel(stage);
  objectsPanel(stage);
  inspectorPanel();
  camerasPanel(stage);
  slicesPanel();
  timeline();
  wallPanel();
  keepSelection();
  timeBoxes();
  bindViewing(stage);
  bindAnnotation(stage);
  bindHelp(cancelled);
  bind("wall", () => (wallOpen() ? close() : openWall()));
  bind("view.frame", () => (wallOpen() ? acceptAll() : lookAt(stage)));
  listenToMain(stage, () => drawGesture(stage));
  byId("main").addEventListener("dblclick", () => {
    const at = state.mode === "annotate" && stage.maps.size > 0 ? underPointer(stage) : null;
    if (at) fromRadar(at);
  });
  on(["boxes", "selection", "filters", "tool"], () => stage.request("lines"));
  on("looks", () => { stage.applyLooks(); stage.request("all"); });
  on("filters", () => { stage.applyLooks(); stage.request("main"); });
  on("tool", hint);
  const noted = new Set<string>();
  on("frame", () => {
    for (const note of state.shown?.notes ?? []) if (!noted.has(note)) noted.add(note), report("info", note);
  });
  listen();
  void readLayout();
  offerTest(stage, closeUps);
  onReply("welcome", welcomed);
  onReply("windows", (message) => { state.windows = message.count; changed("connection"); });
  onReply("policy", (message) => { if (state.welcome) state.welcome.extent = message.extent; changed("welcome"); });
  onReply("error", (message) => report("error", message.sentence, message.mend));
  onReply("bye", (message) => report("error", message.reason, "Reload the page."));
  const data = held();
  if (data) fromFile(data.welcome, data.frames, data.payloads);
  else connect("");
}

function fromFile(welcome: Welcome, frames: FrameState[], payloads: Record<string, string>): void {
  hold(payloads);
  document.body.classList.add("file");
  welcomed({ ...welcome, mode: "view" });
  for (const found of frames) states.set(found.frame.index, found);
  show(frames[0]?.frame.index ?? 0);
}

try {
  start();
} catch (error) {
  report("error", `The page could not start: ${(error as Error).message}.`, "It needs WebGL 2: switch on hardware acceleration, or try another browser.");
  throw error;
}
