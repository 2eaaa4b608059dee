"""Owns the shape in which long work tells how far it is."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Hears what is being done now, in words, and how much of the whole is done (0..1), where that is known."""

    def __call__(self, what: str, fraction: float | None = None, /) -> None: ...


def silent(what: str, fraction: float | None = None, /) -> None:
    """Say nothing."""


def part_of(progress: Progress, begin: float, end: float, name: str = "") -> Progress:
    """Return the progress of a part of the work, which is the fractions ``begin`` to ``end`` of the whole. ``name``
    stands before its words."""

    def tell(what: str, fraction: float | None = None, /) -> None:
        progress(f"{name}: {what}" if name else what, begin + (end - begin) * (fraction or 0.0))

    return tell
