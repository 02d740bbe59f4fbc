// The page: parts made, joined, started.

import "./style.css";
import { bindAnnotation, drawGesture, fromRadar, sketch, underPointer } from "./annotate";
import { report } from "./bar";
import { camerasPanel } from "./cameras";
import { CloseUps } from "./closeups";
import type { PointSet } from "./cloud";
import { byId, counted, fill, h } from "./dom";
import { open, setTracks } from "./edits";
import { findingsPanel } from "./findings";
import { neededLayers, onShown, refresh, show } from "./frames";
import { header } from "./header";
import { bindHelp } from "./help";
import { inspectorPanel } from "./inspector";
import { bind, listen, readLayout } from "./keys";
import { closeWork, labelsMenu } from "./labels";
import { layersPanel } from "./layers";
import { hold, ready, states } from "./loader";
import { objectsPanel } from "./objects";
import { proposalsPanel } from "./proposals";
import { bindWholeTracks, stopMerging } from "./tracks";
import { drawPane, strokeBox } from "./overlay";
import { stageGround } from "./picking";
import { listenToMain } from "./pointer";
import { Projector } from "./project";
import type { FrameState, Welcome } from "./protocol";
import { stand } from "./rows";
import { slicesPanel } from "./slices";
import { connect, onReply } from "./socket";
import { Stage } from "./stage";
import { held } from "./standalone";
import { changed, keepSelection, on, selected, state } from "./state";
import { offerTest } from "./testhook";
import { timeline } from "./timeline";
import { timeBoxes } from "./timing";
import { bindViewing, hint, lookAt } from "./viewing";
import { acceptAll, closeWall, openWall, wallOpen, wallPanel } from "./wall";
import type { Payload } from "./wire";

function overlay(stage: Stage, closeUps: CloseUps): void {
  const paper = stage.lines.getContext("2d")!;
  paper.clearRect(0, 0, window.innerWidth, window.innerHeight);
  const ground = stageGround(stage);
  for (const pane of stage.covered() ? [] : stage.panes()) {
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
  fill(element, `${counted(points, "point")}${whole ? "" : " while moving"}${stage.eye.top ? " · from above" : ""}${state.onlySelection ? " · selection only" : ""}`);
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
}

function follow(stage: Stage): void {
  const row = state.follow ? selected() : null;
  if (!row) return;
  stage.eye.target = [row.box[0]!, row.box[1]!, row.box[2]!];
  stage.request("main");
}

function welcomed(message: Welcome): void {
  const again = state.welcome !== null;
  Object.assign(state, {
    welcome: message, predictions: message.predictions, bookmarks: message.bookmarks, windows: message.windows, undo: message.undo, redo: message.redo,
    everConnected: true, labels: message.written,
  });
  setTracks(message.tracks, message.drive, message.journal_seq);
  if (!again) {
    state.mode = message.mode;
    state.chosenClass = message.classes[0]?.name ?? "";
    const asked = new URL(location.href).searchParams.get("frame");
    state.frame = asked !== null && Number.isInteger(Number(asked)) ? Number(asked) : message.first;
  }
  void open(message.data, message.store);
  changed("welcome", "tool", "connection", "tracks", "bookmarks");
  if (message.frames === 0) fill(byId("main"), h("div", { class: "empty-state" }, "This data set has no frames. Open another folder: farfield view PATH"));
  else if (again) refresh();
  else show(state.frame);
}

/** What stands in the place of a picture where the frame cannot be read. */
function unreadable(): void {
  const reason = state.shown?.unreadable ?? "";
  byId("main").querySelector(".unreadable")?.remove();
  if (reason) byId("main").append(h("div", { class: "empty-state unreadable" }, `Frame ${state.shown!.frame.index + 1} cannot be read: ${reason}`));
}

function cancelled(): boolean {
  if (closeWork()) return true;
  if (!wallOpen()) return stopMerging();
  closeWall();
  return true;
}

function start(): void {
  keepSelection(); // before all others that listen: they draw what it selects
  const stage = new Stage();
  const closeUps = new CloseUps(stage);
  stage.overlay = () => overlay(stage, closeUps);
  onShown(() => drawFrame(stage));
  header(stage);
  labelsMenu();
  layersPanel(stage);
  objectsPanel(stage);
  findingsPanel(stage);
  inspectorPanel();
  proposalsPanel();
  camerasPanel(stage);
  slicesPanel();
  timeline();
  wallPanel();
  timeBoxes();
  bindViewing(stage);
  bindAnnotation(stage);
  bindWholeTracks();
  bindHelp(cancelled);
  bind("wall", () => (wallOpen() ? closeWall() : openWall()));
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
  on("frame", unreadable);
  on("frame", () => follow(stage));
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
  for (const found of frames) {
    states.set(found.frame.index, found);
    stand(found.frame.index, found.boxes, found.seq);
  }
  show(frames[0]?.frame.index ?? 0);
}

try {
  start();
} catch (error) {
  report("error", `The page could not start: ${(error as Error).message}.`, "It needs WebGL 2: switch on hardware acceleration, or try another browser.");
  throw error;
}
