"""Owns what one check of the bring-up says: whether it is as it must be, in numbers, and otherwise what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Finding:
    """Outcome of one check."""

    name: str
    """Word by which it is known in reports, like ``latency``."""
    ok: bool
    said: str
    """Whole sentence about what was seen."""
    limits: str = ""
    """Range that it was held against."""
    remedy: str = ""
    """Advice where it is not ``ok``."""
    numbers: Mapping[str, float | None] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        return asdict(self)


def judged(name: str, ok: bool, said: str, limits: str, remedy: str, **numbers: float | None) -> Finding:
    """Return the finding of a check; its ``remedy`` counts only where it is not ``ok``."""
    measured = {key: None if value is None else float(value) for key, value in numbers.items()}
    return Finding(name, ok, said, limits, "" if ok else remedy, measured)


class BringupError(Exception):
    """A measurement of the bring-up could not be made; the text says which, and what to do."""
