"""Write the key map of docs/studio.md from the table that drives the page:  python docs/make_studio.py."""

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "studio.md"
START, END = "<!-- keys -->", "<!-- end of keys -->"
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
    "Escape": "Esc",
}


def key_name(key: dict) -> str:
    """How a key is called on a keyboard of the United States."""
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
            modes = "both" if len(key["modes"]) == 2 else {"view": "viewing", "annotate": "annotating"}[key["modes"][0]]
            title = re.sub(" 1$", "", key["title"]) if digits else key["title"]
            lines.append(f"| {name} | {modes} | {title} |")
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    """Put the tables between their marks."""
    text = PAGE.read_text()
    before, rest = text.split(START)
    PAGE.write_text(f"{before}{START}\n{key_map()}{END}{rest.split(END)[1]}")
    print(f"wrote the keys into {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
