"""Short representations of dataclasses with arrays, for notebooks: one line, arrays by their shape.

A dataclass of a cloud would otherwise print whole arrays of NaN, over many lines.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

_SHOWN = 40
"""Longest text of a field; a longer one is replaced by the name of its class."""


def one_line(self: Any) -> str:
    """Return a dataclass in one line, for ``__repr__``: ``Mesh(vertices_mm=(8100, 3) float32, …)``."""
    # `self`, since classes take this function as a method.
    return f"{type(self).__name__}({', '.join(f'{item.name}={_short(getattr(self, item.name))}' for item in fields(self))})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    if isinstance(value, tuple | list | dict) and value:
        return f"{len(value)} in a {type(value).__name__}"
    text = repr(value)
    return text if len(text) <= _SHOWN and "\n" not in text else f"<{type(value).__name__}>"
