// What the page remembers in this browser from one visit to the next: sizes and modes, nothing of the data.

const STORE = "farfield-settings ";

/** What was remembered; the usual value where there is nothing, or nothing valid. */
export function remembered<T>(name: string, usual: T, valid: (value: unknown) => boolean): T {
  try {
    const value = JSON.parse(localStorage.getItem(STORE + name) ?? "null") as unknown;
    return value !== null && valid(value) ? (value as T) : usual;
  } catch {
    return usual;
  }
}

export function remember(name: string, value: unknown): void {
  try {
    localStorage.setItem(STORE + name, JSON.stringify(value));
  } catch {
    // a browser that keeps nothing: the page works without
  }
}
