// The one gesture of the mouse that goes on: it ends whole or is given up whole, whatever comes between.

let giveUp: (() => void) | null = null;

/** A gesture begins; what it is to do if it is given up. One that still goes on is given up. */
export function begin(cancel: () => void): void {
  cancelGesture();
  giveUp = cancel;
}

/** Whether a gesture goes on: a second finger does nothing meanwhile. */
export const goesOn = (): boolean => giveUp !== null;

/** The gesture came to its end by itself. */
export function end(): void {
  giveUp = null;
}

/** Give up the gesture that goes on; whether there was one. */
export function cancelGesture(): boolean {
  const cancel = giveUp;
  giveUp = null;
  cancel?.();
  return cancel !== null;
}

window.addEventListener("blur", cancelGesture);
