"""One experiment is one YAML file: data, detector, augmentation, training. Unknown keys are errors."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    SerializeAsAny,
    Tag,
    ValidationError,
    create_model,
    field_validator,
    model_serializer,
    model_validator,
)

from farfield.detectors import DETECTORS
from farfield.detectors.config import DetectorConfig, current_key, renamed
from farfield.errors import ConfigError, FarfieldError, did_you_mean, fault_of, plain
from farfield.experiments.catalogue import find
from farfield.files.atomic import read_bytes
from farfield.files.remote_paths import as_path
from farfield.files.yaml_text import MAX_BYTES, PlainSettings, plain_yaml
from farfield.simulation.donor_frames import DonorConfig
from farfield.simulation.recording import SimulationConfig
from farfield.training.config import AugmentationConfig, TrainingConfig

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


class DataConfig(PlainSettings):
    """What to train on."""

    path: Annotated[Path, AfterValidator(as_path)] = Field(description="the data set's folder, or its URL")
    split: str | None = Field(
        None, description="train, val, test, time-train, time-val, time-test (cut in time), or nothing for all frames"
    )
    clouds: Annotated[tuple[str, ...], Field(min_length=1)] | dict[str, tuple[str, ...]] = Field(
        ("gaussian", "uniform"), description="clouds to learn from in turn, or such a list for each of several inputs"
    )
    part: tuple[float, float] = Field(
        (0.0, 1.0), description="part of the sequences, in an order drawn by part_draw: (0, 0.25) lies in (0, 0.5)"
    )
    part_draw: int = Field(0, ge=0, description="another number draws another order of the sequences")
    sweeps: int = Field(
        1, ge=1, le=100, description="clouds a frame: those of the frames before it, moved by the poses"
    )
    aliases: dict[str, str] = Field(default_factory=dict, description="classes renamed before training")
    options: dict[str, Any] = Field(default_factory=dict, description="options of the data set's reader")
    simulate: SimulationConfig | None = None
    donors: DonorConfig | None = Field(
        None, description="the sweeps lend their background to simulated road users; their own boxes are taken out"
    )

    @model_serializer(mode="wrap")
    def _serialised(self, others: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All settings; donors only where there are some, so that trainings without are recognised as before."""
        return {name: value for name, value in others(self).items() if name != "donors" or value is not None}

    @model_validator(mode="after")
    def _one_cloud(self) -> "DataConfig":
        if self.donors is not None and (not isinstance(self.clouds, tuple) or len(self.clouds) != 1):
            raise ValueError(f"donors: expected one cloud, such as clouds: [lidar]; got {self.clouds}")
        return self

    @field_validator("part")
    @classmethod
    def _rising(cls, part: tuple[float, float]) -> tuple[float, float]:
        if not 0 <= part[0] < part[1] <= 1:
            raise ValueError(f"expected two rising shares from 0 to 1, got {list(part)}")
        return part


class MethodConfig(BaseModel):
    """How to train: a method's name and, beside it, its own settings."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str = Field("supervised", description="which method; `supervised` learns from annotated frames")

    @property
    def settings(self) -> dict[str, Any]:
        """The method's own settings."""
        return dict(self.model_extra or {})


def _one_or_several(data: Any) -> str:
    """Whether ``data`` describes one data set or, by stream, several."""
    if not isinstance(data, Mapping) or "path" in data:
        return "one"
    return "several" if all(isinstance(group, Mapping | DataConfig) for group in data.values()) else "one"


Data = Annotated[
    Annotated[DataConfig, Tag("one")] | Annotated[dict[str, DataConfig], Tag("several")], Discriminator(_one_or_several)
]


class Experiment(PlainSettings):
    """Everything that decides the outcome of a training.

    ``data`` is what a method with one stream of samples learns from; a method with several has one such group for each,
    by their names.
    """

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", description="what the run and its folder are called")
    data: Data
    method: MethodConfig = MethodConfig()
    detector: SerializeAsAny[DetectorConfig] = Field({"name": "pointpillars"}, validate_default=True)
    augmentation: AugmentationConfig = AugmentationConfig()
    training: TrainingConfig = TrainingConfig()

    @field_validator("detector", mode="before")
    @classmethod
    def _of_its_kind(cls, value: Any) -> Any:
        """The settings of the detector that ``name`` names; PointPillars if it names none."""
        if not isinstance(value, dict):
            return value
        try:
            kind = DETECTORS[str(value.get("name", "pointpillars"))].config_class
        except FarfieldError as error:
            raise ValueError(str(error)) from error
        return kind.model_validate(value)


