// Radar against LiDAR: the radar's map from above, the LiDAR's points over it, moved by the hand or by the solver.

import { ask, changed, drawn, frameNow, giveBack, isRadar, keep, model, move, stateOf } from "./calibmodel";
import { Drawer, type Above, type Places, type Rect } from "./calibgl";
import { button, chart, figures, histogram, notes, progress, RADAR_FIELDS, saving, show, valueRow } from "./calibpanel";
import { byId, fill, h, wrapped } from "./dom";
import { begin, cancelGesture, end } from "./gestures";
import type { Layer, RadarValues } from "./protocol";
import { levelled, radarPicture, spread, type RadarPicture } from "./radarlevels";
import { decode } from "./wire";

const view: Above = { x: 30, y: 0, scale: 9 };
let lidar: { frame: number; places: Places; low: number } | null = null;
let echoes: { frame: number; places: Places } | null = null;
let map: { frame: number; picture: RadarPicture; window: [number, number] } | null = null;
let missing = "";
let wanted = "";

const poseOf = (values: RadarValues): number[] => [values.x_m, values.y_m, values.yaw_rad];

/** p_radar of a point of the LiDAR. */
export const placed = (values: RadarValues, [x, y]: readonly number[]): [number, number] => {
  const [cos, sin] = [Math.cos(values.yaw_rad), Math.sin(values.yaw_rad)];
  return [cos * x! - sin * y! + values.x_m, sin * x! + cos * y! + values.y_m];
};

function rect(): Rect {
  const { clientWidth, clientHeight } = byId("main");
  return { x: 0, y: 0, width: clientWidth, height: clientHeight };
}

export function toScreen([x, y]: readonly number[]): [number, number] {
  const { width, height } = rect();
  return [width / 2 - (y! - view.y) * view.scale, height / 2 - (x! - view.x) * view.scale];
}

export function toGround(left: number, top: number): [number, number] {
  const { width, height } = rect();
  return [view.x - (top - height / 2) / view.scale, view.y - (left - width / 2) / view.scale];
}

async function bytes(layer: Layer): Promise<ArrayBuffer> {
  const answer = await fetch(layer.url);
  if (!answer.ok) throw new Error(`${layer.title}: ${(await answer.text()).slice(0, 200)}`);
  return answer.arrayBuffer();
}

/** The frame whose radar belongs to the LiDAR frame that is shown, with the offset of the values. */
export function radarFrame(): number | null {
  const { state } = model;
  const values = drawn();
  if (!state || !values || !isRadar(values)) return null;
  const row = state.frames[model.place];
  return row ? (state.numbers[String(row.number + values.frames)] ?? null) : null;
}

async function loaded(drawer: Drawer): Promise<void> {
  const { state } = model;
  if (!state?.ready) return;
  const [frame, other] = [frameNow(), radarFrame()];
  const key = `${frame} ${other}`;
  if (key === wanted) return;
  wanted = key;
  const here = await stateOf(frame);
  const cloud = here.layers.find((layer) => layer.kind === "points" && layer.name === state.lidar);
  if (cloud && lidar?.frame !== frame) {
    const payload = decode(await bytes(cloud));
    if (wanted !== key) return;
    drawer.forget(lidar?.places ?? null);
    const places = drawer.upload(payload);
    lidar = { frame, places, low: ground(places) + 0.4 };
  }
  missing = other === null ? "no radar frame belongs to this offset" : "";
  if (other !== null) await loadRadar(drawer, other, key);
  changed();
}

async function loadRadar(drawer: Drawer, frame: number, key: string): Promise<void> {
  const there = await stateOf(frame);
  const bev = there.layers.find((layer) => layer.kind === "bev");
  const points = there.layers.find((layer) => layer.kind === "points" && layer.sensor === "radar");
  if (bev && map?.frame !== frame) {
    const picture = radarPicture(decode(await bytes(bev)), bev);
    if (wanted !== key) return;
    const level = levelled(picture);
    drawer.setMap(level, picture.columns[2], picture.rows[2]);
    map = { frame, picture, window: spread(level, picture.polar ? 0.99 : 0.999) };
  }
  if (!bev && points && echoes?.frame !== frame) {
    const payload = decode(await bytes(points));
    if (wanted !== key) return;
    drawer.forget(echoes?.places ?? null);
    echoes = { frame, places: drawer.upload(payload, payload.arrays.has("power_db") ? "power_db" : "") };
  }
}

/** A low height among the nearer points: about the ground's. */
function ground({ rows, count, scale }: Places): number {
  const heights: number[] = [];
  const step = Math.max(1, Math.floor(count / 4000));
  for (let i = 0; i < count; i += step) {
    const [x, y, z] = [rows[i * 4]! * scale, rows[i * 4 + 1]! * scale, rows[i * 4 + 2]! * scale];
    if (Math.hypot(x, y) > 3 && Math.hypot(x, y) < 40) heights.push(z);
  }
  return heights.sort((a, b) => a - b)[Math.floor(heights.length * 0.15)] ?? -2;
}

