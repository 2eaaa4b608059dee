"""Progress reports of long work: the callback's type, a silent one, and one for a part of the work."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Callback for the current activity, in words, and the finished share of the work (0..1), if known."""

    def __call__(self, what: str, fraction: float | None = None, /) -> None: ...


def silent(what: str, fraction: float | None = None, /) -> None:
    """Report no progress."""


def part_of(progress: Progress, begin: float, end: float, name: str = "") -> Progress:
    """Return the progress of a part of the work, which is the fractions ``begin`` to ``end`` of it.

    ``name`` is put before its words.
    """

    def tell(what: str, fraction: float | None = None, /) -> None:
        progress(f"{name}: {what}" if name else what, begin + (end - begin) * (fraction or 0.0))

    return tell
