"""The face of a package: the names that others may import from it, each loaded at its first use.

A package's ``__init__`` lists them under ``if TYPE_CHECKING:``, as ``from .module import Name as Name  # a sentence``,
where type checkers, import contracts and readers find them. Loading all of them at once would load every kernel before
the first mistake in a command line is reported.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["lazy_face", "modules_of_face"]


def modules_of_face(package: str) -> dict[str, str]:
    """Return the module of each name that the type-checking block in ``package``'s ``__init__`` imports."""
    source = Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8")
    return {
        alias.asname or alias.name: f"{package}.{statement.module}" if statement.level else str(statement.module)
        for block in ast.parse(source).body
        if isinstance(block, ast.If)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }


def lazy_face(room: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of the package ``room``."""
    modules = modules_of_face(room)

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"{room} has no name {name!r}; its face has: {', '.join(sorted(modules))}")
        value = getattr(importlib.import_module(modules[name]), name)
        setattr(sys.modules[room], name, value)
        return value

    names = sorted(modules)
    return load, lambda: names, names
