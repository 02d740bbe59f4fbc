"""Synchronisation: matching of streams and clocks against the truth, its speed, and a raw recording."""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _report import SHARED_REAL, Part, child_output, part_parser, progress, run_parts
from jaxtyping import Float, Int64

from farfield.pages.sync_page import write_synchronised
from farfield.simulation.presets import find_preset
from farfield.simulation.recording.raw import record_streams
from farfield.sync import StreamMatcher, drift_bound_ppm, fit_clock, match_blocks, match_times
from farfield.sync.matching import assign, cost_ns, nearest, windows
from farfield.sync.sources import recordings

MS = 1_000_000
START = 1_700_000_000_000_000_000
RATES = {"lidar": 10.0, "lidar_2": 10.0, "camera": 30.0, "radar": 10.0, "gps": 1.0}
TRUTH = {"lidar": (0.0, 0.0), "lidar_2": (7.0, 12.0), "camera": (4.0, -25.0), "radar": (-9.0, 40.0), "gps": (2.0, 3.0)}
"""Offset in ms and drift in ppm of each clock against the LiDAR's."""
Stamps = Int64[np.ndarray, " _"]


def stream(rng: np.random.Generator, name: str, span_s: float, jitter_ms: float, lost: float = 0.05) -> Stamps:
    """Stamps of one stream by the LiDAR's clock."""
    offset_ms, drift = TRUTH[name]
    ticks = np.arange(int(span_s * RATES[name])) / RATES[name] * 1e9
    times = ticks * (1 + drift * 1e-6) + offset_ms * MS + rng.normal(0, jitter_ms * MS, len(ticks))
    kept = times[rng.random(len(times)) >= lost]
    return np.unique(START + np.rint(kept).astype(np.int64))


def optimum(a: Stamps, b: Stamps, tolerance: int) -> int:
    """Least cost of any one-to-one matching, by scipy's linear assignment; each reference may stay alone."""
    from scipy.optimize import linear_sum_assignment

    far = 10**15
    distance = np.abs(a[:, None] - b[None, :])
    alone = np.where(np.eye(len(a), dtype=bool), tolerance, far)
    costs = np.hstack([np.where(distance <= tolerance, distance, far), alone])
    return int(costs[linear_sum_assignment(costs)].sum())


def exactness(draws: int) -> list[str]:
    """Batch cost against scipy's, and plain nearest matching's, for the rates and jitters of sensors."""
    lines = [f"batch against the exact optimum (scipy), 20 s, 5 % lost, {draws} seeds", ""]
    lines.append("reference  other    jitter ms  tolerance ms  pairs   cost = optimum   each nearest, used once")
    cases = [("lidar", "camera", 2, 17), ("lidar", "lidar_2", 2, 50), ("lidar", "lidar_2", 20, 50)]
    cases += [("lidar", "radar", 100, 50), ("camera", "lidar", 2, 17), ("camera", "lidar", 20, 50)]
    cases += [("lidar", "gps", 2, 50), ("radar", "camera", 30, 40)]
    for own, other, jitter, tolerance in progress(cases, "optimum"):
        equal, pairs, over = 0, 0, []
        for seed in range(draws):
            rng = np.random.default_rng(seed)
            a, b = stream(rng, own, 20, jitter), stream(rng, other, 20, jitter)
            partner = assign(a, b, tolerance * MS)
            cost, least = cost_ns(a, b, partner, tolerance * MS), optimum(a, b, tolerance * MS)
            equal += cost == least
            pairs += int((partner >= 0).sum())
            over.append(cost_ns(a, b, once(a, b, tolerance * MS), tolerance * MS) / least - 1)
        words = f"{own:<11}{other:<9}{jitter:>9}{tolerance:>14}{pairs:>7}   {equal} of {draws}"
        lines.append(f"{words}          +{100 * np.mean(over):.2f} %")
    return lines


def once(a: Stamps, b: Stamps, tolerance: int) -> Stamps:
    """Nearest matching in which the nearest of several claimants gets the message and the others none."""
    partner = nearest(a, b, windows(a, b, tolerance))
    distance = np.where(partner >= 0, np.abs(a - b[partner]), 1 << 62)
    order = np.lexsort((distance, partner))
    first = np.append(True, np.diff(partner[order]) != 0)
    partner[order[~first]] = -1
    return partner


