"""A progress that remembers what it was told."""

from __future__ import annotations


class Told:
    def __init__(self) -> None:
        self.all: list[tuple[str, float | None]] = []

    def __call__(self, what: str, fraction: float | None = None, /) -> None:
        self.all.append((what, fraction))

    @property
    def words(self) -> list[str]:
        return [what for what, _ in self.all]
