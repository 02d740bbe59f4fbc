"""Hands that do anything at the studio's page, over a bad link, with a server that dies and a disk that fills up.

What they do is judged by the model of :mod:`_studio_shown`. All keys of web/src/keys.json are pressed, and more than
one thing happens at once: drags are interrupted, windows reloaded and resized in their midst, two fingers touch.
"""

import contextlib
import json
import os
import resource
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from _report import ROOT
from _studio_process import Started, started, window
from _studio_rough_link import ROUGH_LINK
from _studio_scenes import write_folder
from _studio_screen import Screen, screen
from _studio_shown import MOVES, NUMBERS, SIZES, TURNS, compare, journal, judge, moved_from_docs, own_fault

from farfield.datasets import open_dataset

WITNESS = (
    ROUGH_LINK
    + """
(() => {
  const seen = (window.witness = []);
  let last = null;
  const text = (query) => document.querySelector(query)?.textContent ?? "";
  const look = () => {
    const chosen = document.querySelector("#objects tr.chosen");
    const fields = {};
    const inputs = document.querySelectorAll("#inspector .numbers input"); // of a bad one a sentence says that it fails
    for (const one of inputs) fields[one.name] = one.classList.contains("bad") ? NaN : Number(one.value);
    const place = text("#header .grow").split("›").map((part) => part.trim().split(/\\s/)[0]);
    const over = document.querySelector("#over")?.className ?? "";
    const wall = [...document.querySelectorAll("#over.wall canvas")].map((one) => one.dataset.frame);
    return { frame: place[2] ?? "", box: chosen ? chosen.dataset.box : null, fields, help: /help/.test(over), wall };
  };
  const note = (event) => {
    const entry = { at: performance.now(), type: event.type, code: event.code ?? "" };
    Object.assign(entry, { shift: event.shiftKey, alt: event.altKey, ctrl: event.ctrlKey });
    const words = event.type === "click" ? event.target.textContent : "";
    entry.keep = words === "Keep mine"; // a conflict's bar, of any frame
    entry.again = words === "Undo it all the same";
    entry.tile = event.target?.closest?.("#over.wall canvas") ? Number(event.target.dataset.frame) : -1;
    entry.before = look();
    if (last) last.after ??= entry.before;
    last = entry;
    seen.push(entry);
    const after = () => { // the page's own listeners have run, and no message of the server's came between
      const view = look();
      entry.atOnce = JSON.stringify(view) !== JSON.stringify(entry.before);
      if (entry.atOnce) entry.after ??= view;
    };
    window.addEventListener(event.type, after, { once: true });
    setTimeout(() => {
      window.removeEventListener(event.type, after);
      entry.after ??= look();
    }, 0);
  };
  const types = ["keydown", "pointerdown", "pointerup", "change", "click"];
  for (const type of types) window.addEventListener(type, note, true);
})();
"""
)
TABLE = json.loads((ROOT / "web" / "src" / "keys.json").read_text())
CHORDS = [
    f"{'Control+' if key.get('ctrl') else ''}{'Shift+' if key.get('shift') else ''}{key['code']}"
    for key in TABLE
    if "annotate" in key["modes"]
]
"""Every key that does something while annotating."""