function draw(drawer: Drawer): void {
  drawer.clear();
  const values = drawn();
  if (!values || !isRadar(values)) return;
  const area = rect();
  if (map) drawer.radar(area, map.picture.polar, map.picture.rows, map.picture.columns, view, map.window);
  const stored = model.state?.stored;
  if (!map && echoes && stored) drawer.above(area, echoes.places, { colour: echoes.places.value ? "value" : [1, 0.6, 0.1, 1], size: 7, low: -1000, reach: 80, row: 2 }, poseOf(stored), view);
  if (lidar) drawer.above(area, lidar.places, { colour: model.blink ? [1, 0.45, 0.4, 0.9] : [1, 1, 1, 0.85], size: 1.7, low: lidar.low, reach: 80, row: 0 }, poseOf(values), view);
  lines(values);
}

function lines(values: RadarValues): void {
  const canvas = byId("lines") as HTMLCanvasElement;
  [canvas.width, canvas.height] = [canvas.clientWidth, canvas.clientHeight];
  const paper = canvas.getContext("2d")!;
  paper.clearRect(0, 0, canvas.width, canvas.height);
  paper.strokeStyle = "#8b98a755";
  paper.fillStyle = "#8b98a7";
  paper.font = "11px system-ui, sans-serif";
  const [left, top] = toScreen([0, 0]);
  for (const ring of [10, 20, 30, 50, 70]) {
    paper.beginPath();
    paper.arc(left, top, ring * view.scale, -Math.PI, 0);
    paper.stroke();
    paper.fillText(`${ring} m`, left + 4, top - ring * view.scale - 3);
  }
  axes(paper, [0, 0], 0, "#ffb347", "radar");
  axes(paper, [values.x_m, values.y_m], values.yaw_rad, "#ffffff", "lidar");
  if (model.blink) return;
  for (const { lidar_m, radar_m } of model.residuals?.pairs ?? []) {
    const [a, b] = [toScreen(lidar_m), toScreen(radar_m)];
    paper.lineWidth = 2;
    paper.strokeStyle = "#56b4e9";
    paper.beginPath();
    paper.moveTo(...a);
    paper.lineTo(...b);
    paper.stroke();
    circle(paper, b, 6, "#ffb347");
    circle(paper, a, 3, "#56b4e9");
  }
  paper.lineWidth = 1;
}

function circle(paper: CanvasRenderingContext2D, [x, y]: [number, number], radius: number, colour: string): void {
  paper.strokeStyle = colour;
  paper.lineWidth = 1.5;
  paper.beginPath();
  paper.arc(x, y, radius, 0, 2 * Math.PI);
  paper.stroke();
}

function axes(paper: CanvasRenderingContext2D, at: [number, number], yaw: number, colour: string, name: string): void {
  const [a, b] = [toScreen(at), toScreen([at[0] + 2.5 * Math.cos(yaw), at[1] + 2.5 * Math.sin(yaw)])];
  const c = toScreen([at[0] - 1.2 * Math.sin(yaw), at[1] + 1.2 * Math.cos(yaw)]);
  paper.strokeStyle = colour;
  paper.fillStyle = colour;
  paper.lineWidth = 2;
  paper.beginPath();
  paper.moveTo(...b);
  paper.lineTo(...a);
  paper.lineTo(...c);
  paper.stroke();
  paper.fillText(name, a[0] + 6, a[1] + 13);
  paper.lineWidth = 1;
}

/** Left drag moves the cloud, with Ctrl it turns about the LiDAR; right drag or Shift moves the view, the wheel its scale. */
function listen(main: HTMLElement): void {
  let last: [number, number] | null = null;
  let how: "cloud" | "turn" | "view" = "view";
  const here = (event: PointerEvent | WheelEvent): [number, number] => {
    const box = main.getBoundingClientRect();
    return [event.clientX - box.x, event.clientY - box.y];
  };
  main.addEventListener("contextmenu", (event) => event.preventDefault());
  main.addEventListener("pointerdown", (event) => {
    how = event.button !== 0 || event.shiftKey ? "view" : event.ctrlKey || event.metaKey ? "turn" : "cloud";
    if (how !== "view" && (!model.state?.ready || model.job)) how = "view";
    last = here(event);
    const before = model.values;
    if (how !== "view") begin(() => { last = null; giveBack(before); });
    main.setPointerCapture(event.pointerId);
  });
  main.addEventListener("pointermove", (event) => {
    if (!last) return;
    const now = here(event);
    const [from, to] = [toGround(...last), toGround(...now)];
    last = now;
    const { values } = model;
    if (how === "view") {
      view.x -= to[0] - from[0];
      view.y -= to[1] - from[1];
      changed();
    } else if (values && isRadar(values)) {
      if (how === "cloud") move({ ...values, x_m: values.x_m + to[0] - from[0], y_m: values.y_m + to[1] - from[1] });
      else {
        const turn = Math.atan2(to[1] - values.y_m, to[0] - values.x_m) - Math.atan2(from[1] - values.y_m, from[0] - values.x_m);
        move({ ...values, yaw_rad: wrapped(values.yaw_rad + turn) });
      }
    }
  });
  main.addEventListener("pointercancel", () => void cancelGesture());
  main.addEventListener("pointerup", () => {
    end();
    if (last && how !== "view" && model.moving && model.values) keep(model.values);
    last = null;
  });
  main.addEventListener("wheel", (event) => {
    event.preventDefault();
    const at = here(event);
    const before = toGround(...at);
    view.scale = Math.min(120, Math.max(3, view.scale * Math.exp(-event.deltaY / 600)));
    const after = toGround(...at);
    view.x += before[0] - after[0];
    view.y += before[1] - after[1];
    changed();
  }, { passive: false });
}

