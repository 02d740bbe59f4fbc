// Made by `python tools/page_protocol.py`; do not edit. Metres, radians; int64 nanoseconds are strings.

/** Of these messages; the server sends pages of another version away. */
export const VERSION = 3;

/** First message of a window. */
export interface Hello {
  op: "hello";
  window: string;
  annotator?: string;
  version?: number;
}

/** Show a frame: answered by frame.state, then by checks. ``threshold`` bounds the predicted boxes sent. ``purpose`` ahead: only the state, the window still shows another frame; here: the page has the state already. */
export interface FrameOpen {
  op: "frame.open";
  frame: number;
  threshold?: number;
  sweeps?: number;
  purpose?: "show" | "ahead" | "here";
}

/** What a person decides about a box. */
export interface BoxValue {
  box: number[];
  class_name: string;
  track?: number | null;
  state?: "proposed" | "edited" | "accepted" | "rejected";
  source?: "lidar" | "radar" | "camera" | "interpolated" | "propagated" | "predicted" | "detector";
  attributes?: Record<string, string | number | boolean | null>;
}

/** Change a box; ``base`` is the version that the page saw. ``group`` joins edits that undo together. */
export interface BoxSet {
  op: "box.set";
  id: string;
  frame: number;
  box: string;
  base: number;
  value: BoxValue;
  group?: string | null;
}

/** Add a box under an identity that the page makes up. ``fresh``: its track is to be a new object's; where the drive has one of this number by now, the box gets another. */
export interface BoxAdd {
  op: "box.add";
  id: string;
  frame: number;
  box: string;
  value: BoxValue;
  group?: string | null;
  fresh?: boolean;
}

/** Remove a box. */
export interface BoxDelete {
  op: "box.delete";
  id: string;
  frame: number;
  box: string;
  base: number;
  group?: string | null;
}

/** Accept all proposals of ``score`` or more from frame ``first`` to ``last``, in the drive of ``frame``. ``count`` and ``base`` are those of the answer to proposals.count: what was told of is accepted, nothing else. */
export interface BoxAccept {
  op: "box.accept";
  id: string;
  frame: number;
  first: number;
  last: number;
  score: number;
  count: number;
  base: number;
}

/** Set what holds for a track of a frame's drive: class, locked size, last frame. ``ends`` -1: no end. None leaves as it is. ``box``, of version ``box_base``, is that of the track that was shown in the frame. */
export interface TrackSet {
  op: "track.set";
  id: string;
  frame: number;
  track: number;
  base: number;
  class_name?: string | null;
  size_locked?: boolean | null;
  size?: number[] | null;
  ends?: number | null;
  box: string;
  box_base: number;
}

/** Make one track of a frame's drive a part of another. ``box``, of version ``box_base``: shown in the frame. */
export interface TrackMerge {
  op: "track.merge";
  id: string;
  frame: number;
  track: number;
  into: number;
  base: number;
  into_base: number;
  box: string;
  box_base: number;
}

/** Give the boxes of a track from a frame on a new number. ``box``, of version ``box_base``: shown in the frame. */
export interface TrackSplit {
  op: "track.split";
  id: string;
  track: number;
  frame: number;
  new_track: number;
  base: number;
  box: string;
  box_base: number;
}

/** Fill the frames between keyframes, from ``first`` to ``last``. ``box`` is that of the track in the ``frame`` that was shown, ``base`` its version there. */
export interface TrackInterpolate {
  op: "track.interpolate";
  id: string;
  frame: number;
  box: string;
  base: number;
  track: number;
  first: number;
  last: number;
}

/** Carry a track on by its motion, from frame ``first`` to ``last`` (backwards if it is smaller). ``box`` is that of the track in ``first``, ``base`` its version that was shown. To the next frame it always comes: where its points do not decide, its motion does, and the box's source is ``predicted``. */
export interface TrackPropagate {
  op: "track.propagate";
  id: string;
  box: string;
  base: number;
  track: number;
  first: number;
  last: number;
  fit?: boolean;
}

/** A box while it is dragged: passed on to the other windows, stored nowhere. */
export interface Preview {
  op: "preview";
  frame: number;
  box: string;
  value: number[];
}

