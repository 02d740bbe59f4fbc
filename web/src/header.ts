// The top line: where we are, the conditions, whether the work is saved, who else is here.

import { byId, fill, h } from "./dom";
import { makeFilm, makePage, savePicture } from "./exports";
import { run, keyFor } from "./keys";
import { newId, send } from "./socket";
import type { Stage } from "./stage";
import { changed, on, state } from "./state";

function conditions(): string {
  const found = state.shown?.frame.conditions ?? {};
  return Object.values(found).map((word) => word.replaceAll("_", " ")).join(" · ");
}

function saveState(): string {
  if (document.body.classList.contains("file")) return "a file: nothing can be changed here";
  if (state.pending > 0 && !state.connected) return `not saved: ${state.pending} edit${state.pending > 1 ? "s" : ""}`;
  if (!state.connected) return state.everConnected ? "connection lost, trying again" : "connecting";
  if (state.pending > 0) return "saving";
  return state.savedAt ? `saved ${state.savedAt}` : "";
}

function policy(): HTMLElement | null {
  if (state.mode !== "annotate" || !state.welcome) return null;
  const choose = (extent: "full" | "visible") => () => send({ op: "policy.set", id: newId(), extent });
  if (state.welcome.extent) return h("span", { class: "weak", title: "What the boxes of this data set hold, declared once" }, state.welcome.extent === "full" ? "whole bodies" : "visible parts");
  return h("span", {}, "boxes hold ", h("button", { onclick: choose("full") }, "whole bodies"), " ", h("button", { onclick: choose("visible") }, "visible parts"));
}

function draw(stage: Stage): void {
  const welcome = state.welcome;
  const frame = state.shown?.frame;
  const button = (title: string, id: string, enabled = true): HTMLElement => h("button", { onclick: () => run(id), title: `${title} (${keyFor(id)})`, disabled: !enabled }, title);
  const mode = (name: "view" | "annotate", title: string): HTMLElement =>
    h("button", { class: state.mode === name ? "on" : "", onclick: () => { state.mode = name; changed("tool", "selection", "boxes"); } }, title);
  fill(
    byId("header"),
    h("strong", {}, "farfield"),
    h("span", { class: "grow" },
      h("span", { class: "place" }, welcome ? `${welcome.title || welcome.data}` : ""),
      frame ? ` › ${frame.sequence} › ${frame.frame_id}` : "",
      frame?.simulated ? h("span", { class: "weak" }, "  simulated") : null,
      h("span", { class: "weak", id: "conditions" }, frame ? `   ${conditions()}` : ""),
    ),
    policy(),
    welcome?.mode === "annotate" ? mode("view", "View") : null,
    welcome?.mode === "annotate" ? mode("annotate", "Annotate") : null,
    h("span", { id: "saved", role: "status", class: state.pending > 0 && !state.connected ? "error" : "weak" }, saveState()),
    state.windows > 1 ? h("span", { class: "weak", id: "windows" }, `${state.windows} windows`) : null,
    state.mode === "annotate" ? button("Undo", "undo", state.undo) : null,
    state.mode === "annotate" ? button("Redo", "redo", state.redo) : null,
    state.mode === "annotate" ? button("Save", "save") : null,
    h("button", { onclick: () => void savePicture(stage), title: "Save a picture of the main view" }, "Picture"),
    state.connected ? h("button", { onclick: () => void makeFilm(stage), title: "A film of the frames from here on" }, "Film") : null,
    state.connected ? h("button", { onclick: () => makePage(), title: "This frame as one HTML file that opens from disk" }, "HTML") : null,
    h("button", { onclick: () => run("help"), title: "Keys" }, "?"),
  );
  document.title = frame ? `${frame.sequence} ${frame.frame_id} · Farfield` : "Farfield";
}

export function header(stage: Stage): void {
  on(["welcome", "frame", "connection", "saved", "tool", "tracks"], () => draw(stage));
}
