// What a person takes away: a picture, a film of frames, one HTML file.

import { report } from "./bar";
import { h } from "./dom";
import { show } from "./frames";
import { post } from "./post";
import { newId, onReply } from "./socket";
import type { Stage } from "./stage";
import { changed, state } from "./state";

const FILM_FRAMES = 100;

export function download(url: string, name: string): void {
  const link = h("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
}

const fileName = (ending: string): string => {
  const frame = state.shown?.frame;
  return `${frame?.sequence ?? "farfield"}-${frame?.frame_id ?? ""}`.replace(/[^A-Za-z0-9._-]+/g, "_").slice(0, 58) + ending;
};

export async function savePicture(stage: Stage): Promise<void> {
  const url = URL.createObjectURL(await stage.picture());
  download(url, fileName(".png"));
  window.setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Resolves when the frame is drawn. */
export function shownFrame(stage: Stage, frame: number, limit = 20_000): Promise<void> {
  const until = performance.now() + limit;
  return new Promise((resolve, reject) => {
    const look = (): void => {
      if (state.shown?.frame.index === frame && stage.drawn.frame === frame) resolve();
      else if (performance.now() > until) reject(new Error(`frame ${frame + 1} did not arrive`));
      else window.setTimeout(look, 20);
    };
    show(frame);
    look();
  });
}

async function upload(picture: Blob): Promise<string> {
  const answer = await fetch("shot", { method: "POST", body: picture });
  if (!answer.ok) throw new Error(`the picture was refused: ${(await answer.text()).slice(0, 200)}`);
  return ((await answer.json()) as { shot: string }).shot;
}

/** Every frame from this one on, at most a hundred, as the main view shows it. */
export async function makeFilm(stage: Stage): Promise<void> {
  const first = state.frame;
  const last = Math.min((state.welcome?.frames ?? 1) - 1, first + FILM_FRAMES - 1);
  const shots: string[] = [];
  const frames: number[] = [];
  try {
    for (let frame = first; frame <= last; frame += 1) {
      await shownFrame(stage, frame);
      shots.push(await upload(await stage.picture()));
      frames.push(frame);
      if (frame % 5 === 0) report("info", `Film: frame ${frame - first + 1} of ${last - first + 1}`);
    }
    post({ op: "export", id: newId(), kind: "gif", frames, shots, name: fileName(""), rate_hz: state.rate });
  } catch (error) {
    report("error", `The film stopped: ${(error as Error).message}.`);
  }
  show(first);
}

export function makePage(): void {
  post({ op: "export", id: newId(), kind: "html", frames: [state.frame], name: fileName("") });
}

onReply("job", (message) => {
  if (message.kind !== "export") return;
  if (message.state === "failed") report("error", message.message || "The export failed.");
  if (message.state === "done" && message.url) {
    download(message.url, fileName(""));
    report("info", message.message || "Exported: see the browser's downloads.");
  }
  changed("jobs");
});