/** Find a box at a gesture. ``at``: click x y; drag x0 y0 x1 y1 along the heading; rectangle: four corners x y. ``kind`` refit takes ``around`` (the box as it stands); peak is a radar's peak at x y. */
export interface Fit {
  op: "fit";
  id: string;
  frame: number;
  kind: "click" | "drag" | "rectangle" | "refit" | "peak";
  at?: number[];
  class_name: string;
  type_name?: string;
  track?: number | null;
  around?: number[] | null;
  keep_size?: boolean;
}

/** Take back the last edit of mine (or of anybody). */
export interface Undo {
  op: "undo";
  id: string;
  scope?: "mine" | "all";
  force?: boolean;
}

/** Do again what was taken back last. */
export interface Redo {
  op: "redo";
  id: string;
  scope?: "mine" | "all";
  force?: boolean;
}

/** Ask how many proposals of a score or more a frame and its drive have; answered by proposals. */
export interface ProposalsCount {
  op: "proposals.count";
  id: string;
  frame: number;
  score: number;
}

/** Ask for the findings of the whole drive of a frame, and to be told from then on what changes of them. */
export interface CheckList {
  op: "check.list";
  frame: number;
}

/** Let a finding stand, with a reason; an empty reason brings it back. */
export interface CheckIgnore {
  op: "check.ignore";
  id: string;
  check: string;
  reason: string;
}

/** Detect in frames; ``propose`` adds the boxes above the threshold as proposals to the annotation. */
export interface InferStart {
  op: "infer.start";
  id: string;
  detector: string;
  first: number;
  last: number;
  threshold?: number;
  propose?: boolean;
}

/** Stop a job. */
export interface InferCancel {
  op: "infer.cancel";
  id: string;
  job: string;
}

/** Bookmark a frame; ``note`` None takes the bookmark away. */
export interface BookmarkSet {
  op: "bookmark.set";
  id: string;
  frame: number;
  note?: string | null;
}

/** Choose where labels are written to and in which format, for all windows, and whether also when the studio ends. ``format`` empty: their own; ``folder``: a name beside the data set's other saves; None: where saves go. */
export interface SaveChoose {
  op: "save.choose";
  id: string;
  format?: string;
  folder?: string | null;
  at_exit?: boolean;
}

/** Write the label files now, as :class:`SaveChoose` has it where neither format nor folder is given. */
export interface Save {
  op: "save";
  id: string;
  format?: string;
  folder?: string | null;
}

/** Make a file to take away: ``html`` of frames, a film of pictures sent to /shot, or labels in a format. */
export interface Export {
  op: "export";
  id: string;
  kind: "html" | "gif" | "webp" | "labels";
  frames?: number[];
  format?: string;
  name?: string;
  shots?: string[];
  rate_hz?: number;
}

/** Declare once what the boxes of the data set hold: whole bodies or visible parts. */
export interface PolicySet {
  op: "policy.set";
  id: string;
  extent: "full" | "visible";
}

/** Time that a person spent on a box: from its selection to the next, pauses left out. */
export interface Timing {
  op: "timing";
  frame: number;
  box: string;
  seconds: number;
  edits?: number;
}

/** Ask in which frames boxes are missed or detected without a truth: of predictions from a score on. */
export interface MatchList {
  op: "match.list";
  threshold?: number;
}

/** Ask for the calibration as it stands; the first one begins to read the frames. */
export interface CalibOpen {
  op: "calib.open";
  id: string;
}

/** ``p_radar = R(yaw) p_lidar + (x, y, z)``; the radar runs ``frames`` frames and ``time_offset_s`` ahead. */
export interface RadarValues {
  x_m: number;
  y_m: number;
  z_m: number;
  yaw_rad: number;
  frames: number;
  time_offset_s: number;
}

/** Intrinsics in pixels, k1 k2 p1 p2 k3, and turns in rad about, shifts in m along the axes (right, down, ahead). */
export interface CameraValues {
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  distortion: number[];
  moved: number[];
}

