"""The labelled frames that stay in every batch: those that a detector learnt from, or frames like them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.maps import WholeBodies
from farfield.datasets.recipes import recipe_of_experiment
from farfield.errors import ConfigError
from farfield.evaluation import as_trained, suitable_clouds
from farfield.experiments.frames import annotated_frames, spread
from farfield.experiments.schema import DataConfig
from farfield.frame.provenance import SIMULATION_FILE
from farfield.simulation.recording import SimulationConfig, ensure
from farfield.training.augmentation import Progress
from farfield.training.config import AugmentationConfig

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

FOLDER = "source"
_FRAMES = 6  # of a simulated sequence: many roads rather than many frames of one
_OTHER_ROADS = 1000  # added to the seed: roads that the detector has not learnt by heart


@dataclass(frozen=True, kw_only=True)
class TrainingHistory:
    """What a detector's weights say of their training.

    Args:
        path: Where its data were.
        aliases: Classes that were renamed.
        options: Options of its data's reader.
        simulate: What was simulated; empty for a real data set.
        augmentation: Random changes that this version knows.
        training: Settings of the loop.
    """

    path: str
    aliases: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    simulate: Mapping[str, Any] = field(default_factory=dict)
    augmentation: Mapping[str, Any] = field(default_factory=dict)
    training: Mapping[str, Any] = field(default_factory=dict)

    @property
    def steps(self) -> int:
        """Steps of its training."""
        return int(self.training.get("steps", 0))


def learnt_by(provenance: Mapping[str, Any], name: str) -> TrainingHistory:
    """Read a provenance: of several streams the source's, else the first one's.

    Args:
        provenance: What the weights hold.
        name: What the detector is called, for messages.

    Raises:
        ConfigError: If it does not say what the detector learnt from.
    """
    experiment = provenance.get("experiment") or {}
    data = experiment.get("data") or {}
    if data and "path" not in data:
        data = data.get("source") or next(iter(data.values()))
    if not data:
        raise ConfigError(
            "adapt: expected weights whose provenance says what they learnt from, as those of farfield train do; "
            f"{name} says nothing. Self-training needs labelled frames of the source beside the unlabelled ones; train "
            "the detector here, or take weights that ship."
        )
    fields = set(AugmentationConfig.model_fields)
    return TrainingHistory(
        path=str(data["path"]),
        aliases=data.get("aliases") or {},
        options=data.get("options") or {},
        simulate=data.get("simulate") or {},
        augmentation={key: value for key, value in (experiment.get("augmentation") or {}).items() if key in fields},
        training=experiment.get("training") or {},
    )


def simulation_of(learnt: TrainingHistory, frames: int, seed: int, name: str) -> SimulationConfig:
    """What to simulate as the source: the preset and world of the detector's data on other roads, without its cameras.

    Raises:
        ConfigError: If the detector did not learn from simulated frames, or there is no such preset any more.
    """
    from farfield.simulation import find_preset

    recipe = learnt.simulate
    if not recipe:
        raise ConfigError(
            f"adapt: expected labelled source frames, and {name} learnt from a real data set ({learnt.path}), which "
            "cannot be simulated. Name its labelled data or others: --source DATA"
        )
    preset = find_preset(str(recipe["preset"]))
    sensors = recipe.get("sensors") or ",".join(preset.sensors)
    sensors_without_cameras = [name.strip() for name in str(sensors).split(",") if not name.strip().startswith("cam")]
    per_sequence = min(_FRAMES, frames)
    return SimulationConfig(
        preset=preset.name,
        sequences=-(-frames // per_sequence),
        frames=per_sequence,
        seed=int(recipe.get("seed", 0)) + _OTHER_ROADS + seed,
        sensors=",".join(sensors_without_cameras),
        stride_s=recipe.get("stride_s"),
        world=recipe.get("world"),
    )


def source_frames(
    detector: "Detector",
    learnt: TrainingHistory,
    folder: Path,
    *,
    labelled: Path | None,
    frames: int,
    seed: int,
    name: str,
    whole_bodies: bool = False,
    progress: Progress = iter,
    say: Callable[[str], object] | None = None,
) -> tuple[DataConfig, Dataset]:
    """Open the labelled source as the detector sees it, simulating it where it is not there.

    Args:
        detector: The detector.
        learnt: What it learnt from.
        folder: Simulated frames are kept in its ``source``.
        labelled: A labelled data set in the place of simulated frames.
        frames: How many at most.
        seed: Another seed simulates other roads.
        name: What the detector is called, for messages.
        whole_bodies: Boxes hold whole bodies, whatever the detector learnt.
        progress: Wraps the numbers of frames that are simulated.
        say: Takes lines about the simulation.

    Returns:
        The experiment's settings of the stream, and its frames.

    Raises:
        ConfigError: If there is nothing to simulate, if other data stand where they would be simulated, or if no cloud
            suits the detector.
        DatasetError: If no frame is annotated, or ``whole_bodies`` is set and they are not known.
    """
    simulate = None if labelled is not None else simulation_of(learnt, frames, seed, name)
    path = folder / FOLDER if labelled is None else labelled
    ensure(simulate, path, progress, say)
    if simulate is not None and not (path / SIMULATION_FILE).is_file():
        raise ConfigError(
            f"adapt: expected {path} absent, or simulated by an earlier call; farfield simulate did not make what "
            "stands there. Name labelled frames of your own with --source, or another folder with --out."
        )
    options = recipe_of_experiment({"options": learnt.options})["options"] if labelled is None else {}
    opened = open_dataset(path, **options)
    view = {"whole_bodies": True} if whole_bodies and "whole_bodies" in opened.view_options else {}
    data = annotated_frames(as_trained(opened.mapped(WholeBodies()) if view else opened, detector.info), "skip")
    data = data.select(spread(len(data), frames))
    config = DataConfig(
        path=path,
        clouds=suitable_clouds(detector.info, data[0]),
        aliases=dict(learnt.aliases),
        options=(dict(learnt.options) if labelled is None else {}) | view,
        simulate=simulate,
    )
    _check_bodies(data, whole_bodies, name)
    return config, data


def _check_bodies(data: Dataset, whole_bodies: bool, name: str) -> None:
    annotation = data.annotation(0) if whole_bodies and len(data) else None
    if annotation is not None and annotation.extent != "full":
        raise ConfigError(
            f"adapt: expected source frames that tell whole bodies where whole_bodies is set; those of {data.root} "
            f"show the part that the sensor sees. Give others with --source, or adapt {name} without whole_bodies."
        )
