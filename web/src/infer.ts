// Detection from the page: a detector, the frame or the drive, progress, cancel. Two sets of boxes stand side by side if wanted.

import { driveEnd } from "./annotate";
import { report } from "./bar";
import { counted, h } from "./dom";
import { refresh } from "./frames";
import type { Job } from "./protocol";
import { post } from "./post";
import { newId, onReply, send } from "./socket";
import { changed, state } from "./state";

const choice = { detector: "", threshold: 0.1, propose: false };

function start(first: number, last: number): void {
  const detector = choice.detector || state.welcome!.detectors[0]!.name;
  post({ op: "infer.start", id: newId(), detector, first, last, threshold: choice.threshold, propose: choice.propose });
  if (!state.connected) report("warning", "Not connected: detection starts when the studio is back.");
}

function jobRow(job: Job): HTMLElement {
  const bar = h("progress", { max: Math.max(1, job.total), value: job.done });
  const eta = job.eta_s === null ? "" : `, ${job.eta_s < 90 ? `${job.eta_s.toFixed(0)} s` : `${(job.eta_s / 60).toFixed(0)} min`} left`;
  const cancel = h("button", { onclick: () => send({ op: "infer.cancel", id: newId(), job: job.job }) }, "Cancel");
  return h("div", { class: "job" }, h("div", {}, job.message || job.kind, h("span", { class: "weak" }, ` ${job.done}/${job.total}${eta}`)), bar, job.kind === "infer" ? cancel : null);
}

/** The panel's elements; null where no detector is on offer and no job runs. */
export function refreshInference(): HTMLElement | null {
  const detectors = state.welcome?.detectors ?? [];
  const running = [...state.jobs.values()].filter((job) => job.state === "queued" || job.state === "running");
  if (!state.connected || (detectors.length === 0 && running.length === 0)) return null;
  const select = h("select", { name: "detector", "aria-label": "detector", onchange: () => (choice.detector = select.value) },
    ...detectors.map((row) => h("option", { value: row.name, selected: row.name === choice.detector, title: row.cloud }, row.title || row.name)));
  const threshold = h("input", { type: "number", min: 0, max: 1, step: 0.05, value: String(choice.threshold), title: "least score kept", onchange: () => (choice.threshold = Number(threshold.value)) });
  const propose = h("input", { type: "checkbox", checked: choice.propose, onchange: () => (choice.propose = propose.checked) });
  return h("div", { id: "infer" },
    h("h2", {}, "Detect"),
    detectors.length > 0 ? h("div", {}, select,
      h("label", {}, "score ≥", threshold),
      state.mode === "annotate" ? h("label", {}, propose, "as proposals") : null,
      h("div", { class: "menu" },
        h("button", { onclick: () => start(state.frame, state.frame) }, "This frame"),
        h("button", { onclick: () => start(state.frame, driveEnd()) }, "To the end of the drive"))) : null,
    ...running.map(jobRow));
}

onReply("job", (message) => {
  state.jobs.set(message.job, message);
  if (message.kind === "infer") inferred(message);
  changed("jobs");
});

function inferred(job: Job): void {
  if (job.set && !state.predictions.some((one) => one.name === job.set!.name)) {
    state.predictions = [...state.predictions, job.set];
    const made = state.predictions.filter((set) => set.kind === "detections");
    if (made.length === 2 && state.sideBySide) made.forEach((set, i) => state.setSides.set(set.name, (i + 1) as 1 | 2));
  }
  if (job.state === "failed") report("error", job.message || "The detection failed.");
  if (job.state === "done" || job.state === "cancelled") {
    report("info", `${job.state === "done" ? "Detected in" : "Stopped after"} ${job.done} of ${counted(job.total, "frame")}.`);
    refresh();
  }
}
