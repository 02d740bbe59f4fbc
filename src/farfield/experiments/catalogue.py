"""The experiments that ship with the package, and how they are called."""

from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

from farfield.errors import ConfigError, did_you_mean
from farfield.files.yaml_text import plain_yaml

FOLDER = Path(__file__).resolve().parent


@dataclass(frozen=True, kw_only=True)
class ShippedExperiment:
    """One shipped experiment.

    Args:
        name: What it is called, by its field ``name``.
        title: What it is: the first comment line of its file.
        path: Its file.
        detector: The detector it trains.
        data: Where its data are, as its file says; simulated ones are made there.
        simulated: Preset of the data that are simulated where they are absent; empty for a real data set.
        steps: Training steps.
    """

    name: str
    title: str
    path: Path
    detector: str
    data: str
    simulated: str
    steps: int


def shipped() -> tuple[ShippedExperiment, ...]:
    """All shipped experiments, by name."""
    return tuple(sorted((_shipped(path) for path in FOLDER.glob("*.yaml")), key=attrgetter("name")))


def names() -> tuple[str, ...]:
    """Names of the shipped experiments."""
    return tuple(entry.name for entry in shipped())


def find(name_or_path: str | Path) -> Path:
    """The file of an experiment: a file's path, or a shipped experiment's name.

    A path to a file wins. A name is that in the experiment or that of its file, with or without the suffix; ``-`` and
    ``_`` are alike.

    Raises:
        ConfigError: If there is neither such a file nor such an experiment.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    entries = {_plain(entry.name): entry for entry in shipped()}
    entries |= {_plain(entry.path.name): entry for entry in entries.values()}
    if len(path.parts) == 1 and _plain(path.name) in entries:
        return entries[_plain(path.name)].path
    names = [entry.name for entry in shipped()]
    if path.parent.is_dir():
        names += [str(beside) for ending in ("yaml", "yml") for beside in path.parent.glob(f"*.{ending}")]
    raise ConfigError(
        f"{name_or_path}: expected an experiment's YAML file or the name of a shipped experiment, found nothing."
        f"{did_you_mean(str(path), names, most=4)} farfield experiments lists those that ship."
    )


def _shipped(path: Path) -> ShippedExperiment:
    text = path.read_text(encoding="utf-8")
    tree: dict[str, Any] = plain_yaml(text)
    simulate = tree["data"].get("simulate") or {}
    return ShippedExperiment(
        name=tree["name"],
        title=text.partition("\n")[0].lstrip("# "),
        path=path,
        detector=tree["detector"]["name"],
        data=tree["data"]["path"],
        simulated=simulate.get("preset", ""),
        steps=tree["training"]["steps"],
    )


def _plain(name: str) -> str:
    return name.removesuffix(".yaml").replace("_", "-").lower()