@dataclass(eq=False)
class Hands:
    """One window and what is done in it.

    Args:
        screen: The window.
        rng: Draws what is done.
        done: How much was done.
        entries: What the witness saw since the last judgement.
        sent: What the page sent since then.
        names: Its names in the journal, one after each reload.
        link_counts: Messages lost, repeated, conflicts said, of pages that were reloaded.
        rest_ms: The longest pause after a gesture.
    """

    screen: Screen
    rng: np.random.Generator
    done: int = 0
    entries: list[dict[str, Any]] = field(default_factory=list)
    sent: list[dict[str, Any]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    link_counts: dict[str, int] = field(default_factory=lambda: {"lost": 0, "repeated": 0, "conflicts": 0})
    rest_ms: float = 150.0
    other: "Hands | None" = None

    def link(self, **settings: float) -> None:
        self.screen.page.evaluate(f"Object.assign(roughLink, {json.dumps(settings)})")

    def rough(self) -> None:
        """A link as it may be: up to 300 ms, at times one message in fifty lost, one in twenty twice."""
        lose, repeat = self.rng.choice([0, 0, 0, 0.02]), self.rng.choice([0, 0.05])
        most = self.rng.choice([0, 50, 300])
        seed = int(self.rng.integers(1, 2**31 - 1))
        self.link(least=0, most=int(most), lose=float(lose), repeat=float(repeat), seed=seed)

    def smooth(self) -> None:
        self.link(least=0, most=0, lose=0, repeat=0)

    def gesture(self) -> None:
        """Anything that a person may do; at times two things at once."""
        kinds: list[tuple[float, Callable[[], None]]] = [
            (0.18, self._go),
            (0.1, self._select),
            (0.25, self._nudge),
            (0.1, self._drag),
            (0.05, self._type),
            (0.06, self._work),
            (0.08, self._any_key),
            (0.04, self._carry),
            (0.03, self._draw),
            (0.03, self._click),
            (0.02, self._same),
            (0.02, self._wall),
            (0.02, self._touch),
            (0.02, self._class),
            (0.005, self._reload),
        ]
        weights = np.array([weight for weight, _ in kinds])
        kinds[self.rng.choice(len(kinds), p=weights / weights.sum())][1]()
        self.done += 1
        if self.rng.random() < 0.3:
            self.screen.page.wait_for_timeout(float(self.rng.uniform(0, self.rest_ms)))
        if self.rng.random() < 0.05:
            self._answer()

    def _any(self, *keys: str) -> str:
        return str(self.rng.choice(keys))

    def _go(self) -> None:
        if self.rng.random() < 0.1:
            self._scrub()
        else:
            self.screen.press(self._any("ArrowRight", "ArrowRight", "ArrowLeft", "ArrowLeft", "Home", "End"))

    def _scrub(self) -> None:
        area = self.screen.page.locator("#timeline canvas").first.bounding_box()
        if area:
            x = area["x"] + area["width"] * self.rng.uniform(0.02, 0.98)
            self.screen.page.mouse.click(x, area["y"] + area["height"] / 2)

    def _select(self) -> None:
        self.screen.press(self._any("ArrowDown", "ArrowDown", "ArrowUp", "Escape"))

    def _chosen(self) -> None:
        if self.rng.random() < 0.8 and self.screen.page.locator("#objects tr.chosen").count() == 0:
            self.screen.press("ArrowDown")

    def _nudge(self) -> None:
        self._chosen()
        key = self._any(*MOVES, *TURNS, *SIZES, "KeyG", "Digit1", "Digit2")
        mode = self._any("", "", "Shift+", "Alt+") if not key.startswith(("Digit", "KeyG")) else ""
        self.screen.press(mode + key)

    def _work(self) -> None:
        keys = ("z", "Shift+Z", "c", "v", "d", "l", "s")
        self.screen.press(
            self._any(*(f"Control+{key}" for key in keys), "Delete", "Delete", "k", "y", "i", "o", "x", "b")
        )

    def _any_key(self) -> None:
        self._chosen()
        self.screen.press(self._any(*CHORDS))
        if self.rng.random() < 0.5:  # it may have been the help, a tool or play
            self.screen.press("Escape")
        if self.screen.tell("state.playing"):
            self.screen.press("Space")

    def _carry(self) -> None:
        self._chosen()
        self.screen.press(*[self._any("p", "p", "p", "Shift+P")] * int(self.rng.integers(1, 4)))

    def _interruption(self) -> None:
        if self.rng.random() < 0.5:
            self.screen.press(
                self._any("Escape", "Escape", "ArrowRight", "ArrowDown", "KeyW", "Delete", "t", "Control+z")
            )
        elif self.rng.random() < 0.1:
            width, height = int(self.rng.integers(1000, 1500)), int(self.rng.integers(700, 950))
            self.screen.page.set_viewport_size({"width": width, "height": height})
        elif self.rng.random() < 0.05:  # another window of the desktop comes to the front
            self.screen.page.evaluate("window.dispatchEvent(new Event('blur'))")
        elif self.rng.random() < 0.03:
            self._reload()

    def _inside(self, selector: str, margin: float) -> tuple[float, float] | None:
        area = self.screen.page.locator(selector).first.bounding_box()
        if area is None:
            return None
        x, y = (area[a] + area[b] * self.rng.uniform(margin, 1 - margin) for a, b in (("x", "width"), ("y", "height")))
        return x, y

    def _drag(self) -> None:
        at = self._inside(f"#close-{self._any('top', 'side', 'front')}", 0.25)
        if at is None:
            return
        mouse, (x, y) = self.screen.page.mouse, at
        mouse.move(x, y)
        mouse.down(button="right" if self.rng.random() < 0.05 else "left")
        mouse.move(x + self.rng.uniform(-30, 30), y + self.rng.uniform(-30, 30), steps=2)
        self._interruption()
        mouse.move(x + self.rng.uniform(-30, 30), y + self.rng.uniform(-30, 30), steps=2)
        mouse.up()
        mouse.up(button="right")

    def _draw(self) -> None:
        at = self._inside("#main", 0.3)
        if at is None:
            return
        mouse, (x, y) = self.screen.page.mouse, at
        mouse.move(x, y)
        if self.rng.random() < 0.3:
            self.screen.press("c")
            return
        self.screen.press("n")
        keyboard = self.screen.page.keyboard
        rectangle = self.rng.random() < 0.3
        if rectangle:
            keyboard.down("Control")
        mouse.down()
        mouse.move(x + 40, y + 8 + 40 * rectangle, steps=2)
        self._interruption()
        mouse.up()
        keyboard.up("Control")
        if self.rng.random() < 0.7:
            self.screen.press("Escape")

    def _wall(self) -> None:
        self._chosen()
        self.screen.press("v")
        at = self._inside(f"#over.wall canvas >> nth={self.rng.integers(6)}", 0.35) if self._walled else None
        if at is not None:
            mouse, (x, y) = self.screen.page.mouse, at
            mouse.move(x, y)
            mouse.down()
            mouse.move(x + self.rng.uniform(-20, 20), y + self.rng.uniform(-20, 20), steps=2)
            self._interruption()
            mouse.up()
        if self.rng.random() < 0.3:
            self.screen.press(self._any("Enter", "Control+z", "p", "i"))
        if self._walled:
            self.screen.press("Escape")

    @property
    def _walled(self) -> bool:
        return self.screen.page.locator("#over.wall canvas").count() > 5

    def _touch(self) -> None:
        """One finger drags, at times a second comes down and goes up meanwhile, or the system takes the touch away."""
        at = self._inside(f"#close-{self._any('top', 'side', 'front')}", 0.3)
        if at is None:
            return
        session = self.screen.page.context.new_cdp_session(self.screen.page)
        x, y = at
        first = {"x": x, "y": y, "id": 1}
        moved = {"x": x + self.rng.uniform(-25, 25), "y": y + self.rng.uniform(-25, 25), "id": 1}
        second = {"x": x + self.rng.uniform(-60, 60), "y": y + self.rng.uniform(-60, 60), "id": 2}
        steps: list[tuple[str, list[dict[str, float]]]] = [("touchStart", [first]), ("touchMove", [moved])]
        if self.rng.random() < 0.5:
            steps += [
                ("touchStart", [moved, second]),
                ("touchMove", [moved, {**second, "x": x}]),
                ("touchMove", [moved]),
            ]
        steps.append(("touchCancel" if self.rng.random() < 0.3 else "touchEnd", []))
        for kind, points in steps:
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        session.detach()

    def _type(self) -> None:
        name = self._any(*NUMBERS, "track")
        wrong = self.rng.random() < 0.3
        value = self._any("600", "-1", "5000", "1e9", "") if wrong else f"{self.rng.uniform(1, 5):.2f}"
        value = str(self.rng.integers(1, 30)) if name == "track" and not wrong else value
        inputs = self.screen.page.locator(f"#inspector input[name={name}]")
        if inputs.count() == 0:
            return
        try:
            inputs.fill(value, timeout=300)
        except Exception:
            return
        if self.rng.random() < 0.2:
            self.screen.page.evaluate(
                "document.querySelector('#timeline button').dispatchEvent(new MouseEvent('click'))"
            )
        self.screen.press(self._any("Enter", "Enter", "Escape"))
        self.screen.page.evaluate("document.activeElement?.blur()")

    def _class(self) -> None:
        choice = self.screen.page.locator("#inspector select[name=class]")
        with contextlib.suppress(Exception):
            if choice.count():
                choice.select_option(index=int(self.rng.integers(3)), timeout=300)
        self.screen.page.evaluate("document.activeElement?.blur()")

    def _click(self) -> None:
        rows = self.screen.page.locator("#objects tr.one")
        count = rows.count()
        if count:
            with contextlib.suppress(Exception):
                rows.nth(int(self.rng.integers(count))).click(timeout=300)

    def _same(self) -> None:
        """Choose what the other window has chosen, and change it: two on one box."""
        name = self.other.screen.tell("state.selection") if self.other else None
        row = self.screen.page.locator(f'#objects tr[data-box="{name}"]')
        with contextlib.suppress(Exception):
            if row.count():
                row.click(timeout=300)
                self.screen.press(self._any(*MOVES, "Delete"))
                if self.other:
                    self.other.screen.press(self._any(*MOVES, *SIZES, "Delete"))

    def _answer(self) -> None:
        button = self._any("Keep mine", "Keep theirs", "Undo it all the same", "×")
        buttons = "[...document.querySelectorAll('#bars button')]"
        self.screen.page.evaluate(f"{buttons}.find((one) => one.textContent === {json.dumps(button)})?.click()")

    def _reload(self) -> None:
        self.collect()
        self.screen.page.reload()
        self.screen.until("state.welcome !== null", seconds=30)
        self.names.append(str(self.screen.tell("state.welcome.window")))
        self.rough()

    def collect(self) -> None:
        """Take what the witness and the link noted."""
        noted = self.screen.page.evaluate(
            "(() => { const out = {seen: witness.splice(0), sent: roughLink.sent.splice(0), lost: roughLink.lost, "
            "repeated: roughLink.repeated, conflicts: roughLink.conflicts}; "
            "Object.assign(roughLink, {lost: 0, repeated: 0, conflicts: 0}); return out; })()"
        )
        self.entries += noted["seen"]
        self.sent += noted["sent"]
        for name in self.link_counts:
            self.link_counts[name] += noted[name]

    def settle(self, seconds: float = 30.0) -> None:
        """With a link as it should be, all comes to rest: nothing is stuck."""
        self.smooth()
        self.screen.page.mouse.up()
        self.screen.press("Escape")
        ended = (
            "farfieldTest.state.connected && farfieldTest.state.pending === 0 && "
            "farfieldTest.state.shown !== null && farfieldTest.state.shown.frame.index === farfieldTest.state.frame && "
            "roughLink.fits.size === 0"
        )
        until, rests = time.monotonic() + seconds, 0
        while rests < 3 and time.monotonic() < until:  # a message that was lost is noticed with the next one
            rests = rests + 1 if self.screen.page.evaluate(ended) else 0
            self.screen.page.wait_for_timeout(50)
        if rests < 3:
            state = self.screen.page.evaluate(
                "JSON.stringify({frame: farfieldTest.state.frame, shown: farfieldTest.state.shown?.frame.index, "
                "pending: farfieldTest.state.pending, connected: farfieldTest.state.connected, "
                "stopped: farfieldTest.state.stopped, fits: roughLink.fits.size, kept: Object.entries(localStorage), "
                "closes: roughLink.closes.slice(-5), opened: roughLink.opened, now: performance.now()})"
            )
            raise AssertionError(f"stuck: {state[:1500]}; {self.screen.text('#bars')!r}")
        self.collect()
        name = str(self.screen.tell("state.welcome.window"))
        if name not in self.names:
            self.names.append(name)


@dataclass(eq=False)
class Studio:
    """The studio of a run: it is killed and started again on its port, and its disk can be full.

    Args:
        arguments: Of the command.
        stack: Ends it.
        windows: Get the cookie of each new link, as a person's browser does that opens it.
    """

    arguments: Sequence[str]
    stack: contextlib.ExitStack
    windows: list[Hands] = field(default_factory=list)
    kills: int = 0
    full: int = 0

    def __post_init__(self) -> None:
        self.live: Started = self.stack.enter_context(started("annotate", *self.arguments, "--port", "0"))

    def fill_disk(self, path: Path) -> None:
        """No file may grow from now on."""
        size = path.stat().st_size if path.is_file() else 0
        _, hard = resource.prlimit(self.live.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(self.live.pid, resource.RLIMIT_FSIZE, (size + 10, hard))
        self.full += 1

    def kill(self) -> None:
        """End it as if the power failed, and start it anew: its link lets the windows in."""
        os.kill(self.live.pid, signal.SIGKILL)
        self.kills += 1
        port = self.live.origin.rpartition(":")[2]
        time.sleep(0.05)
        self.live = self.stack.enter_context(started("annotate", *self.arguments, "--port", port))
        name, _, value = self.live.cookie.partition("=")
        for one in self.windows:
            one.screen.page.context.add_cookies([{"name": name, "value": value, "url": self.live.origin}])


@dataclass(eq=False)
class GestureRun:
    """What random gestures came to.

    Args:
        gestures: Done in all windows.
        edits: Stored edits of boxes that were compared with what was shown.
        records: Stored edits of any kind.
        keys: Keys whose shown effect was compared with the docs' table.
        conflicts: Times that a window was told that the other had changed the box.
        lost: Messages that the link lost.
        repeated: Messages that it brought twice.
        kills: Times that the server was killed and started anew.
        full: Times that its disk was full.
        reloads: Of windows.
        faults: What was wrong.
    """

    gestures: int = 0
    edits: int = 0
    records: int = 0
    keys: int = 0
    conflicts: int = 0
    lost: int = 0
    repeated: int = 0
    kills: int = 0
    full: int = 0
    reloads: int = 0
    faults: list[str] = field(default_factory=list)

    def as_line(self, seed: int) -> str:
        """A line of JSON, by which a run that is interrupted goes on."""
        return json.dumps({"seed": seed, **asdict(self)})


FRAMES, DAMAGED = 6, 4
GIVEN_UP_MS = 1600  # a drag elsewhere of which nothing more is heard, as docs/studio.md says, and a redraw
ROBOT = "bench"


def propose(live: Started, rng: np.random.Generator, number: int) -> None:
    """Add a proposal as a detector does, by a window of its own."""
    frame = int(rng.choice([one for one in range(FRAMES) if one != DAMAGED]))
    box = [float(rng.uniform(5, 40)), float(rng.uniform(-6, 6)), -0.9, 4.5, 1.9, 1.6, 0.0]
    value = {"box": box, "class_name": "vehicle", "state": "proposed", "source": "detector"}
    message = {"op": "box.add", "id": f"robot-{number}-{time.time_ns()}", "frame": frame, "value": value}
    with window(live) as client:
        client.ask({**message, "box": f"{frame}:robot-{number}"}, lambda reply: reply["op"] == "ack")


def run_gestures(
    chromium: Any,
    folder: Path,
    *,
    gestures: int,
    seed: int,
    episode: int = 25,
    deaths: float = 0.15,
    rest_ms: float = 150.0,
    say: Callable[[str], None] = print,
) -> GestureRun:
    """Do random gestures in two windows of one studio, and judge them after every episode.

    Args:
        chromium: The browser.
        folder: Where data and edits are made.
        gestures: How many.
        seed: Of what is done.
        episode: So many under one link; then it is smooth, all comes to rest, and is compared.
        deaths: Share of the episodes in which the server is killed, in half of them after its disk was full.
        rest_ms: The longest pause after a gesture.
        say: Gets a line now and then.
    """
    data = write_folder(folder / "drive", FRAMES, 6_000, seed=seed)
    (data / f"{DAMAGED:06d}.bin").write_bytes(b"damaged")
    run, rng = GestureRun(), np.random.default_rng(seed)
    options = ("--extent", "full", "--edits", str(folder / "edits"))
    with contextlib.ExitStack() as stack:
        studio = Studio((str(data), *options), stack)
        screens = [stack.enter_context(screen(chromium, studio.live, script=WITNESS)) for _ in range(2)]
        keys = open_dataset(data).keys
        hands = [
            Hands(one, np.random.default_rng([seed, number]), rest_ms=rest_ms) for number, one in enumerate(screens)
        ]
        hands[0].other, hands[1].other = hands[1], hands[0]
        for each in hands:
            each.names.append(str(each.screen.tell("state.welcome.window")))
        studio.windows, judged, said = hands, 0, 0
        while run.gestures < gestures and len(run.faults) < 20:
            count = min(episode, gestures - run.gestures)
            death = int(rng.integers(count)) if rng.random() < deaths else -1
            full = max(0, death - 5) if rng.random() < 0.5 else -1
            if rng.random() < 0.5:
                propose(studio.live, rng, run.gestures)
            for each in hands:
                each.rough()
            for number in range(count):
                if death >= 0 and number == full:
                    studio.fill_disk(folder / "edits" / "edits.jsonl")
                if number == death:
                    studio.kill()
                hands[int(rng.random() < 0.3)].gesture()
                run.gestures += 1
            judged = _judged(run, hands, studio, folder, keys, judged)
            for fault in run.faults[said:]:
                say(f"  {fault}")
            said = len(run.faults)
            if run.gestures % 500 < episode:
                say(f"{run.gestures} gestures, {run.edits} edits, {run.keys} keys, {len(run.faults)} faults")
        run.kills, run.full = studio.kills, studio.full
        for each in hands:
            run.reloads += len(each.names) - 1
            run.lost += each.link_counts["lost"]
            run.repeated += each.link_counts["repeated"]
            run.conflicts += each.link_counts["conflicts"]
    return run


def _judged(
    run: GestureRun,
    hands: Sequence[Hands],
    studio: Studio,
    folder: Path,
    keys: Sequence[tuple[str, str]],
    judged: int,
) -> int:
    """Let all come to rest, and compare what was stored, shown and sent; how many records there are by now."""
    for each in hands:
        each.smooth()
    with window(studio.live):  # of which all windows are told: whoever lost a message asks for all anew
        hands[0].screen.page.wait_for_timeout(100)
    for each in hands:
        try:
            each.settle()
        except AssertionError as error:
            run.faults.append(str(error))
            each.collect()
    records = journal(folder / "edits")
    names: Mapping[str, Hands] = {name: each for each in hands for name in each.names}
    verdict = judge(records[judged:], names, keys, (ROBOT,))
    run.edits += verdict.edits
    run.records += len(records) - judged
    run.faults += verdict.faults
    for each in hands:
        right, wrong = moved_from_docs(each.entries)
        run.keys += right
        run.faults += wrong
        run.faults += [text for text in each.screen.errors if own_fault(text)]
        each.screen.errors.clear()
        with window(studio.live) as client:
            frame = int(each.screen.tell("state.frame"))
            differences = [] if frame == DAMAGED else compare(each.screen.boxes, client.open(frame))
            if differences:  # what another window dragged when it was closed is shown for a while yet
                each.screen.page.wait_for_timeout(GIVEN_UP_MS)
                differences = compare(each.screen.boxes, client.open(frame))
            run.faults += differences
        each.entries.clear()
        each.sent.clear()
    return len(records)
