"""The finding of one check of the bring-up: a statement, its limits and, if it failed, a remedy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check."""

    name: str
    """Name in reports, like ``latency``."""
    ok: bool
    said: str
    """The result as a sentence."""
    limits: str = ""
    """Allowed range, in words."""
    remedy: str = ""
    """Remedy where it is not ``ok``."""
    numbers: Mapping[str, float | None] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the finding, JSON-ready."""
        return asdict(self)


def finding_of(name: str, ok: bool, statement: str, limits: str, remedy: str, **numbers: float | None) -> Finding:
    """Return the finding of a check; its ``remedy`` counts only where it is not ``ok``."""
    measured = {key: None if value is None else float(value) for key, value in numbers.items()}
    return Finding(name, ok, statement, limits, "" if ok else remedy, measured)


class BringupError(Exception):
    """Error of a measurement that was not possible; the text has the reason and the remedy."""
