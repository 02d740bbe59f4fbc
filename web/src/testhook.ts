// What tests read, only with ?test=1: the events themselves are real mouse and keys.

import { fitTimes, sketch } from "./annotate";
import type { Vec3 } from "./boxes";
import type { CloseUps } from "./closeups";
import type { Name } from "./closeviews";
import { hold } from "./edits";
import { awaited } from "./frames";
import { cached } from "./loader";
import { Projector } from "./project";
import type { Stage } from "./stage";
import { state } from "./state";

export function offerTest(stage: Stage, closeUps: CloseUps): void {
  if (new URL(location.href).searchParams.get("test") !== "1") return;
  const waitIdle = async (): Promise<number> => {
    const started = performance.now();
    const settled = (): boolean => stage.idle && state.shown !== null && state.shown.frame.index === state.frame && stage.drawn.frame === state.frame && stage.drawn.whole && state.pending === 0 && !awaited();
    while (!settled()) {
      if (performance.now() - started > 30_000) throw new Error(`not idle: ${JSON.stringify({ idle: stage.idle, frame: state.frame, drawn: stage.drawn, pending: state.pending })}`);
      await new Promise((resolve) => setTimeout(resolve, 15));
    }
    return performance.now() - started;
  };
  const project = (p: Vec3, pane = 0): [number, number] | null => {
    const found = stage.panes()[pane]!;
    return new Projector(found.camera, found.rect).point(p);
  };
  const fence = (): void => {
    const gl = stage.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  };
  /** Milliseconds of whole renders, each waited for. */
  const fenced = (times: number): number[] =>
    Array.from({ length: times }, () => {
      const started = performance.now();
      stage.whole();
      fence();
      return performance.now() - started;
    });
  /** Milliseconds from the next key to the frame that it asks for, drawn with all its points. */
  const keyToFrame = (): Promise<number> =>
    new Promise((resolve) => {
      window.addEventListener("keydown", () => {
        const started = performance.now();
        const before = state.frame;
        const look = (): void => {
          if (state.frame !== before && stage.drawn.frame === state.frame && stage.drawn.whole) fence(), resolve(performance.now() - started);
          else setTimeout(look, 1);
        };
        setTimeout(look, 0);
      }, { once: true, capture: true });
    });
  Object.assign(window, {
    farfieldTest: {
      state, stage, waitIdle, project, fitTimes, sketch, fenced, keyToFrame,
      drawn: () => ({ ...stage.drawn }),
      colours: () => stage.coloursNow(),
      closeUp: (name: Name, p: Vec3) => closeUps.pixel(name, p),
      closeRadar: () => closeUps.radar,
      closePoints: () => closeUps.count,
      look: (target: Vec3, distance: number, top: boolean) => { stage.eye.frame(target, distance); stage.eye.top = top; stage.eye.azimuth = Math.PI; stage.touch(); },
      cached, hold,
    },
  });
}
