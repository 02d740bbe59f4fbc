"""The record of a training, as a file of weights holds it: what of it is read by name, and what is left out of others'.

Needs no torch.
"""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Discriminator, Tag, ValidationError

from farfield.errors import FileFormatError, plain
from farfield.files.json_text import plain_json

_MOST_ODD = 1000  # entries of a provenance that are left out
_RECORDS = ("model_type", "model_attributes_type", "dict_type", "missing")  # pydantic's names for what is no record


class _Record(BaseModel):
    """What of a provenance is read by name; there may be more."""

    model_config = ConfigDict(extra="allow", strict=True)


class _Donors(_Record):
    family: str = ""
    places: list[str] = []


class _Stream(_Record):
    data_fingerprint: str | None = None
    frames: int | None = None
    recipe: dict[str, Any] | None = None
    frame_digests: str | None = None
    open_sweeps: list[str] | None = None
    donors: _Donors | None = None


class _Simulated(_Record):
    preset: str
    seed: int = 0


class _Data(_Record):
    path: str
    clouds: list[str] | dict[str, list[str]] = []
    simulate: _Simulated | None = None
    options: dict[str, Any] = {}


def _data_tag(data: Any) -> str:
    """Whether the settings are those of one stream or of several by name."""
    several = isinstance(data, dict) and all(isinstance(group, dict) for group in data.values())
    return "<streams>" if several else "<one>"


class _Experiment(_Record):
    name: str = ""
    data: Annotated[
        Annotated[_Data, Tag("<one>")] | Annotated[dict[str, _Data], Tag("<streams>")], Discriminator(_data_tag)
    ] = {}
    training: dict[str, Any] = {}
    method: dict[str, Any] = {}


class _Start(_Record):
    weights: str = ""
    frame_digests: str | None = None
    open_sweeps: list[str] | None = None
    family: str = ""


class _Adapted(_Record):
    start_frame_digests: str | None = None
    open_sweeps: list[str] | None = None


class Provenance(_Stream):
    """The record of a training, as far as it is read by name."""

    experiment: _Experiment = _Experiment()
    streams: dict[str, _Stream] = {}
    start: _Start = _Start()
    adapted: _Adapted = _Adapted()
    held_out: _Stream = _Stream()
    validation: dict[str, Any] = {}
    environment: dict[str, Any] = {}
    stream: str = ""
    family: str = ""


def provenance_of(path: Path, text: str) -> dict[str, Any]:
    """The record of a training as far as it has the form of ours; a warning names what is left out of others'."""
    try:
        provenance: dict[str, Any] = plain_json(text)
        odd = list(_left_out(provenance))
    except ValueError as error:
        expected = "the record of a training, as JSON"
        raise FileFormatError(path, where="provenance", expected=expected, got=plain(error)[:300]) from error
    if odd:
        shown = "; ".join(odd[:5]) + (f"; and {len(odd) - 5} more" if len(odd) > 5 else "")
        warnings.warn(
            f"{path}: the provenance is read but for what has another form than ours, {shown}. What these weights "
            "learnt from is not known as far as it stands there",
            stacklevel=3,
        )
    return provenance if isinstance(provenance, dict) else {}


def _left_out(provenance: Any) -> Iterator[str]:
    """Take out of a provenance what is not understood, place by place; records that were none are empty afterwards."""
    for _ in range(_MOST_ODD):
        try:
            Provenance.model_validate(provenance)
            return
        except ValidationError as error:
            odd = error.errors(include_url=False, include_context=False)[0]
        if not isinstance(provenance, dict):
            yield f"provenance: {odd['msg']}"
            return
        parent, names = provenance, list(odd["loc"][:1])
        for name in odd["loc"][1:]:  # tags of pydantic's stand among the keys
            if isinstance(parent[names[-1]], dict) and name in parent[names[-1]]:
                parent = parent[names[-1]]
                names.append(name)
        is_record = odd["type"] in _RECORDS
        if is_record and parent[names[-1]] != {}:
            parent[names[-1]] = {}
        else:
            del parent[names[-1]]
        yield f"{'.'.join(map(str, names))}: {odd['msg']}"
    raise ValueError(f"more than {_MOST_ODD} entries of another form")