def streaming() -> list[str]:
    """Streaming against batch: late messages within the allowed lateness, beyond it, and endless clusters."""
    lines = ["", "streaming against batch, 300 s, 5 % lost, messages late at random", ""]
    heads = "streams   late up to  lateness  tolerance  jitter  rows equal        cost over batch"
    lines.append(heads + "  late  cuts  most held  us a message")
    settings = [("all", 80, 100, 17, 2), ("all", 90, 100, 45, 2), ("no GPS", 90, 100, 45, 2)]
    settings += [("no GPS", 200, 100, 17, 2), ("no GPS", 400, 100, 17, 2), ("no GPS", 40, 100, 90, 20)]
    for which, late, lateness, tolerance, jitter in progress(settings, "streaming"):
        rng = np.random.default_rng(late)
        times = {name: stream(rng, name, 300, jitter) for name in RATES if which == "all" or name != "gps"}
        whole = match_times(times, reference="lidar", tolerance_ns=tolerance * MS)
        messages = sorted((int(s) + int(rng.integers(0, late * MS)), n, int(s)) for n, v in times.items() for s in v)
        options = {"tolerance_ns": tolerance * MS, "lateness_ns": lateness * MS}
        matcher = StreamMatcher(tuple(times), reference="lidar", **options)
        groups, held, began = [], 0, time.process_time()
        for _, name, stamp in messages:
            groups += matcher.push(name, stamp)
            held = max(held, matcher.held)
        groups += matcher.close()
        each_us = (time.process_time() - began) / len(messages) * 1e6
        rows = {g.stamp_ns: tuple(None if p is None else p[0] for p in g.partners.values()) for g in groups}
        equal, cost = 0, 0
        for row, stamp in enumerate(whole.reference_ns.tolist()):
            best = tuple(
                None if whole.index[row, k] < 0 else int(times[name][whole.index[row, k]])
                for k, name in enumerate(whole.names)
            )
            mine = rows.get(stamp, (None,) * len(best))
            equal += mine == best
            cost += sum(tolerance * MS if partner is None else abs(partner - stamp) for partner in mine)
        lost = sum(count for (what, _), count in matcher.counts.items() if what == "late")
        lines.append(
            f"{which:<8}{late:>9} ms{lateness:>7} ms{tolerance:>8} ms{jitter:>5} ms  {equal:>5} of {len(whole):<6}"
            f"{100 * (cost / sum(whole.cost_ns.values()) - 1):>+15.3f} %{lost:>6}{matcher.counts['cut', 'lidar']:>6}"
            f"{held:>11}{each_us:>14.0f}"
        )
    return lines


def clocks(seeds: int) -> list[str]:
    """Errors of offset and drift over seeds, beside the bound."""
    lines = ["", f"offset and drift from stamps alone, {seeds} seeds, rms", ""]
    heads = f"{'pair of clocks, span, noise':<54}  drift ppm   bound   ratio"
    lines.append(heads + "  offset ms  worst ms  within 2 se")
    cases: list[tuple[str, float, float, float]] = [
        ("60 s, 10 Hz, Gaussian 1 ms", 60, 10, 1.0),
        ("60 s, 30 Hz, Gaussian 1 ms", 60, 30, 1.0),
        ("600 s, 10 Hz, Gaussian 1 ms", 600, 10, 1.0),
        ("60 s, 100 Hz, Gaussian 0.2 ms", 60, 100, 0.2),
    ]
    for words, span, rate, jitter in progress(cases, "clocks"):
        count = int(span * rate)
        a = START + (np.arange(count) * (1e9 / rate)).astype(np.int64)
        middle = (int(a[0]) + int(a[-1])) // 2
        ideal = 3 * MS + np.rint((a - middle) * 7e-6).astype(np.int64)
        found = []
        for seed in range(seeds):
            noise = np.random.default_rng(seed).normal(0, jitter * MS, count)
            clock = fit_clock(a, a + ideal + np.rint(noise).astype(np.int64))
            found.append((clock.drift_ppm - 7, clock.offset_ns / MS - 3, clock.drift_se_ppm))
        lines.append(clock_line(words, np.array(found), drift_bound_ppm(jitter / 1e3, count, span)))
    lines += [matched_clock(name, seeds) for name in ("lidar_2", "camera", "radar")]
    return [
        *lines,
        "",
        "the last three: matched by nearness first, 5 % of both streams lost, jitter 1 ms on each of the two",
    ]


