"""What all messages share: frozen dataclasses whose fields are checked, with nothing unknown among them."""

from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, dataclass_transform

from pydantic import ConfigDict, Field

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def message(cls: type[T]) -> type[T]:
    """Make a class a message: a frozen dataclass that pydantic checks strictly, without unknown fields, inf or NaN."""
    cls.__pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)  # type: ignore[attr-defined]
    return dataclass(frozen=True, kw_only=True)(cls)


MOST_FRAMES = 10_000_000

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9._:+-]+$")]
"""An identity that a client makes up, or a name of ours: letters, digits and ``. _ - : +``."""
FileName = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9._-]+$")]
Word = Annotated[str, Field(max_length=128)]
Note = Annotated[str, Field(max_length=2000)]
Index = Annotated[int, Field(ge=0, lt=MOST_FRAMES)]
"""Number of a frame in the open data set."""
Track = Annotated[int, Field(ge=0, lt=2**31)]
Count = Annotated[int, Field(ge=0, lt=2**53)]
Nanoseconds = Annotated[str, Field(pattern=r"^-?[0-9]{1,20}$")]
"""int64 as text: 1.6e18 exceeds what a number of the browser holds exactly (2^53)."""
Place = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Size = Annotated[float, Field(gt=0.0, le=60.0)]
Yaw = Annotated[float, Field(ge=-10.0, le=10.0)]
Part = Annotated[float, Field(ge=0.0, le=1.0)]

BoxNumbers = tuple[Place, Place, Place, Size, Size, Size, Yaw]
"""Centre x, y, z in metres, full length, width, height in metres, yaw in radians, as a client may set them."""
AnyBox = tuple[float, float, float, float, float, float, float]
"""The same as files hold them: within no bounds."""
Matrix = Annotated[tuple[float, ...], Field(min_length=16, max_length=16)]
"""A 4 x 4 matrix, row by row."""
Attributes = Annotated[dict[Word, str | int | float | bool | None], Field(max_length=64)]


def plain(value: Any) -> Any:
    """A message as what JSON knows; much faster than ``dataclasses.asdict``, which copies."""
    if isinstance(value, str | int | float | bool) or value is None:
        return value
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    return {name: plain(each) for name, each in vars(value).items()}
