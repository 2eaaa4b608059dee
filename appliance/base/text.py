"""Owns how values with arrays are shown where somebody looks at them in a notebook: in one line, arrays by their shape.

A dataclass of a cloud prints whole arrays of NaN otherwise, over many lines, and a cell that ends in its name is a
wall.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

_SHOWN = 40
"""Longest text of a field; what is longer is named by its class."""


def one_line(self: Any) -> str:
    """Return a dataclass in one line, for ``__repr__``: ``Mesh(vertices_mm=(8100, 3) float32, …)``."""
    # `self`, for it stands in a class's body as a method does.
    return (
        f"{type(self).__name__}({', '.join(f'{one.name}={_short(getattr(self, one.name))}' for one in fields(self))})"
    )


def _short(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    if isinstance(value, tuple | list | dict) and value:
        return f"{len(value)} in a {type(value).__name__}"
    text = repr(value)
    return text if len(text) <= _SHOWN and "\n" not in text else f"<{type(value).__name__}>"