/** Ask for the residuals of some values, while they move; nothing is kept. */
export interface CalibMatch {
  op: "calib.match";
  id: string;
  frame: number;
  radar?: RadarValues | null;
  camera?: CameraValues | null;
  full?: boolean;
}

/** Take values: one step of undo. ``base`` is the state's ``seq`` from which they come. */
export interface CalibSet {
  op: "calib.set";
  id: string;
  base: number;
  radar?: RadarValues | null;
  camera?: CameraValues | null;
}

/** Add a pair: a point of a frame, in the LiDAR's coordinates, and its pixel. */
export interface CalibPick {
  op: "calib.pick";
  id: string;
  frame: number;
  point_m: number[];
  pixel: number[];
}

/** Take a pair away, or leave it out (``used``) or take it in again. */
export interface CalibUnpick {
  op: "calib.unpick";
  id: string;
  pick: number;
  used?: boolean | null;
}

/** Solve from the present values: by matched objects, by picked pairs, or by edges. */
export interface CalibSolve {
  op: "calib.solve";
  id: string;
  how: "objects" | "pairs" | "edges";
  focal?: boolean;
}

/** Stop a job. */
export interface CalibCancel {
  op: "calib.cancel";
  id: string;
  job: string;
}

/** Take the last change back, or do it again. */
export interface CalibUndo {
  op: "calib.undo";
  id: string;
  what: "undo" | "redo";
}

/** Write the calibration: where the data set's reader finds it, or into the folder of results. */
export interface CalibSave {
  op: "calib.save";
  id: string;
  to: "data" | "folder";
}

/** Put back what the last save replaced. */
export interface CalibRestore {
  op: "calib.restore";
  id: string;
}

/** A drive: which frames of the data set, in time order. */
export interface DriveRow {
  name: string;
  frames: number[];
  times_ns: string[] | null;
}

/** A kind of vehicle within a class, with its own preset size. */
export interface TypeSpec {
  name: string;
  size: number[];
}

/** A class: its preset size, where that is from, its colour (``#rrggbb``); ``types`` are finer sizes, as of vans. */
export interface ClassSpec {
  name: string;
  title: string;
  size: number[];
  colour: string;
  key: string;
  group: "vehicle" | "person" | "two_wheeler" | "other";
  types: TypeSpec[];
  source: string;
}

/** Boxes of a detector or a tracker, from a file or made here. */
export interface PredictionSet {
  name: string;
  title: string;
  kind: "detections" | "tracks";
  classes: string[];
  frames: number;
  protocol: string;
  colour: string;
}

/** A detector on offer. */
export interface DetectorRow {
  name: string;
  title: string;
  classes: string[];
  cloud: string;
}

/** A frame to come back to. */
export interface Bookmark {
  frame: number;
  note: string;
  by: string;
}

/** An object over its frames. ``version`` is the ``base`` of track.set. */
export interface TrackRow {
  track: number;
  class_name: string;
  version: number;
  size_locked: boolean;
  size: number[] | null;
  frames: number[];
  keyframes: number[];
  ends: number | null;
}

/** What the label files hold of the journal, and where, in which format and when the next save writes. */
export interface LabelState {
  op: "labels";
  answers: string;
  unwritten: number;
  written_ns: string | null;
  folder: string;
  format: string;
  left: number;
  next_folder: string;
  next_format: string;
  name: string | null;
  itself: boolean;
  at_exit: boolean;
}

/** Answer to hello: what is open. */
export interface Welcome {
  op: "welcome";
  version: number;
  farfield: string;
  mode: "view" | "annotate" | "calibrate";
  data: string;
  store: string;
  title: string;
  frames: number;
  drives: DriveRow[];
  labels: string[];
  classes: ClassSpec[];
  predictions: PredictionSet[];
  detectors: DetectorRow[];
  protocols: string[];
  bookmarks: Bookmark[];
  tracks: TrackRow[];
  annotator: string;
  window: string;
  windows: number;
  journal_seq: number;
  extent: "full" | "visible" | null;
  first: number;
  formats: string[];
  written: LabelState | null;
  drive: string;
  undo: boolean;
  redo: boolean;
}

