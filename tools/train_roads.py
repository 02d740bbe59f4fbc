"""Train the detectors for real roads: every network, seed by seed; what is done already is left as it is.

    python tools/train_roads.py                                  # the default, three seeds, then one of each other
    python tools/train_roads.py --detectors pointpillars --seeds 1
    python tools/train_roads.py -o training.steps=40             # any setting of tools/roads.yaml

A GPU is taken where there is one. After Ctrl-C, a signal or a lost machine the same command goes on.
"""

import argparse
from pathlib import Path

from farfield.experiments.catalogue import find
from farfield.experiments.schema import Experiment, experiment_of, load_experiment
from farfield.experiments.staged import StagedTraining, train_in_stages
from farfield.training.report import TrainingReport

EXPERIMENT = Path(__file__).with_name("roads.yaml")
DEFAULT, OTHERS = "pointpillars", ("sparsecentre", "second", "pointrcnn", "voxelnet")
SEEDS = 3  # of the default; one of each other


class Lines(TrainingReport):
    """Prints what a training says, and a line in a hundred steps."""

    def say(self, text: str) -> None:
        """Print a line."""
        print(text, flush=True)

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Print the losses now and then."""
        if step % 100 == 0:
            print(f"step {step}: loss {losses['loss']:.3f}", flush=True)


def of_network(detector: str, seed: int, overrides: list[str]) -> Experiment:
    """The experiment of a network: of another than the default with the detector of its shipped experiment."""
    experiment = load_experiment(EXPERIMENT, [f"name={detector}-roads", f"training.seed={seed}"])
    if detector != DEFAULT:
        shipped = load_experiment(find(f"{detector}-cirrus-sim")).detector
        settings = {**shipped.model_dump(mode="json"), "full_points": experiment.detector.full_points}
        experiment = Experiment.model_validate({**experiment.model_dump(mode="json"), "detector": settings})
    return experiment_of(experiment.model_dump(mode="json"), overrides, where=str(EXPERIMENT))


def main() -> None:
    """Train what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/roads"), help="folder of the runs")
    parser.add_argument("--detectors", default=",".join((DEFAULT, *OTHERS)), help="names, separated by commas")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="of the default; one of each other")
    parser.add_argument("--mined-frames", type=int, default=StagedTraining.mined_frames)
    parser.add_argument("--held-frames", type=int, default=StagedTraining.held_frames)
    parser.add_argument("-o", dest="overrides", action="append", default=[], help="a setting: key.key=value")
    options = parser.parse_args()
    stages = StagedTraining(mined_frames=options.mined_frames, held_frames=options.held_frames)
    for detector in options.detectors.split(","):
        for seed in range(options.seeds if detector == DEFAULT else 1):
            folder = options.out / f"{detector}-{seed}"
            print(f"== {folder}", flush=True)
            weights = train_in_stages(of_network(detector, seed, options.overrides), folder, stages, Lines())
            print(f"== {weights}", flush=True)


if __name__ == "__main__":
    main()
