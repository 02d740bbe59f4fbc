// The calibration page: started by `farfield calibrate KIND DATA --page`.

import "./calib.css";
import { report } from "./bar";
import { cameraLoaded, cameraPage, camera, directionToScreen, nearestPoint, picking, spread, pixelToScreen, solvePairs, togglePoints } from "./calibcamera";
import type { Drawer } from "./calibgl";
import { changed, frameNow, go, isRadar, keep, listenToServer, model, onChange, openCalibration, type Values } from "./calibmodel";
import { CAMERA_FIELDS, RADAR_FIELDS, type Field } from "./calibpanel";
import { placed, radarFrame, radarLoaded, radarPage, radarView, toScreen } from "./calibradar";
import { byId, counted, fill, h } from "./dom";
import { toggleKeys } from "./keybox";
import { bind, KEYS, listen, nameOf, readLayout, run, step } from "./keys";
import { toPixel } from "./lens";
import { post } from "./post";
import { connect, newId, onReply, send } from "./socket";
import { on, state } from "./state";

let drawer: Drawer | null = null;

function header(): void {
  const found = model.state;
  const frame = found?.frames[model.place];
  const kind = found?.kind === "radar-lidar" ? "radar to LiDAR" : "LiDAR to camera";
  const saved = !state.connected ? (state.everConnected ? "connection lost, trying again" : "connecting") : found?.unsaved ? "not saved" : "as saved";
  fill(byId("header"), h("h1", {}, "farfield"), h("span", { class: "grow", title: state.welcome?.title ?? "" }, h("span", { class: "place" }, state.welcome?.title ?? ""), h("span", { class: "weak" }, found ? `  ${kind}: ${found.lidar} and ${found.sensor}` : "")),
    h("span", { class: "weak" }, model.milliseconds ? `residual in ${model.milliseconds.toFixed(0)} ms` : ""),
    h("span", { id: "saved", class: found?.unsaved ? "unsaved" : "weak" }, saved), h("span", { class: "weak" }, counted(state.windows, "window")),
    h("button", { title: "Keys", "aria-label": "? Keys", onclick: () => run("help") }, "?"));
  if (!found) return;
  const slider = byId("foot").querySelector<HTMLInputElement>("input");
  if (slider) [slider.max, slider.value] = [String(Math.max(0, found.frames.length - 1)), String(model.place)];
  const other = found.kind === "radar-lidar" ? radarFrame() : null;
  fill(byId("foot").querySelector("span")!, frame ? `${frame.name}  ${model.place + 1} / ${found.frames.length}${other !== null && other !== frame.index ? `  radar of frame ${other}` : ""}` : "");
}

function footer(): void {
  const slider = h("input", { type: "range", min: "0", max: "0", value: "0", "aria-label": "frame", oninput: (event: Event) => go(Number((event.target as HTMLInputElement).value)) });
  const place = h("span", { class: "count" });
  const mouse = model.state?.kind === "radar-lidar" ? "drag: move the cloud · Ctrl+drag: turn it · right drag: move the view · wheel: nearer" : "wheel: enlarge · drag: move the picture · Ctrl+drag: turn the camera · N: pick";
  fill(byId("foot"), h("button", { onclick: () => run("frame.previous"), title: "previous frame", "aria-label": "previous frame" }, "◀"), h("button", { onclick: () => run("frame.next"), title: "next frame", "aria-label": "next frame" }, "▶"), slider, place, h("em", { class: "weak" }, mouse));
}

function nudge(fields: Field[], at: number, by: number) {
  return (event: KeyboardEvent): void => {
    if (!model.values || !model.state?.ready || model.job) return;
    const field = fields[at]!;
    keep(field.set(model.values, field.get(model.values) + by * step(event)));
  };
}