def matched_clock(name: str, seeds: int) -> str:
    """The same for a simulated stream that is first matched to the LiDAR."""
    found, pairs, span, modulo = [], 0, 60.0, round(1e9 / max(RATES[name], 10))
    offset_ms, drift = TRUTH[name]
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        times = {"lidar": stream(rng, "lidar", span, 1.0), name: stream(rng, name, span, 1.0)}
        table = match_times(times, reference="lidar")
        rows = np.flatnonzero(table.index[:, 0] >= 0)
        pairs = len(rows)
        own = table.reference_ns[rows]
        clock = fit_clock(own, own + table.residual_ns[rows, 0], modulo_ns=modulo)
        at_middle = offset_ms + (clock.middle_ns - START) * drift * 1e-6 / MS
        found.append((clock.drift_ppm - drift, clock.offset_ns / MS - at_middle, clock.drift_se_ppm))
    words = f"{name} to lidar, 60 s, {pairs} pairs, Gaussian 1 ms twice"
    return clock_line(words, np.array(found), drift_bound_ppm(np.sqrt(2) / 1e3, pairs, span))


def clock_line(words: str, found: Float[np.ndarray, "n 3"], bound: float) -> str:
    """A row of the table of clocks."""
    rms = np.sqrt((found[:, :2] ** 2).mean(axis=0))
    inside = (np.abs(found[:, 0]) < 2 * found[:, 2]).mean()
    worst = np.abs(found[:, 1]).max()
    shown = f"{words:<54}{rms[0]:>11.3f}{bound:>8.3f}{rms[0] / bound:>8.2f}"
    return f"{shown}{rms[1]:>11.3f}{worst:>10.3f}{100 * inside:>11.0f} %"


def speed(stamps: float) -> list[str]:
    """Millions of stamps in lists of text, read, matched and written, each way in a process of its own."""
    hours = stamps / (sum(RATES.values()) * 0.95) / 3600
    lines = [""]
    lines += [
        f"{stamps / 1e6:g} million stamps (camera 30 Hz, two LiDARs and a radar 10 Hz, GPS 1 Hz; {hours:.0f} hours), "
        "text files"
    ]
    lines.append("")
    lines.append("what                                                         CPU s   peak MB")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_lists(folder, stamps)
        for words, mode in (
            ("read and match, in blocks (17 ms)", "match"),
            ("the same, tolerance 50 ms", "match50"),
            ("farfield sync: read twice, match, fit, table, page", "sync"),
        ):
            shown = child_output("--mode", mode, "--folder", name).split()
            lines.append(f"{words:<58}{float(shown[0]):>9.2f}{float(shown[1]):>10.0f}   {' '.join(shown[2:])}")
    return lines


def write_lists(folder: Path, stamps: float) -> None:
    """Lists of stamps, one a stream."""
    rng = np.random.default_rng(0)
    span = stamps / (sum(RATES.values()) * 0.95)
    for name in progress(RATES, "writing"):
        values = stream(rng, name, span, 2)
        with (folder / f"{name}.txt").open("w") as handle:
            for begin in range(0, len(values), 100_000):
                handle.write("\n".join(map(str, values[begin : begin + 100_000].tolist())) + "\n")


