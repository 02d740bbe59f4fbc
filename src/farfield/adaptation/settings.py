"""Checked settings of methods and of their parts."""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.errors import ConfigError, fault_of


class MethodSettings(BaseModel):
    """Settings of a method, or of a part of it; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


Chosen = TypeVar("Chosen", bound=MethodSettings)

HELD_OUT: Any = Field(
    0,
    ge=0,
    description="frames of each stream that are not trained on: at each tenth of the run the domains are told there",
)


def settings_of(kind: type[Chosen], method: str, given: Mapping[str, Any]) -> Chosen:
    """Check the settings of a method.

    Raises:
        ConfigError: If one is unknown or does not fit; the message names each.
    """
    try:
        return kind.model_validate(dict(given))
    except ValidationError as error:
        lines = [f"  {'.'.join(map(str, item['loc'])) or 'settings'}: {fault_of(item)}" for item in error.errors()]
        known = ", ".join(field.alias or name for name, field in kind.model_fields.items())
        raise ConfigError(
            f"method {method}: {len(lines)} setting(s) do not fit:\n" + "\n".join(lines) + f"\nIt has: {known}."
        ) from error
