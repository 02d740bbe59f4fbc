// The box that `?` opens on every page: keys and what they do. A dialog: Tab stays in it, and what lies behind it waits.

import "./keybox.css";
import { fill, h } from "./dom";

export interface KeyGroup {
  title: string;
  rows: [string, string][];
}

const box = h("dialog", { id: "help", "aria-labelledby": "help-title" });

/** Open the box, or close it. */
export function toggleKeys(title: string, note: string, groups: KeyGroup[]): void {
  if (box.open) return box.close();
  if (!box.isConnected) document.body.append(box);
  fill(box,
    h("div", { class: "top" }, h("h2", { id: "help-title" }, title), h("button", { onclick: () => box.close() }, "Close (Esc)")),
    h("p", { class: "weak" }, note),
    h("div", { class: "groups" }, ...groups.map((group) =>
      h("section", {}, group.title ? h("h3", {}, group.title) : null, ...group.rows.map(([names, what]) => h("div", { class: "key" }, h("kbd", {}, names), h("span", {}, what)))))));
  box.showModal();
}