/** One moment of one drive. */
export interface FrameInfo {
  index: number;
  sequence: string;
  frame_id: string;
  time_ns: string | null;
  reference: string;
  conditions: Record<string, string>;
  world_T_frame: number[] | null;
  annotated: boolean;
  simulated: boolean | null;
  metadata: Record<string, string>;
}

/** A pinhole camera: ``matrix`` fx 0 cx / 0 fy cy / 0 0 1 (row by row), ``distortion`` k1 k2 p1 p2 k3. */
export interface CameraModel {
  width_px: number;
  height_px: number;
  matrix: number[];
  distortion: number[];
  camera_T_frame: number[];
}

/** Axes of a radar map: first value and step of range (m), azimuth and elevation (rad), and their counts. A BEV-2D has rows of range and columns of azimuth; a BFS-2D rows of elevation and columns of azimuth or range. */
export interface Polar {
  range_m: number[];
  azimuth_rad: number[];
  elevation_rad: number[] | null;
}

/** Axes of a map in metres along the sensor's own axes: first value, step and count; a BFS-2D has rows of z. */
export interface Grid {
  x_m: number[] | null;
  y_m: number[] | null;
  z_m: number[] | null;
}

/** Something to show of a frame: fetched from ``url`` (relative to the page). */
export interface Layer {
  id: number;
  name: string;
  title: string;
  kind: "points" | "bev" | "bfs" | "image";
  sensor: "lidar" | "radar" | "camera";
  url: string;
  fields: string[];
  frame_T_layer: number[] | null;
  placed: boolean;
  time_ns: string | null;
  lag_ms: number | null;
  sweeps: number;
  camera: CameraModel | null;
  polar: Polar | null;
  grid: Grid | null;
  holds: string[];
  file: string;
}

/** A box of a frame as it stands. No other of the data set has its ``id``; an edit gives ``version`` as ``base``. */
export interface BoxRow {
  id: string;
  track: number | null;
  class_name: string;
  box: number[];
  version: number;
  state: "proposed" | "edited" | "accepted" | "rejected";
  source: "lidar" | "radar" | "camera" | "interpolated" | "propagated" | "predicted" | "detector";
  attributes: Record<string, string | number | boolean | null>;
  score: number | null;
  points: number | null;
  radar_points: number | null;
  distance_m: number;
  keyframe: boolean;
  visibility: string | null;
  moving: boolean | null;
  proposal: number[] | null;
}

/** A predicted box, and what the protocol makes of it. */
export interface PredictedRow {
  class_name: string;
  box: number[];
  score: number | null;
  track: number | null;
  velocity: number[] | null;
  match: "matched" | "false" | "ignored" | "unknown";
  truth: string | null;
  distance_m: number;
  points: number | null;
}

/** What a set predicts in a frame. A truth found only below the page's threshold counts as missed there. */
export interface PredictedFrame {
  set: string;
  rows: PredictedRow[];
  missed: string[];
  ignored: string[];
}

/** Where a track was and will be: frame, x, y, z in the coordinates of the frame shown. */
export interface Trail {
  set: string;
  track: number;
  points: number[][];
}

/** A frame as it stands: boxes, layers, predictions with their matching, trails. ``seq`` is the number of the last edit that it holds for sure. */
export interface FrameState {
  op: "frame.state";
  frame: FrameInfo;
  layers: Layer[];
  boxes: BoxRow[];
  predicted: PredictedFrame[];
  trails: Trail[];
  notes: string[];
  unreadable: string;
  seq: number;
}

/** What a set predicts in a frame, where it became known after the frame was opened. */
export interface Predicted {
  op: "predicted";
  frame: number;
  predicted: PredictedFrame;
  set: PredictionSet;
}

/** An edit is on the disk. Its rows follow in ``changed`` where the tool made them. */
export interface Ack {
  op: "ack";
  id: string;
  seq: number;
  version: number;
  saved_ns: string;
  row: BoxRow | null;
  undo: boolean;
  redo: boolean;
  unwritten: number;
}

/** An edit came too late: somebody changed the box since ``base``. Nothing was changed. */
export interface Conflict {
  op: "conflict";
  id: string;
  by: string;
  sentence: string;
  frame: number | null;
  present: BoxRow | null;
  track: TrackRow | null;
}

