// What the page knows, in one place; whoever shows a part listens to its topic.

import type { Box } from "./boxes";
import type { BoxRow, Bookmark, CheckRow, DriveRow, FrameState, Job, LabelState, PredictedRow, PredictionSet, TrackRow, Welcome } from "./protocol";

export type Topic =
  | "welcome" | "frame" | "boxes" | "selection" | "looks" | "filters" | "checks" | "connection" | "jobs" | "tracks" | "bookmarks" | "tool" | "play" | "saved" | "drawn"; // drawn: another frame's picture stands

export interface LayerLook {
  visible: boolean;
  opacity: number;
  side: 0 | 1 | 2; // 0 both panes, 1 left, 2 right
}

export type Tool = "none" | "draw" | "measure";

export interface Filters {
  hidden: Set<string>;
  score: number;
  range: [number, number];
  visibility: Set<string>;
}

export const state = {
  welcome: null as Welcome | null,
  mode: "view" as Welcome["mode"],
  frame: 0,
  shown: null as FrameState | null, // the frame whose boxes stand on the page; another one than `frame` while that is on its way
  drawnFrame: -1, // the frame whose picture stands on the page
  boxes: [] as BoxRow[],
  tracks: new Map<number, TrackRow>(), // of the drive
  drive: "",
  bookmarks: [] as Bookmark[],
  checks: [] as CheckRow[], // of the drive, as far as it is checked
  hints: true, // whether what is only worth a look is listed
  predictions: [] as PredictionSet[],
  jobs: new Map<string, Job>(),
  selection: null as string | null,
  selectedIn: -1, // the frame whose box that is: in others the same identity may be another object's
  carried: null as { track: number; class_name: string } | null, // the selected object, also in frames that have no box of it
  chosenClass: "",
  chosenType: "",
  tool: "none" as Tool,
  looks: new Map<string, LayerLook>(),
  colour: "height",
  window: null as [number, number] | null,
  pointSize: 1.5,
  grow: true,
  sweeps: 1,
  powerGate: null as number | null, // share of a radar's points left out, the weakest first; null: as many as make 9,000 remain
  showTruth: true,
  showMissed: true,
  showTrails: true,
  showRings: true,
  showLabels: true,
  onlySelection: false,
  sideBySide: false,
  setSides: new Map<string, 0 | 1 | 2>(),
  hiddenSets: new Set<string>(),
  filters: { hidden: new Set<string>(), score: 0.3, range: [0, 400], visibility: new Set<string>() } as Filters,
  follow: false,
  playing: false,
  direction: 1,
  rate: 10,
  windows: 1,
  connected: false,
  everConnected: false,
  pending: 0,
  labels: null as LabelState | null, // what the label files hold, and what the next save does
  stopped: "", // why the server takes no more edits
  unkept: false, // whether the browser cannot keep the edits that wait
  note: null as { id: string; text: string } | null, // what is wrong with what was typed for a box
  undo: false,
  redo: false,
  takenBack: 0, // undos and redos that the server did for this window
  jump: null as { frame: number; box: string } | null, // a box to select when its frame stands
  tape: [] as [number, number, number][],
};

const listeners = new Map<Topic, Set<() => void>>();
const waiting = new Set<Topic>();

export function on(topics: Topic | Topic[], listener: () => void): void {
  for (const topic of [topics].flat()) {
    if (!listeners.has(topic)) listeners.set(topic, new Set());
    listeners.get(topic)!.add(listener);
  }
}

/** Say that a part changed; listeners run once, at the end of this turn. */
export function changed(...topics: Topic[]): void {
  if (waiting.size === 0) queueMicrotask(flush);
  topics.forEach((topic) => waiting.add(topic));
}

function flush(): void {
  const run = new Set<() => void>();
  for (const topic of waiting) listeners.get(topic)?.forEach((listener) => run.add(listener));
  waiting.clear();
  run.forEach((listener) => listener());
}

export const boxOf = (row: { box: number[] }): Box => row.box as unknown as Box;

export function selected(): BoxRow | null {
  return state.boxes.find((row) => row.id === state.selection) ?? null;
}

/** Number of the frame whose boxes stand on the page; -1: none. */
export const shownFrame = (): number => state.shown?.frame.index ?? -1;

/** The drive of a frame: track numbers are its own. */
export const driveOf = (frame: number): DriveRow | undefined => state.welcome?.drives.find((one) => one.frames.includes(frame));

function carry(row: BoxRow | null): void {
  state.carried = row === null || row.track === null ? null : { track: row.track, class_name: row.class_name };
}

export function select(id: string | null): void {
  if (state.selection === id && state.selectedIn === shownFrame() && (id !== null || state.carried === null)) return;
  state.selection = id;
  state.selectedIn = shownFrame();
  carry(selected());
  changed("selection");
}

/** What is shown no longer is not changed by the next key: it is deselected. */
function dropHidden(hidden: (row: BoxRow) => boolean): void {
  const row = state.selectedIn === shownFrame() ? selected() : null;
  if (row && hidden(row)) select(null);
}

/** A selected object stays selected in the next frame by its track number, never by the identity of its box. */
export function keepSelection(): void {
  on("boxes", () => dropHidden((row) => row.state === "rejected"));
  on("filters", () => dropHidden((row) => !shownBoxes().includes(row)));
  on(["frame", "selection", "boxes"], () => {
    if (state.selectedIn === shownFrame()) {
      const row = selected();
      if (row) carry(row); // its track or class may have been changed
      return;
    }
    if (driveOf(state.selectedIn) !== driveOf(shownFrame())) state.carried = null;
    state.selectedIn = shownFrame();
    const next = state.boxes.find((row) => state.carried !== null && row.track === state.carried.track)?.id ?? null;
    if (next === state.selection) return;
    state.selection = next;
    changed("selection");
  });
}

export function colourOf(name: string): string {
  const found = state.welcome?.classes.find((spec) => spec.name === name);
  return found?.colour ?? "#c8c8c8";
}

export function titleOf(name: string): string {
  return state.welcome?.classes.find((spec) => spec.name === name)?.title || name;
}

function passes(row: { class_name: string; distance_m: number }): boolean {
  const { hidden, range } = state.filters;
  return !hidden.has(row.class_name) && row.distance_m >= range[0] && row.distance_m <= range[1];
}

/** The annotated boxes that the filters let through. */
export function shownBoxes(): BoxRow[] {
  const { visibility } = state.filters;
  return state.boxes.filter(
    (row) =>
      passes(row) &&
      row.state !== "rejected" &&
      !(row.visibility !== null && visibility.has(row.visibility)) &&
      (!state.onlySelection || row.id === state.selection),
  );
}

export function shownPredictions(pane: number): { set: PredictionSet | undefined; name: string; rows: PredictedRow[]; missed: string[] }[] {
  const out = [];
  for (const found of state.shown?.predicted ?? []) {
    if (state.hiddenSets.has(found.set)) continue;
    const side = state.setSides.get(found.set) ?? 0;
    if (state.sideBySide && side !== 0 && side !== pane + 1) continue;
    const set = state.predictions.find((one) => one.name === found.set);
    const rows = found.rows.filter((row) => passes(row) && (row.score === null || row.score >= state.filters.score));
    out.push({ set, name: found.set, rows, missed: found.missed });
  }
  return out;
}

export function lookOf(name: string, kind: string, visible?: boolean): LayerLook {
  const key = `${kind} ${name}`;
  let look = state.looks.get(key);
  if (!look) state.looks.set(key, (look = { visible: visible ?? true, opacity: kind === "bev" ? 0.7 : 1, side: 0 }));
  return look;
}
