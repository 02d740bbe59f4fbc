"""A link that delays, loses and repeats what the studio's page sends and gets: a script for the page itself."""

ROUGH_LINK = """
(() => {
  // Times in milliseconds; shares from 0 to 1. A run with the same seed draws the same numbers.
  const link = { least: 0, most: 0, lose: 0, repeat: 0, seed: 1, sent: [], lost: 0, repeated: 0, conflicts: 0 };
  link.closes = [];
  link.fits = new Set(); // that were asked for, and whose answers are still on their way: a box may come of each
  window.roughLink = link;
  const draw = () => { link.seed = (link.seed * 48271) % 2147483647; return link.seed / 2147483647; };
  const delay = () => link.least + (link.most - link.least) * draw();
  let due = { up: 0, down: 0 };
  const later = (way, act) => {
    const wait = delay();
    if (wait === 0 && due[way] <= performance.now()) return act();
    due[way] = Math.max(due[way], performance.now() + wait);
    setTimeout(act, due[way] - performance.now());
  };
  const pass = (way, keep, act, lost = () => undefined) => {
    if (!keep && draw() < link.lose) { link.lost += 1; return lost(); }
    later(way, act);
    if (!keep && draw() < link.repeat) { link.repeated += 1; later(way, act); }
  };
  const answer = (text) => /"op":"(fitted|refused)"/.test(text) && link.fits.delete(JSON.parse(text).id);
  const Real = window.WebSocket;
  window.WebSocket = class extends Real {
    constructor(...rest) {
      super(...rest);
      link.opened = performance.now();
      super.addEventListener("close", (event) => link.closes.push([event.code, event.reason, performance.now()]));
      super.addEventListener("close", () => link.fits.clear());
      super.onmessage = (event) => {
        const keep = /^{"n":[0-9]+,"op":"(welcome|bye)"/.test(event.data);
        if (event.data.includes('"op":"conflict"')) link.conflicts += 1;
        const tell = () => {
          if (this.told && this.readyState === Real.OPEN) this.told(event);
          answer(event.data);
        };
        pass("down", keep, tell, () => answer(event.data));
      };
    }
    set onmessage(told) { this.told = told; }
    send(text) {
      const message = JSON.parse(text);
      link.sent.push(message);
      const keep = message.op === "hello" || message.op === "preview";
      if (message.op === "fit") link.fits.add(message.id);
      pass("up", keep, () => this.readyState === Real.OPEN && super.send(text), () => link.fits.delete(message.id));
    }
  };
  const fetched = window.fetch.bind(window);
  window.fetch = async (...rest) => {
    await new Promise((go) => setTimeout(go, delay()));
    return fetched(...rest);
  };
})();
"""