def child(mode: str, folder: Path) -> None:
    """One way through the lists; prints CPU seconds and the peak of memory."""
    from farfield.sync.sources import recordings

    (recording,) = recordings(folder)
    if mode.startswith("match"):
        blocks = {name: source.blocks() for name, source in recording.streams.items()}
        tolerance = 50 * MS if mode == "match50" else 17 * MS
        rows = sum(len(part.index) for part in match_blocks(blocks, reference="lidar", tolerance_ns=tolerance))
        said = f"{rows} rows"
    else:
        from farfield.pages.sync_page import write_synchronised

        (found,) = write_synchronised(folder / "out", [recording], to="lidar", tolerance_ns=None, title="speed")
        total = sum(health.count for health in found.streams.values())
        said = f"{total} stamps, {sum(pair.matched for pair in found.pairs.values())} pairs"
    peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    print(time.process_time(), int(peak.split()[1]) / 1024, said)


def real() -> list[str]:
    """What real stamps give, where they are at hand."""
    from farfield.sync.sources import recordings
    from farfield.sync.synchronising import synchronise

    lines = ["", "real stamps", ""]
    places = [("time/radiate_tiny_foggy", "Navtech_Polar"), ("kitti_raw/2011_09_26", "velodyne_points")]
    for place, reference in places:
        if not (SHARED_REAL / place).is_dir():
            continue
        found = synchronise(recordings(SHARED_REAL / place)[0], to=reference)
        for name, pair in found.pairs.items():
            mean = (
                f"{pair.residual_ns.mean() / MS:+.3f} ms mean, worst {pair.worst_ns / MS:.3f} ms"
                if pair.matched
                else ""
            )
            lines.append(
                f"{found.name} {name} to {reference}: {pair.matched} of {found.streams[reference].count} {mean}"
            )
        lines += [f"  {finding}" for finding in found.findings]
    return lines