const AGAINST = { range: "range, m", azimuth: "azimuth, °", speed: "speed, m/s" } as const;
let against: keyof typeof AGAINST = "range";

function scatter(): HTMLElement {
  const canvas = chart(62, (paper, width, height) => {
    const rows = model.residuals?.objects ?? [];
    const value = (row: (typeof rows)[number]): number => (against === "range" ? row.range_m : against === "azimuth" ? (row.azimuth_rad * 180) / Math.PI : row.speed_m_s);
    const all = rows.map(value);
    const [low, high] = all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
    const floor = height - 12;
    paper.strokeStyle = "#48525e";
    paper.beginPath();
    paper.moveTo(0, floor / 2);
    paper.lineTo(width, floor / 2);
    paper.stroke();
    paper.fillStyle = "#ffb347cc";
    for (const row of rows) paper.fillRect(((value(row) - low) / Math.max(1e-6, high - low)) * (width - 6) + 2, floor / 2 - (Math.max(-1.6, Math.min(1.6, row.off_m)) / 1.6) * (floor / 2 - 2) - 1, 2.5, 2.5);
    paper.fillStyle = "#8b98a7";
    paper.textAlign = "left";
    paper.fillText(low.toFixed(0), 1, height - 2);
    paper.textAlign = "center";
    paper.fillText(AGAINST[against], width / 2, height - 2);
    paper.textAlign = "right";
    paper.fillText(high.toFixed(0), width - 1, height - 2);
    paper.fillText("+160 cm", width - 1, 9);
  }, "Residual in range of every matched object");
  const choose = h("select", { "aria-label": "residual against", onchange: (event: Event) => { against = (event.target as HTMLSelectElement).value as keyof typeof AGAINST; changed(); } },
    ...Object.keys(AGAINST).map((name) => h("option", { value: name }, name)));
  return h("div", {}, h("h2", { class: "with" }, "residual in range against ", choose), canvas);
}

function offsets(): HTMLElement {
  const element = h("div", { class: "offsets" });
  show(() => {
    const rows = model.state?.offsets ?? [];
    const most = Math.max(1, ...rows.map((row) => row.worse));
    const chosen = isRadar(model.values!) ? (model.values as RadarValues).frames : 0;
    fill(element, ...(rows.length ? [h("h2", {}, "frame offset: worse than the best, in sigma"), h("div", { class: "columns" }, ...rows.map((row) =>
      h("div", { class: row.frames === chosen ? "chosen" : "", title: `${row.worse.toFixed(1)} sigma` }, h("i", { "data-tall": String(row.worse / most) }), h("span", {}, `${row.frames > 0 ? "+" : ""}${row.frames}`))))] : []));
    element.querySelectorAll<HTMLElement>("i").forEach((bar) => (bar.style.height = `${2 + 22 * Number(bar.dataset.tall)}px`));
  });
  return element;
}

export function radarPage(): Drawer {
  const main = byId("main");
  const drawer = new Drawer(byId("gl") as HTMLCanvasElement);
  fill(byId("right"),
    h("h2", { title: "p radar = R(yaw) p lidar + (x, y, z)" }, "from LiDAR to radar: yaw, then x, y, z"),
    ...RADAR_FIELDS.map(valueRow),
    h("div", { class: "row" },
      button("Refine", "calib.refine", (one) => (one.disabled = !model.state?.ready || model.job !== null), "main"),
      button("Undo", "undo", (one) => (one.disabled = !model.state?.undo || model.job !== null)),
      button("Redo", "redo", (one) => (one.disabled = !model.state?.redo || model.job !== null)),
      button("Before", "calib.blink", (one) => { one.classList.toggle("on", model.blink); one.textContent = model.blink ? "After" : "Before"; }),
    ),
    progress(), h("h2", {}, "residual of matched objects, median"), figures(), histogram(), scatter(), offsets(),
    h("h2", {}, "what the data cannot tell"), notes(), saving());
  show(() => {
    draw(drawer);
    void loaded(drawer).catch((error: Error) => (missing = error.message));
    fill(byId("corner"), [model.blink ? "BEFORE: as it was at the start" : "", missing].filter(Boolean).join(" · "));
  });
  listen(main);
  new ResizeObserver(() => changed()).observe(main);
  ask();
  return drawer;
}

/** What tests wait for. */
export const radarLoaded = (): boolean => lidar?.frame === frameNow() && (map?.frame ?? echoes?.frame) === radarFrame();
export const radarView = view;