function bindKeys(radar: boolean): void {
  const fields = radar ? RADAR_FIELDS : CAMERA_FIELDS;
  const moves: [string, number, number][] = radar
    ? [["calib.up", 0, 0.05], ["calib.down", 0, -0.05], ["calib.left", 1, 0.05], ["calib.right", 1, -0.05], ["calib.turn.left", 3, 0.1], ["calib.turn.right", 3, -0.1]]
    : [["calib.up", 0, 0.05], ["calib.down", 0, -0.05], ["calib.left", 1, -0.05], ["calib.right", 1, 0.05], ["calib.turn.left", 2, -0.05], ["calib.turn.right", 2, 0.05]];
  const act = new Map(moves.map(([id, at, by]) => [id, nudge(fields, at, by)]));
  bind("calib.up", (event) => act.get("calib.up")!(event));
  bind("calib.down", (event) => act.get("calib.down")!(event));
  bind("calib.left", (event) => act.get("calib.left")!(event));
  bind("calib.right", (event) => act.get("calib.right")!(event));
  bind("calib.turn.left", (event) => act.get("calib.turn.left")!(event));
  bind("calib.turn.right", (event) => act.get("calib.turn.right")!(event));
  bind("calib.offset.less", radar ? whole(-1) : () => undefined);
  bind("calib.offset.more", radar ? whole(1) : () => undefined);
  bind("calib.refine", () => { if (!model.job) post({ op: "calib.solve", id: newId(), how: radar ? "objects" : "edges" }); });
  bind("calib.pairs", () => { if (!radar && !model.job) solvePairs(); });
  bind("calib.pick", () => { if (!radar) Object.assign(picking, { on: !picking.on, pixel: null }), changed(); });
  bind("calib.points", () => { if (!radar) togglePoints(); });
  bind("calib.blink", () => { model.blink = !model.blink; changed(); });
  bind("undo", () => post({ op: "calib.undo", id: newId(), what: "undo" }));
  bind("redo", () => post({ op: "calib.undo", id: newId(), what: "redo" }));
  bind("save", () => post({ op: "calib.save", id: newId(), to: "data" }));
  bind("delete", () => { if (picking.chosen !== null) post({ op: "calib.unpick", id: newId(), pick: picking.chosen }), (picking.chosen = null); });
  bind("frame.previous", () => go(model.place - 1));
  bind("frame.next", () => go(model.place + 1));
  bind("frame.first", () => go(0));
  bind("frame.last", () => go(1e9));
  bind("help", help);
  bind("cancel", cancel);
}

const whole = (by: number) => (): void => {
  if (model.values && isRadar(model.values) && model.state?.ready && !model.job) keep({ ...model.values, frames: model.values.frames + by });
};

function cancel(): void {
  if (model.job && model.state?.ready) send({ op: "calib.cancel", id: newId(), job: model.job.job });
  else if (picking.pixel) picking.pixel = null;
  else picking.on = false;
  changed();
}

function help(): void {
  const keys = KEYS.filter((key) => key.modes.includes("calibrate"));
  const groups = [...new Set(keys.map((key) => key.group))].map((group) => ({ title: group, rows: keys.filter((key) => key.group === group).map((key): [string, string] => [nameOf(key), key.title]) }));
  toggleKeys("Keys while calibrating", "Tab goes through all that can be pressed. Keys that move go ten times as far with Shift and a fifth with Alt. A camera is turned, a radar's cloud is moved.", groups);
}

function offerTest(): void {
  if (new URL(location.href).searchParams.get("test") !== "1") return;
  const shown = (): boolean => !!model.state?.ready && model.job === null && model.fresh && (model.state.kind === "radar-lidar" ? radarLoaded() : cameraLoaded());
  const waitIdle = async (): Promise<number> => {
    const started = performance.now();
    while (!shown()) {
      if (performance.now() - started > 120_000) throw new Error(`not idle: ${JSON.stringify({ ready: model.state?.ready, job: model.job, fresh: model.fresh })}`);
      await new Promise((resolve) => setTimeout(resolve, 20));
    }
    return performance.now() - started;
  };
  const at = ([x, y]: [number, number]): [number, number] => {
    const box = byId("main").getBoundingClientRect();
    return [box.x + x, box.y + y];
  };
  Object.assign(window, {
    farfieldTest: {
      state, model, waitIdle, picking, radarView, radarFrame,
      values: (): Values | null => model.values,
      colours: () => drawer?.colourCount() ?? 0,
      ground: (p: number[]) => at(toScreen(p)),
      lidar: (p: number[]) => (model.values && isRadar(model.values) ? at(toScreen(placed(model.values, p))) : null),
      pixel: (p: number[]) => at(pixelToScreen(p)),
      strip: (p: number[]) => at(directionToScreen(p)),
      projected: (p: number[]) => { const lens = camera(); return lens && toPixel(lens, p); },
      nearest: nearestPoint,
      spread,
      frame: frameNow,
      is: (condition: (test: unknown) => boolean) => condition((window as unknown as { farfieldTest: unknown }).farfieldTest),
    },
  });
}

function start(): void {
  listenToServer();
  onReply("welcome", (message) => {
    Object.assign(state, { welcome: message, mode: "calibrate", windows: message.windows, everConnected: true });
    openCalibration();
  });
  onReply("windows", (message) => { state.windows = message.count; changed(); });
  onReply("calib.state", (message) => {
    if (drawer) return;
    drawer = message.kind === "radar-lidar" ? radarPage() : cameraPage();
    bindKeys(message.kind === "radar-lidar");
    footer();
  });
  onReply("error", (message) => report("error", message.sentence, message.mend));
  onReply("bye", (message) => report("error", message.reason, "Reload the page."));
  on("connection", changed);
  onChange(header);
  listen();
  void readLayout();
  offerTest();
  connect("");
}

try {
  start();
} catch (error) {
  report("error", `The page could not start: ${(error as Error).message}.`, "It needs WebGL 2: switch on hardware acceleration, or try another browser.");
  throw error;
}
