"""The package's sources, parsed once a process and only where a test reads them."""

import ast
from collections.abc import Mapping
from functools import cache
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src" / "farfield"


@cache
def sources() -> Mapping[str, str]:
    """The text of every module by its path within the package."""
    return {path.relative_to(SOURCE).as_posix(): path.read_text("utf-8") for path in sorted(SOURCE.rglob("*.py"))}


@cache
def trees() -> Mapping[str, ast.Module]:
    """Every module, parsed."""
    return {name: ast.parse(text) for name, text in sources().items()}
