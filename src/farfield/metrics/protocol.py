"""What a protocol is: settings, what it takes of the detections, figures; and the registry of protocols."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from farfield.errors import ConfigError, FarfieldError
from farfield.metrics.frames import BoxesByFrame, labels_of
from farfield.metrics.options import option_text
from farfield.metrics.presenting import CurvePanel, Presentation, panels
from farfield.metrics.result import Result, figure_names, value_at
from farfield.registry import PluginError, Registry
from farfield.vocabulary.classes import CIRRUS_CLASSES

if TYPE_CHECKING:
    from farfield.metrics.bootstrap import Weighted
    from farfield.metrics.detections import Detections

P = TypeVar("P", bound="type[Protocol]")
_NUMBERS = ("range_bins_m", "epsilons")
"""Settings that are numbers: whole ones and lists are taken too, and give the same JSON."""


class Protocol(ABC):
    """A way to score detections.

    A protocol of one class has a setting ``label``; without one given the most annotated class is scored, of those that
    the detector knows where there are any. Settings
    named ``relabel``, ``ignore``, ``range_bins_m``, ``region`` and ``bootstrap`` mean what they mean in
    :class:`farfield.metrics.centre.settings.CentreSettings`.

    Args:
        variant: What follows the colon in the protocol's name.

    Raises:
        ConfigError: If the protocol has no variants.
    """

    name: ClassVar[str] = ""
    """What it is called in ``score`` and on the command line."""
    family: ClassVar[str] = ""
    """Protocols of one family share columns where their settings agree; empty: the name."""
    Settings: ClassVar[type[Any]]
    """A frozen dataclass whose fields all have defaults: they are the flags."""
    uses: ClassVar[frozenset[str]] = frozenset()
    """What it takes of the detections besides boxes: ``"conditions"``, ``"visibility"``, ``"details"``."""
    several_classes: ClassVar[bool] = False
    """Whether one result holds several classes, named by the setting ``classes``, as ``ap/CLASS/...``."""
    classes: ClassVar[Mapping[str, str]] = {name: name for name in CIRRUS_CLASSES if name != "unknown"}
    """All classes of the data that it is for, ours by the data's own name."""
    per_cent: ClassVar[bool] = False
    """Whether tables show its figures in per cent."""

    def __init__(self, variant: str = "") -> None:
        if variant:
            raise ConfigError(f"protocol {self.name!r} has no variants, got {variant!r} after the colon")

    def __str__(self) -> str:
        return self.name

    @abstractmethod
    def evaluate(self, found: "Detections", settings: Any) -> Result:
        """Score detections whose every annotated frame has an entry of boxes; settings are a ``Settings``."""

    def weighted(self, found: "Detections", settings: Any) -> "Weighted":
        """The same figures as functions of group weights, from which differences of results are drawn.

        Args:
            found: Detections that count, as ``evaluate`` takes them.
            settings: A ``Settings``.

        Raises:
            ConfigError: If the protocol does not say how its figures depend on weights.
        """
        del found, settings
        raise ConfigError(
            f"protocol {self}: expected one whose figures can be resampled, to decide on differences; got one without. "
            "Give its class a method weighted(found, settings), or choose dds, nuscenes, kitti or kradar"
        )

    def options(self) -> tuple[str, ...]:
        """Names of the settings."""
        return tuple(field.name for field in fields(self.Settings))

    def default(self, name: str) -> Any:
        """The default of a setting; None where there is no such setting."""
        return getattr(self.Settings(), name, None)

    def settings(self, found: "Detections", **given: Any) -> Any:
        """The settings of a score: those given, and defaults of which some depend on the data.

        Raises:
            ConfigError: If a setting is unknown or impossible.
        """
        unknown = sorted(set(given) - set(self.options()))
        if unknown:
            expected = ", ".join(self.options())
            raise ConfigError(f"{self}: expected options among {expected}; got {', '.join(unknown)}")
        edges_and_weights = {name: given[name] for name in _NUMBERS if given.get(name) is not None}
        given |= {name: tuple(map(float, values)) for name, values in edges_and_weights.items()}
        if "label" in self.options() and given.get("label") is None:
            given = {name: value for name, value in given.items() if name != "label"}
            present = self.labels(found.annotated, **given)
            known = self._known(found.classes, **given)
            given |= {"label": next((name for name in present if name in known), present[0])} if present else {}
        return self.Settings(**given)

    def _known(self, classes: Collection[str], **given: Any) -> set[str]:
        """What a detector's classes are called after relabelling."""
        default = self.Settings(
            **{name: given[name] for name in ("relabel",) if name in given and name in self.options()}
        )
        relabel = getattr(default, "relabel", {})
        return {relabel.get(name, name) for name in classes}

    def labels(self, boxes: BoxesByFrame, **given: Any) -> tuple[str, ...]:
        """Classes that can be scored, the most frequent first: relabelled ones as one, ignored ones left out."""
        chosen = {name: given[name] for name in ("relabel", "ignore") if name in given and name in self.options()}
        default = self.Settings(**chosen)
        names = (name for name, _ in labels_of(boxes, getattr(default, "relabel", {})))
        return tuple(name for name in names if name not in (getattr(default, "ignore", None) or ()))

    def each(self, found: "Detections", *, label: str | None = None, **given: Any) -> list[Any]:
        """The settings of one result a class, the most annotated class first.

        Args:
            found: The detections.
            label: The only class to score; None for every annotated one.
            **given: Further settings.

        Raises:
            ConfigError: If no box bears the label, or a setting is unknown or impossible.
        """
        if "label" not in self.options():
            return [self.settings(found, **given)]
        found.check_label(self, label, **given)
        present = self.labels(found.annotated, **given)
        names = [label] if label is not None else present or (None,)
        return [self.settings(found, label=name, **given) for name in names]

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """The few figures that stand for a result: for the terminal, ``compare-results`` and the page.

        Args:
            result: Result JSON, or a part of it (a range bin, a condition).

        Returns:
            Figures by name, such as ``"dds/0/dds"``, the first one first; all figures unless the protocol chooses.
        """
        return {name: value_at(result, name) for name in figure_names(result)}

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """What a page shows of a result: columns, words, and what counts as found in pictures.

        Args:
            result: Result JSON.
        """
        return Presentation(figures=tuple(self.headline(result)))

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """The curves of the whole, by panel.

        Args:
            result: Result JSON.

        Raises:
            ConfigError: If a curve is damaged.
        """
        return panels((result.get("curves") or {}).get("overall"))

    def unit(self, figure: str) -> str:
        """The unit in which a figure is shown: ``"%"``, ``"m"``, ``"rad"``..., or nothing for a share.

        Args:
            figure: Its name.
        """
        del figure
        return "%" if self.per_cent else ""

    def title(self, figure: str) -> str:
        """What a figure's column is called.

        Args:
            figure: Its name, of a result of several classes without the class: ``"3d/0.3"``.
        """
        return " ".join(figure.removeprefix("ap/").split("/")).replace("3d", "3D").replace("bev", "BEV")

    def setting_title(self, name: str) -> str:
        """What a setting is called on a page, with its unit at the end as in ``limit_m``."""
        return name

    def inert(self, settings: Mapping[str, Any]) -> Collection[str]:
        """Settings on which no figure of the whole depends, so that results that differ in them share a column.

        Args:
            settings: Settings of a result's JSON.
        """
        names = ["bootstrap", "label"]
        region = settings.get("region")
        return [*names, *(["window_m"] * (region != "window")), *(["range_bins_m"] * (region == "none"))]

    def depends_on(self, settings: Mapping[str, Any], *, by_range: bool = False) -> dict[str, Any]:
        """The settings on which figures depend; ``by_range`` for those of range bins, on which the bins bear."""
        inert = set(self.inert(settings)) - ({"range_bins_m"} if by_range else set())
        return {name: value for name, value in settings.items() if name not in inert}

    def convention_text(self, settings: Mapping[str, Any], *, by_range: bool = False) -> str:
        """The settings on which figures depend, as one line of ``name=value`` pairs."""
        return option_text(self.depends_on(settings, by_range=by_range))


