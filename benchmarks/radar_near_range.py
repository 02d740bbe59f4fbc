"""How echoes fall with range: simulated range-azimuth maps beside the one published real map, by high-pass filter.

    python benchmarks/radar_near_range.py [--sequences 58] [--high-pass 0 30 60 100 200]

Prints, by band of range, the share of cells 2 dB above the floor, in the median over drives, and in how many of the
drives it is less than in the real map (plot_tes_ra.png, digitised; tests/datasets/test_statistics.py). A receiver that
fits has that rank near a half in every band; one frame tells no more.
"""

import argparse
from dataclasses import replace

import numpy as np
from _report import header
from rich.progress import track

from farfield.inspection.statistics.radar import map_statistics
from farfield.simulation.presets import find_preset
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.rigs.drive import drive_of
from farfield.simulation.rigs.kradar import KRadarFrame
from farfield.vocabulary.published_tables import RAISED_SHARES


def shares(high_pass_m: float, sequences: int, seed: int) -> np.ndarray:
    """Share of raised cells of the first frame of each drive by band, shape (sequences, bands)."""
    preset, model, rows = find_preset("kradar-sim"), replace(RadarModel(), high_pass_m=high_pass_m), []
    for sequence in track(range(sequences), f"{high_pass_m:g} m", transient=True):
        measured = KRadarFrame(drive_of(preset, seed, sequence), 0).measured(("mean",), model)
        power_db = 10 * np.log10(measured.moments.mean_power.mean(axis=1, dtype=np.float64))
        rows.append(list(map_statistics(power_db)["raised_share"].values()))
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=58)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--high-pass", type=float, nargs="+", default=[0.0, 30.0, 60.0, 100.0, 200.0])
    options = parser.parse_args()
    print(header(), "\n", sep="")
    real = np.array([float(share) for share in RAISED_SHARES.values()])
    bands = "".join(f"{band:>8}" for band in RAISED_SHARES)
    print(f"{'cells 2 dB above the floor, per cent, by metres':<48}{bands}")
    print(f"{'real, one map':<48}" + "".join(f"{100 * share:8.1f}" for share in real))
    for high_pass_m in options.high_pass:
        found = shares(high_pass_m, options.sequences, options.seed)
        name = f"high-pass filter at {high_pass_m:g} m" if high_pass_m else "no high-pass filter"
        ranks = (found < real).mean(axis=0) + 0.5 * (found == real).mean(axis=0)
        print(f"{name + ', median':<48}" + "".join(f"{100 * share:8.1f}" for share in np.median(found, axis=0)))
        away = f"  rank of the real map (mean distance from a half {np.abs(ranks - 0.5).mean():.2f})"
        print(f"{away:<48}" + "".join(f"{rank:8.2f}" for rank in ranks), flush=True)


if __name__ == "__main__":
    main()
