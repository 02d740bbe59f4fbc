"""A process that edits like the studio's server: edits come as lines, acknowledgements go out after fsync.

    python edit_server.py FOLDER

A line in is ``{"id", "row", "base", "x"}``: move box 0 of that frame of drive a; base -1: whatever it is. A line out is
``ID SEQ`` when the edit is on the disk.
"""

import json
import sys
import threading
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from edited_drives import ANN, opened

from farfield.annotation.edits import set_box
from farfield.datasets.edits import Record

_OUT = threading.Lock()


def _acknowledge(done: "Future[Record]") -> None:
    record = done.result()
    with _OUT:
        sys.stdout.write(f"{record.id} {record.seq}\n")
        sys.stdout.flush()


def main() -> None:
    """Edit until the lines end."""
    with opened(Path(sys.argv[1])) as store:
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        for line in sys.stdin:
            edit = json.loads(line)
            key = ("a", f"{edit['row']:04d}")
            row = store.row(key, "0")
            value = {"box": [edit["x"], *row.label.box[1:]]}
            plan = partial(set_box, key=key, name="0", base=row.version, value=value)
            store.edit(ANN, edit["id"], "box.set", plan).saved.add_done_callback(_acknowledge)


if __name__ == "__main__":
    main()
