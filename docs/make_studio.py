"""Write the key map and the table of figures of docs/studio.md:  python docs/make_studio.py.

Keys come from the table that drives the page, figures from the records that the benchmarks left.
"""

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "studio.md"
START, END = "<!-- keys -->", "<!-- end of keys -->"
FIGURES, END_FIGURES = "<!-- figures -->", "<!-- end of figures -->"
RECORDS = (
    ("studio_page", "page"),
    ("studio_page", "changes"),
    ("studio_server", "server"),
    ("studio_server", "link"),
    ("studio_server", "journal"),
    ("studio_checks", "checks"),
    ("studio_checks", "tracks"),
)
"""Results files and their sections."""
ANCHORS = {
    "frame change 131k, not prefetched": "K-Radar's devkit parses 370 to 420 ms alone",
    "orbit, 131k": "viser: 4.8 at 100k",
    "drag a box, 131k": 'CVAT: "very lagging"',
    "edit acknowledged after fsync, 200": "Figma: p95 600 ms",
    "requests to foreign hosts": "rerun: 4",
}
"""What others do, as their users, authors or documentation say."""
TESTED = (
    (
        "1,000 interleavings of two windows",
        "no update lost, every conflict shown",
        ("tests/annotation/test_interleaving.py", "test_interleavings_of_two_windows"),
    ),
    (
        "34,994 label files of K-Radar opened and saved",
        "byte for byte; one box moved: one line",
        ("tests/datasets/kradar/test_kradar_label_format.py", "test_all_published_files"),
    ),
    (
        "requests that must be refused",
        "each refused",
        ("tests/studio/serving/test_studio_refusals.py", "test_a_foreign_websocket_is_refused_before_it_opens"),
    ),
)
"""What a test holds, without a figure: what, what holds, the test's file and name."""
NAMES = {
    "ArrowLeft": "←",
    "ArrowRight": "→",
    "BracketLeft": "[",
    "BracketRight": "]",
    "Semicolon": ";",
    "Quote": "'",
    "Comma": ",",
    "Period": ".",
    "Backslash": "\\",
    "Backquote": "`",
    "Slash": "/",
    "ArrowUp": "↑",
    "ArrowDown": "↓",
    "Escape": "Esc",
}

WHILE = {
    ("view",): "viewing",
    ("annotate",): "annotating",
    ("calibrate",): "calibrating",
    ("view", "annotate"): "both",
    ("annotate", "calibrate"): "annotating, calibrating",
    ("view", "annotate", "calibrate"): "all",
}
"""Modes in words."""


def key_name(key: dict) -> str:
    """How a key is called on a keyboard of the United States."""
    if "name" in key:  # the character that it writes
        return key["name"]
    plain = NAMES.get(key["code"], re.sub("^(Key|Digit)", "", key["code"]))
    return "+".join([name for name in ("Ctrl", "Shift", "Alt") if key.get(name.lower())] + [plain])


def key_map() -> str:
    """The tables: one line a key, with what it does while viewing and while annotating."""
    keys = json.loads((ROOT / "web" / "src" / "keys.json").read_text())
    lines = []
    for group in dict.fromkeys(key["group"] for key in keys):
        lines += [f"**{group}**", "", "| key | while | does |", "|---|---|---|"]
        for key in keys:
            if key["group"] != group or re.fullmatch(r"class\.[2-9]", key["id"]):
                continue
            digits = key["id"] == "class.1"
            name = "1 to 9" if digits else key_name(key)
            name = f"`` {name} ``" if "`" in name else f"`{name}`"
            modes = WHILE[tuple(key["modes"])]
            title = re.sub(" 1$", "", key["title"]) if digits else key["title"]
            lines.append(f"| {name} | {modes} | {title} |")
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def figures() -> str:
    """The figures of all records that there are, and of when and under which load each was taken."""
    lines, notes = ["| what | measured | target | an anchor |", "|---|---|---|---|"], []
    for name, section in RECORDS:
        text = (ROOT / "benchmarks" / "results" / f"{name}.txt").read_text()
        text = re.split(r"^==== ", text.partition(f"==== {section}\n")[2], maxsplit=1, flags=re.MULTILINE)[0]
        if not text:
            continue
        facts = dict(re.findall(r"^(date|commit|load) +(.+)$", text, flags=re.MULTILINE))
        notes.append(f"[{name}, {section}](../benchmarks/results/{name}.txt): {facts['date']}, load {facts['load']}")
        for line in text.splitlines():
            cells = [cell.strip() for cell in line.split(" | ")]
            if len(cells) == 4 and cells[3] in ("held", "MISSED"):
                what, measured, target, held = cells
                missed = "" if held == "held" else "; **missed**"
                lines.append(f"| {what} | {measured}{missed} | {target} | {ANCHORS.get(what, '')} |")
    for what, holds, (file, test) in TESTED:
        assert f"def {test}(" in (ROOT / file).read_text(), f"{file} has no {test}"
        lines.append(f"| {what} | {holds}: `{file}` | the same | |")
    lines.append(
        "| objects drawn by a hand, of real and simulated frames, of the radar alone | [above](#what-a-hand-gets) | | |"
    )
    return "\n".join([*lines, "", "Recorded: " + "; ".join(notes) + "."]) + "\n"


def put(text: str, marks: tuple[str, str], table: str) -> str:
    """A table between its marks."""
    before, rest = text.split(marks[0])
    return f"{before}{marks[0]}\n{table}{marks[1]}{rest.split(marks[1])[1]}"


def main() -> None:
    """Put the tables between their marks."""
    text = put(PAGE.read_text(), (START, END), key_map())
    PAGE.write_text(put(text, (FIGURES, END_FIGURES), figures()))
    print(f"wrote the keys and figures into {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