def relabel_of(protocol: Protocol, given: Mapping[str, Any]) -> Mapping[str, str]:
    """Which class names a protocol counts as others, under the settings that are given."""
    chosen = {name: given[name] for name in ("relabel",) if name in given and name in protocol.options()}
    found: Mapping[str, str] = getattr(protocol.Settings(**chosen), "relabel", None) or {}
    return found


class ForeignProtocol(Protocol):
    """A protocol known from its results only: that of a package that is not installed here."""

    def __init__(self, variant: str = "") -> None:
        self.known_as = variant

    def __str__(self) -> str:
        return self.known_as

    def evaluate(self, found: "Detections", settings: Any) -> Result:
        """Refuse.

        Raises:
            ConfigError: Always.
        """
        del found, settings
        raise ConfigError(f"protocol {self.known_as!r} is not installed here")


class Protocols(Registry[Any]):
    """Protocols by name; what follows a colon is the variant: ``PROTOCOLS["kradar-compat:rtnh_wide"]``."""

    def __getitem__(self, name: str) -> Protocol:
        kind, colon, variant = name.partition(":")
        found: Any = super().__getitem__(kind)
        if isinstance(found, type):
            found = found(variant) if colon else found()
        if not isinstance(found, Protocol):
            raise PluginError(
                f"protocol {kind!r} of {self.origin(kind)} cannot be used: expected a class that inherits "
                f"farfield.metrics.Protocol, or an object of one; got {found!r}"
            )
        return found


PROTOCOLS = Protocols(
    "farfield.protocols",
    "protocol",
    {
        "dds": "farfield.metrics.centre.dds:Dds",
        "nuscenes": "farfield.metrics.centre.nuscenes:NuScenes",
        "kitti": "farfield.metrics.kitti.protocol:KittiProtocol",
        "kradar": "farfield.metrics.kradar.protocol:KRadarProtocol",
        "kradar-compat": "farfield.metrics.kradar.protocol:KRadarCompat",
        "tracking": "farfield.metrics.tracking.protocol:Tracking",
        "nuscenes-tracking": "farfield.metrics.tracking.nuscenes:NuScenesTracking",
    },
)


def protocol(name: str) -> Callable[[P], P]:
    """Register a protocol's class in this process, as a notebook does.

    Args:
        name: What it is called from then on.

    Raises:
        ConfigError: If the name is a built-in one, or the class is no protocol.
    """
    return partial(_register, name)


def _register(name: str, kind: P) -> P:
    if not (isinstance(kind, type) and issubclass(kind, Protocol)):
        raise ConfigError(f"protocol {name!r}: expected a class that inherits farfield.metrics.Protocol, got {kind!r}")
    registered = PROTOCOLS.register(name)(kind)
    registered.name = name
    return registered


def protocol_of(result: Mapping[str, Any]) -> Protocol:
    """The protocol of a result's JSON, whether or not it is installed here."""
    name = str(result.get("protocol", ""))
    try:
        return PROTOCOLS[name]
    except FarfieldError:
        return ForeignProtocol(name)