/** A message was understood and refused. */
export interface Refused {
  op: "refused";
  id: string | null;
  code: string;
  sentence: string;
  mend: string;
}

/** A box and the frame in which it stands. */
export interface PlacedRow {
  frame: number;
  row: BoxRow;
}

/** A box that is no more. */
export interface RemovedRow {
  frame: number;
  id: string;
}

/** Boxes and tracks as they now stand, after an edit of another window, of a tool, or an undo (sent to all). Its own window gets it before the ack. ``drive`` is that of the tracks. */
export interface Changed {
  op: "changed";
  seq: number;
  id: string;
  by: string;
  window: string;
  rows: PlacedRow[];
  removed: RemovedRow[];
  tracks: TrackRow[];
  drive: string;
  show: number | null;
  sentence: string;
  undo: boolean;
  redo: boolean;
  unwritten: number;
}

/** A box that somebody else is dragging. */
export interface Previewed {
  op: "previewed";
  window: string;
  frame: number;
  box: string;
  value: number[];
}

/** A box that was found, the best first. */
export interface Candidate {
  box: number[];
  score: number;
}

/** Answer to fit; ``box`` None with a sentence where nothing was found. */
export interface Fitted {
  op: "fitted";
  id: string;
  frame: number;
  box: number[] | null;
  points: number;
  candidates: Candidate[];
  ms: number;
  sentence: string;
  source: "lidar" | "radar";
}

/** How many proposals of a score or more there are: ``seq`` is the ``base``, the counts are those of box.accept. */
export interface Proposals {
  op: "proposals";
  id: string;
  frame: number;
  score: number;
  seq: number;
  here: number;
  count: number;
  frames: number;
  first: number;
  last: number;
}

/** Something that a check found. ``id`` stays the same as long as the finding does. */
export interface CheckRow {
  id: string;
  frame: number;
  box: string | null;
  track: number | null;
  check: string;
  severity: "info" | "warning" | "error";
  sentence: string;
  ignored: string | null;
  at: number[] | null;
}

/** Findings of a frame that is shown. */
export interface Checks {
  op: "checks";
  frame: number;
  rows: CheckRow[];
}

/** Findings of some frames of a drive, in place of what was known of these; for windows that asked by check.list. They come in parts, while the drive is checked and after each edit. ``drive`` is empty for frames of none. */
export interface DriveChecks {
  op: "drive.checks";
  drive: string;
  frames: number[];
  rows: CheckRow[];
  done: number;
  total: number;
}

/** How many annotated boxes of a frame a set misses, and how many of its boxes have no truth. */
export interface MatchRow {
  frame: number;
  missed: number;
  wrong: number;
}

/** Frames of one set, matched by the protocol. They come in parts; the first one replaces what was known. */
export interface Matches {
  op: "matches";
  set: string;
  first: boolean;
  rows: MatchRow[];
}

/** Progress of something that takes time. A finished detection is shown with the next frame.state. */
export interface Job {
  op: "job";
  id: string;
  job: string;
  kind: "infer" | "export" | "save" | "calibrate";
  state: "queued" | "running" | "done" | "cancelled" | "failed";
  done: number;
  total: number;
  eta_s: number | null;
  message: string;
  url: string;
  set: PredictionSet | null;
}

/** All bookmarks. */
export interface Bookmarks {
  op: "bookmarks";
  rows: Bookmark[];
  answers: string;
}

/** A box that its label file cannot hold, and why; ``box`` None where it is the file as a whole. */
export interface UnwrittenRow {
  frame: number;
  box: string | null;
  sentence: string;
}

/** Label files were written; ``unwritten`` boxes stay in the journal only, with what their files held before. */
export interface Saved {
  op: "saved";
  id: string;
  seq: number;
  files: number;
  saved_ns: string;
  folder: string;
  sentence: string;
  unwritten: UnwrittenRow[];
}

/** How many windows are open, and who else is there. */
export interface Windows {
  op: "windows";
  count: number;
  annotators: string[];
}

/** What the boxes hold: declared. */
export interface PolicyIs {
  op: "policy";
  extent: "full" | "visible";
}

