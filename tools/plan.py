"""The plan of the house for CONTRIBUTING.md: the import contracts of pyproject.toml, and each room in its own words.

python tools/plan.py           # print it
python tools/plan.py --write   # put it into CONTRIBUTING.md
"""

import ast
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- plan: tools/plan.py -->", "<!-- end of the plan -->"


def first_line(room: str) -> str:
    """First sentence of a room's docstring, without its full stop."""
    path = ROOT / "src" / "farfield" / room
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.split("\n")[0].split(". ")[0].rstrip(".").replace("``", "`").replace(":class:", "")


def plan() -> str:
    """A table of the floors, the top one first; rooms of one floor do not import one another."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    floors = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    rows = ["| floor | room | what stands there |", "|---|---|---|"]
    for number, floor in enumerate(reversed([*floors, "errors"])):
        rooms = [room.strip() for room in floor.split("|")]
        rows[2:2] = [f"| {number} | `{room}` | {first_line(room)} |" for room in rooms]
    return "\n".join(rows)


def with_plan(page: str) -> str:
    """A page whose part between the two marks is the plan."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{plan()}\n{END}{tail}"


def main() -> None:
    """Print the plan, or write it into CONTRIBUTING.md."""
    page = ROOT / "CONTRIBUTING.md"
    if "--write" in sys.argv[1:]:
        page.write_text(with_plan(page.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(plan())


if __name__ == "__main__":
    main()
