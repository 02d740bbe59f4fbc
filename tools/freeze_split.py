"""Record a frozen split: simulate each of its frames and write their digests beside the simulator.

    python tools/freeze_split.py cirrus-sim-val-v3 [--output src/farfield/simulation/cirrus-sim-val-v3.json]

Without --output nothing is written: the digest of the whole split is printed, and whether it is the recorded one. A
split is frozen from the moment that its record lies beside the simulator; run this once its world is done.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from farfield.files.atomic import write_text
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.frozen import FROZEN, FrozenFrame, frame_record, frozen_records, records_json, split_digest
from farfield.simulation.presets import PRESETS


def records_of(name: str, sequence: int) -> list[tuple[tuple[int, int], FrozenFrame]]:
    """Records of one sequence's frames."""
    frames = range(find_preset(name).segment(sequence).frames)
    return [((sequence, i), frame_record(simulate_frame(name, sequence=sequence, index=i))) for i in frames]


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate the split and compare or write its digests."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=[name for name, preset in PRESETS.items() if preset.rig == "cirrus"])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args(arguments)
    count = len(find_preset(options.name).segments)
    with ProcessPoolExecutor() as pool:
        parts = list(pool.map(records_of, [options.name] * count, range(count)))
    records = dict(record for part in parts for record in part)
    print(f"{options.name}: {len(records)} frames, sha256 {split_digest(records)}")
    if options.output:
        write_text(options.output, records_json(options.name, records))
        return 0
    if options.name not in FROZEN:
        print("no record of it; --output writes one")
        return 1
    same = split_digest(records) == split_digest(frozen_records(options.name))
    print("the recorded one" if same else "NOT the recorded one")
    return int(not same)


if __name__ == "__main__":
    raise SystemExit(main())
