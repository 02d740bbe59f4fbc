// The top line: where we are, the conditions, whether the work is saved, who else is here.

import { holdBar } from "./bar";
import { byId, counted, fill, h } from "./dom";
import { makeFilm, makePage, savePicture } from "./exports";
import { run, keyFor } from "./keys";
import { workButton } from "./labels";
import { post } from "./post";
import { newId } from "./socket";
import type { Stage } from "./stage";
import { changed, on, state } from "./state";

function conditions(): string {
  const { conditions: found, simulated } = state.shown?.frame ?? { conditions: {}, simulated: false };
  return [simulated ? "simulated" : "", ...Object.values(found).map((word) => word.replaceAll("_", " "))].filter(Boolean).join(" · ");
}

/** What is kept where, while it is not all on the server's disk. */
function keptWhere(): string {
  if (document.body.classList.contains("file") || state.mode !== "annotate") return "";
  const count = state.pending === 0 ? "" : `${counted(state.pending, "edit is", "edits are")} kept in this browser only, not on the server's disk`;
  const unkept = state.unkept ? " This browser cannot keep them over a reload: leave the window open." : "";
  if (state.stopped) return `The studio cannot write any more edits: ${state.stopped} ${count ? `${count}; they are sent when it is started again.` : "What stands here is what is stored."}${unkept}`;
  if (!state.connected && state.everConnected)
    return `The studio does not answer. ${count ? `${count}; they are sent when it is back.` : "All edits are on its disk; what you change now is kept in this browser and sent when it is back."}${unkept}`;
  return unkept ? `${count}.${unkept}` : "";
}

function policy(): HTMLElement | null {
  if (state.mode !== "annotate" || !state.welcome) return null;
  const choose = (extent: "full" | "visible") => () => post({ op: "policy.set", id: newId(), extent });
  if (state.welcome.extent) return h("span", { class: "weak", title: "What the boxes of this data set hold, declared once" }, state.welcome.extent === "full" ? "whole bodies" : "visible parts");
  return h("span", {}, "boxes hold ", h("button", { onclick: choose("full") }, "whole bodies"), " ", h("button", { onclick: choose("visible") }, "visible parts"));
}

function draw(stage: Stage): void {
  const welcome = state.welcome;
  const frame = state.shown?.frame;
  const button = (title: string, id: string, enabled = true, words = title): HTMLElement => h("button", { onclick: () => run(id), title: `${words} (${keyFor(id)})`, disabled: !enabled }, title);
  const mode = (name: "view" | "annotate", title: string): HTMLElement =>
    h("button", { class: state.mode === name ? "on" : "", "aria-pressed": state.mode === name, onclick: () => { state.mode = name; changed("tool", "selection", "boxes"); } }, title);
  fill(
    byId("header"),
    h("h1", {}, "farfield"),
    h("span", { class: "grow", title: [welcome?.title || welcome?.data, frame?.sequence, frame?.frame_id, conditions()].filter(Boolean).join(" › ") },
      h("span", { class: "place" }, welcome ? `${welcome.title || welcome.data}` : ""),
      frame ? ` › ${frame.sequence} › ${frame.frame_id}` : "",
      h("span", { class: "weak", id: "conditions" }, frame && conditions() ? ` · ${conditions()}` : ""),
    ),
    policy(),
    welcome?.mode === "annotate" ? mode("view", "View") : null,
    welcome?.mode === "annotate" ? mode("annotate", "Annotate") : null,
    workButton(),
    state.windows > 1 ? h("span", { class: "weak", id: "windows" }, counted(state.windows, "window")) : null,
    state.mode === "annotate" ? button("Undo", "undo", state.undo) : null,
    state.mode === "annotate" ? button("Redo", "redo", state.redo) : null,
    state.mode === "annotate" ? button("Save", "save", state.labels !== null, `Write the labels to ${state.labels?.next_folder ?? ""} as ${state.labels?.next_format ?? ""}`) : null,
    h("button", { onclick: () => void savePicture(stage), title: "Save a picture of the main view" }, "Picture"),
    state.connected ? h("button", { onclick: () => void makeFilm(stage), title: "A film of the frames from here on" }, "Film") : null,
    state.connected ? h("button", { onclick: () => makePage(), title: "This frame as one HTML file that opens from disk" }, "HTML") : null,
    h("button", { class: "touch", onclick: () => run("layers"), title: `Layers and filters on or off (${keyFor("layers")})` }, "Layers"),
    h("button", { onclick: () => run("help"), title: "Keys", "aria-label": "? Keys" }, "?"),
  );
  holdBar("kept", keptWhere());
  document.title = frame ? `${frame.sequence} ${frame.frame_id} · Farfield` : "Farfield";
}

export function header(stage: Stage): void {
  new ResizeObserver(() => document.body.style.setProperty("--header", `${byId("header").offsetHeight}px`)).observe(byId("header")); // it wraps on small screens
  on(["welcome", "frame", "connection", "saved", "tool", "tracks"], () => draw(stage));
}
