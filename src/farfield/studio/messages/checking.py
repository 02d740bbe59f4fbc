"""Messages to and from JSON text, checked."""

import json
from functools import lru_cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from farfield.errors import ConfigError, fault_of
from farfield.studio.messages.base import plain
from farfield.studio.messages.requests import Request


@lru_cache(maxsize=1)
def _adapter() -> Any:
    return TypeAdapter(Request)


def read_request(text: str | bytes) -> Any:
    """A message of the page.

    Args:
        text: JSON, one object with the field ``op``.

    Raises:
        ConfigError: If it is no such message: unknown field or op, wrong kind, out of bounds, inf or NaN.
    """
    try:
        return _adapter().validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "message"
        raise ConfigError(f"message refused: {where}: {fault_of(first)}") from None


def write_reply(reply: Any) -> str:
    """A message to the page as JSON text.

    Raises:
        ValueError: If a number is not finite.
    """
    return json.dumps(plain(reply), separators=(",", ":"), allow_nan=False)