/** Something went wrong: what, and how to fix it. */
export interface Failure {
  op: "error";
  sentence: string;
  mend: string;
}

/** The server stops, or the page is of another version. */
export interface Bye {
  op: "bye";
  reason: string;
}

/** A frame that serves. */
export interface CalibFrame {
  index: number;
  name: string;
  number: number;
}

/** A picked pair and how far its point falls from its pixel. */
export interface PickRow {
  pick: number;
  frame: number;
  point_m: number[];
  pixel: number[];
  used: boolean;
  residual_px: number | null;
  range_m: number;
}

/** By how many standard errors a frame offset explains the objects worse than the chosen one. */
export interface OffsetScore {
  frames: number;
  worse: number;
}

/** The calibration as it stands. */
export interface CalibState {
  op: "calib.state";
  kind: "radar-lidar" | "lidar-camera";
  answers: string;
  seq: number;
  ready: boolean;
  radar: RadarValues | null;
  camera: CameraValues | null;
  before: RadarValues | CameraValues;
  stored: RadarValues | null;
  start: CameraModel | null;
  sensor: string;
  lidar: string;
  frames: CalibFrame[];
  numbers: Record<string, number>;
  picks: PickRow[];
  solved: string;
  offsets: OffsetScore[];
  notes: string[];
  undo: boolean;
  redo: boolean;
  unsaved: boolean;
  restorable: boolean;
  saves_to: string[];
  not_saved: string;
  folder: string;
}

/** A number to show. */
export interface Figure {
  name: string;
  value: number | null;
  unit: string;
}

/** A histogram: ``limits`` has one number more than ``counts``. */
export interface Bars {
  limits: number[];
  counts: number[];
  unit: string;
}

/** How well a parameter is known: ``observed`` is the data's share of what is known, 0 to 1. */
export interface Known {
  name: string;
  unit: string;
  sigma: number | null;
  prior: number;
  observed: number;
}

/** The residual of one matched object, with what it may depend on. */
export interface ResidualPoint {
  range_m: number;
  azimuth_rad: number;
  speed_m_s: number;
  off_m: number;
  off_rad: number;
}

/** An object of both sensors in the frame that is shown, in the radar's coordinates. */
export interface MatchedPair {
  lidar_m: number[];
  radar_m: number[];
}

/** What the data say of some values. */
export interface Residuals {
  figures: Figure[];
  histogram: Bars | null;
  known: Known[];
  notes: string[];
  objects: ResidualPoint[];
  pairs: MatchedPair[];
  lacking: string;
}

/** Residuals of the values that were asked for. */
export interface CalibResidual {
  op: "calib.residual";
  id: string;
  frame: number;
  residuals: Residuals;
  milliseconds: number;
}

/** Files were written or put back. */
export interface CalibSaved {
  op: "calib.saved";
  id: string;
  files: string[];
  copies: string[];
  restored: boolean;
}

export type Request =
  | Hello
  | FrameOpen
  | BoxSet
  | BoxAdd
  | BoxDelete
  | BoxAccept
  | TrackSet
  | TrackMerge
  | TrackSplit
  | TrackInterpolate
  | TrackPropagate
  | Preview
  | Fit
  | Undo
  | Redo
  | ProposalsCount
  | CheckList
  | CheckIgnore
  | InferStart
  | InferCancel
  | BookmarkSet
  | SaveChoose
  | Save
  | Export
  | PolicySet
  | Timing
  | MatchList
  | CalibOpen
  | CalibMatch
  | CalibSet
  | CalibPick
  | CalibUnpick
  | CalibSolve
  | CalibCancel
  | CalibUndo
  | CalibSave
  | CalibRestore;

export type Reply =
  | Welcome
  | LabelState
  | FrameState
  | Predicted
  | Ack
  | Conflict
  | Refused
  | Changed
  | Previewed
  | Fitted
  | Proposals
  | Checks
  | DriveChecks
  | Matches
  | Job
  | Bookmarks
  | Saved
  | Windows
  | PolicyIs
  | Failure
  | Bye
  | CalibState
  | CalibResidual
  | CalibSaved;