def load_experiment(path: Path | str, overrides: list[str] | None = None) -> Experiment:
    """Read an experiment and apply overrides such as ``training.steps=500``.

    A file with ``extends: FILE`` lies over another, named relative to its folder, or over a shipped experiment by its
    name: groups of settings are merged; values, lists and mappings of names (anchors, sizes, pasted objects) replaced.

    Raises:
        ConfigError: If the file cannot be read, or a key or value is not one of those possible.
    """
    return experiment_of(_extended(Path(path)), overrides or (), where=str(path))


def _extended(path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The settings of a file over those of the files that it extends."""
    tree = _tree(path)
    base = tree.pop("extends", None)
    if base is None:
        return tree
    if not isinstance(base, str) or "name" not in tree:
        lacks = "a file or a shipped experiment" if not isinstance(base, str) else "a name of its own beside it"
        raise ConfigError(f"{path}: expected extends: with {lacks}, got {base!r}.")
    below_path = (path.parent / base) if (path.parent / base).is_file() else find(base)
    if below_path.resolve() in (path.resolve(), *above):
        raise ConfigError(f"{path}: extends itself, by {base}.")
    below = _extended(below_path, (*above, path.resolve()))
    if _detector_name(tree, below) != _detector_name(below):
        below = {name: value for name, value in below.items() if name != "detector"}
    name = _detector_name(tree, below)
    for part in (below, tree):
        if "detector" in part:
            part["detector"] = _with_current_names(part["detector"], _kind(name), str(path))
    return merged(below, tree, _model_of(name))


def _tree(path: Path) -> dict[str, Any]:
    try:
        tree = plain_yaml(read_bytes(path, max_bytes=MAX_BYTES))
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: expected an experiment's YAML file, found nothing.") from error
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: expected YAML, found {plain(error)}.") from error
    if not isinstance(tree, dict):
        raise ConfigError(
            f"{path}: expected a mapping with the keys name, data, detector..., found {type(tree).__name__}."
        )
    return tree


def experiment_of(tree: dict[str, Any], overrides: Sequence[str] = (), *, where: str = "experiment") -> Experiment:
    """Check the settings of an experiment and apply overrides to them.

    Args:
        tree: The settings, as YAML holds them; overrides change it.
        overrides: Such as ``training.steps=500``.
        where: Where the settings come from, for messages.

    Raises:
        ConfigError: If a key or value is not one of those possible.
    """
    name = _detector_name(tree)
    for override in overrides:
        name = override.removeprefix("detector.name=") if override.startswith("detector.name=") else name
        _override(tree, _kind(name), override)
    try:
        return Experiment.model_validate(tree)
    except ValidationError as error:
        lines = [_fault(item, _model_of(_detector_name(tree))) for item in error.errors()]
        raise ConfigError(f"{where}: {len(lines)} setting(s) do not fit:\n" + "\n".join(lines)) from error


def _detector_name(*trees: dict[str, Any]) -> str:
    """Name of the detector: that of the first of several trees of settings that says it."""
    names = [tree["detector"].get("name") for tree in trees if isinstance(tree.get("detector"), dict)]
    return next((str(name) for name in names if name), "pointpillars")


def _kind(detector: str) -> type[DetectorConfig]:
    """The settings of a detector; of one that is not known, those that all share."""
    try:
        return DETECTORS[detector].config_class
    except FarfieldError:
        return DetectorConfig


def _model_of(detector: str) -> type[Experiment]:
    """The model of an experiment with this detector."""
    return create_model("Experiment", __base__=Experiment, detector=(_kind(detector), ...))


def _fault(item: "ErrorDetails", model: type[Experiment]) -> str:
    """A line on what does not fit; for an unknown key with those that there are."""
    # Keys of the file that lead to the fault, without the words of the choice between one data set and several
    path = [key for level, key in enumerate(item["loc"]) if not (level == 1 and key in ("one", "several"))]
    what = fault_of(item)
    if item["type"] == "extra_forbidden":
        what = hint(str(path[-1]), keys_of(model, path[:-1]))
    return f"  {'.'.join(map(str, path))}: {what}"


def _with_current_names(settings: Any, detector: type[DetectorConfig], where: str) -> Any:
    try:
        return renamed(settings, detector.old_names)
    except ValueError as error:
        raise ConfigError(f"{where}: detector: {error}.") from error


def _override(tree: dict[str, Any], detector: type[DetectorConfig], override: str) -> None:
    path, separator, value = override.partition("=")
    if not separator or not path:
        raise ConfigError(f"Expected an override of the form key.key=value, got {override!r}.")
    group, dot, within = path.partition(".")
    path = f"{group}.{current_key(within, detector.old_names)}" if group == "detector" and dot else path
    if group == "detector" and isinstance(tree.get(group), dict):
        tree[group] = _with_current_names(tree[group], detector, override)
    *parents, last = path.split(".")
    for key in parents:
        tree = tree.setdefault(key, {})
        if not isinstance(tree, dict):
            raise ConfigError(f"Expected {key!r} in {override!r} to be a group of settings; it is a value.")
    try:
        tree[last] = plain_yaml(value)
    except yaml.YAMLError as error:
        raise ConfigError(f"{override!r}: expected a value as YAML writes it, got {value!r}.") from error


def dump_experiment(experiment: Experiment) -> str:
    """The resolved experiment as YAML: every setting, defaults included."""
    return yaml.safe_dump(experiment.model_dump(mode="json"), sort_keys=False)


# Which keys stand where, and how one file extends another

Tree = dict[str, Any]
_FURTHER = {"TrainingConfig": ("start_from",), "Experiment": ("extends",)}
"""Keys that a group takes besides its fields."""


def keys_of(kind: Any, path: Sequence[str | int]) -> list[str]:
    """The keys that a group of settings takes.

    Args:
        kind: A model, or an annotation of one.
        path: Keys that lead to the group.
    """
    models = list(_models(kind, path))
    names = [name for model in models for name in [*model.model_fields, *_FURTHER.get(model.__name__, ())]]
    return list(dict.fromkeys(names))


def is_group(kind: Any, path: Sequence[str | int]) -> bool:
    """Whether settings stand there, and not a value or a mapping of names such as of classes."""
    return any(True for _ in _models(kind, path))


def hint(key: str, keys: Sequence[str]) -> str:
    """What an unknown key's error says of those that there are."""
    return f"there is no such key; the keys here are {', '.join(keys)}.{did_you_mean(key, keys)}"


def merged(base: Tree, over: Tree, kind: Any, path: tuple[str, ...] = ()) -> Tree:
    """Settings laid over others: groups are merged key by key; values, lists and mappings of names are replaced.

    Args:
        base: The settings below.
        over: Those above.
        kind: The model of the whole tree.
        path: Where in the whole tree the two stand.
    """
    tree = dict(base)
    for key, value in over.items():
        below, inner = base.get(key), (*path, key)
        merges = is_group(kind, inner) or inner == ("data",)  # data of several streams are groups by name
        if isinstance(value, Mapping) and isinstance(below, Mapping) and merges:
            value = merged(dict(below), dict(value), kind, inner)
        tree[key] = value
    return tree


def _models(kind: Any, path: Sequence[str | int]) -> Iterator[type[BaseModel]]:
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if not path:
            yield kind
        elif path[0] in kind.model_fields:
            yield from _models(kind.model_fields[str(path[0])].annotation, path[1:])
    elif origin is Annotated:
        yield from _models(arguments[0], path)
    elif origin in (Union, UnionType):
        for argument in arguments:
            yield from _models(argument, path)
    elif isinstance(origin, type) and issubclass(origin, Mapping) and path:
        yield from _models(arguments[1], path[1:])
    elif origin in (list, tuple) and path:
        yield from _models(arguments[0], path[1:])