def run_streams(arguments: Sequence[str]) -> None:
    """Synchronisation on simulated streams: cost against the exact optimum, streaming against batch, clocks, speed.

    A 30 Hz camera that runs freely, two 10 Hz LiDARs, a 10 Hz radar and a GPS at 1 Hz: each with a clock of its own
    (offset, drift), jitter, 5 % of the messages lost, and messages that arrive late.

        python benchmarks/synchronisation.py streams
    """
    parser = part_parser(run_streams.__doc__)
    parser.add_argument("--seeds", type=int, default=200, help="of the clocks")
    parser.add_argument("--draws", type=int, default=5, help="of each case of the optimum")
    parser.add_argument("--stamps", type=float, default=10e6, help="whose time is measured")
    parser.add_argument("--mode", choices=("match", "match50", "sync"), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.mode:
        child(given.mode, given.folder)
        return
    for lines in (exactness(given.draws), streaming(), clocks(given.seeds), speed(given.stamps), real()):
        print("\n".join(lines), flush=True)


SENSORS = ("gaussian", "uniform", "camera", "imu_front", "imu_rear", "gps")


def against_computer(truth: dict[str, Any], name: str, middle_ns: int) -> tuple[float, float]:
    """True drift in ppm and offset in ms of the computer's clock against a sensor's, the least delay included."""
    stream, computer = truth["streams"][name], truth["computer"]
    read_s = (middle_ns - truth["epoch_ns"]) / 1e9
    true_s = (read_s - stream["offset_ms"] / 1e3) / (1 + stream["drift_ppm"] * 1e-6)
    arrived_s = true_s + stream["least_delay_ms"] / 1e3
    logged_s = arrived_s * (1 + computer["drift_ppm"] * 1e-6) + computer["offset_ms"] / 1e3
    return ((1 + computer["drift_ppm"] * 1e-6) / (1 + stream["drift_ppm"] * 1e-6) - 1) * 1e6, (logged_s - read_s) * 1e3


def arrivals(found: dict[str, Any], truth: dict[str, Any]) -> list[str]:
    """Each clock against the computer's, from stamps and times of recording."""
    lines = ["the computer's clock against each sensor's, from stamps and times of recording of the same messages", ""]
    lines.append(
        "stream     messages  drift ppm: true   found    ± se   error   offset ms: true    found   error  includes"
    )
    for name in SENSORS:
        clock = found["arrivals"].get(f"/{name}")
        if clock is None:
            continue
        drift, offset = against_computer(truth, name, clock["middle_ns"])
        se = clock["drift_se_ppm"] if clock["drift_se_ppm"] is not None else float("nan")
        error, off = clock["drift_ppm"] - drift, clock["offset_ns"] / 1e6 - offset
        lines.append(
            f"{name:<11}{clock['pairs']:>8}{drift:>17.3f}{clock['drift_ppm']:>8.3f}{se:>8.3f}"
            f"{error:>8.3f}{offset:>18.3f}{clock['offset_ns'] / 1e6:>9.3f}{off:>8.3f}  {clock['offset_includes']}"
        )
    return lines


def between(found: dict[str, Any], truth: dict[str, Any]) -> list[str]:
    """One sensor against the other from matched stamps alone."""
    streams, own = truth["streams"], truth["streams"]["gaussian"]
    lines = ["", "each stream matched to /gaussian, from stamps alone", ""]
    lines.append("stream     pairs  worst ms  drift ppm: of the clocks   found   bound   what the stamps tell")
    for name in SENSORS[1:]:
        pair = found["pairs"][f"/{name}"]
        known = streams[name]["drift_ppm"] - own["drift_ppm"]
        clock, told = pair["clock"], "runs freely: its stamps follow its own rate, whatever that is"
        told = "the drift of its clock against the LiDAR's" if not streams[name]["free_running"] else told
        words = f"{'':>8}{'':>8}" if clock is None else f"{clock['drift_ppm']:>8.3f}{clock['bound_ppm']:>8.3f}"
        told = told if clock is not None else "nothing: too few, or no whole ratio of rates"
        lines.append(
            f"{name:<11}{pair['matched']:>5}{pair['residual']['worst_ms']:>10.3f}{known:>26.3f}{words}   {told}"
        )
    clock, other = found["pairs"]["/uniform"]["clock"], streams["uniform"]
    if clock is None:
        return lines
    middle_s = (clock["middle_ns"] - truth["epoch_ns"]) / 1e9
    apart = other["offset_ms"] - own["offset_ms"] + other["phase_ms"]
    apart += (other["drift_ppm"] - own["drift_ppm"]) * middle_s * 1e-3
    error = (clock["offset_ns"] / 1e6 - apart + 50) % 100 - 50
    lines += [
        "",
        f"/uniform's stamps are truly {apart:.3f} ms later, up to periods of 100 ms; error {error:+.3f} ms",
    ]
    return lines


def run_recording(arguments: Sequence[str]) -> None:
    """A raw recording of a simulated drive, synchronised: clocks that are found against those that are known.

    A minute of the Cirrus car's raw streams (two LiDARs fired by the GPS' pulses, a camera and two IMUs that run
    freely, GPS), each with a clock of its own, written as a ROS 2 bag, read back and matched as ``farfield sync`` does.

        python benchmarks/synchronisation.py recording
    """
    parser = part_parser(run_recording.__doc__)
    parser.add_argument("--sweeps", type=int, default=600)
    options = parser.parse_args(arguments)
    preset = find_preset("cirrus-sim-mini", duration_s=options.sweeps / 10 + 1)
    with tempfile.TemporaryDirectory() as folder:
        root, started = Path(folder), time.process_time()
        recorded = record_streams(
            preset,
            root / "raw",
            sweeps=options.sweeps,
            sequences=1,
            workers=1,
            progress=partial(progress, what="files"),
        )
        spent = time.process_time() - started
        size = sum(path.stat().st_size for path in recorded.bags[0].iterdir())
        started = time.process_time()
        write_synchronised(
            root / "sync", recordings(recorded.bags[0]), to="/gaussian", tolerance_ns=None, title="a raw recording"
        )
        read = time.process_time() - started
        found = json.loads((root / "sync" / "sync.json").read_text())["recordings"][0]
        truth = json.loads(recorded.truths[0].read_text())
    print(f"{options.sweeps / 10:g} s of cirrus-sim-mini, {size / 1e6:.0f} MB: simulated and written", end="")
    print(f" in {spent:.0f} s of CPU, read, matched and drawn in {read:.1f} s\n")
    print("\n".join([*arrivals(found, truth), *between(found, truth)]))


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "streams": Part(run_streams, "--draws 1 --seeds 5 --stamps 20000"),
                "recording": Part(run_recording, "--sweeps 20"),
            },
        )
    )
