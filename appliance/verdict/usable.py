"""Owns from which coverage and noise on a cloud counts as good, and as usable at all."""

from __future__ import annotations

GOOD_COVERAGE_PERCENT, GOOD_NOISE_MM = 60.0, 0.06
USABLE_COVERAGE_PERCENT, USABLE_NOISE_MM = 25.0, 0.25


def is_good(coverage_percent: float | None, noise_mm: float | None) -> bool:
    """Whether points are many and fine; ``None`` is neither."""
    return _within(coverage_percent, noise_mm, GOOD_COVERAGE_PERCENT, GOOD_NOISE_MM)


def is_usable(coverage_percent: float | None, noise_mm: float | None) -> bool:
    """Whether there are enough points, and fine enough, to be worth keeping."""
    return _within(coverage_percent, noise_mm, USABLE_COVERAGE_PERCENT, USABLE_NOISE_MM)


def _within(coverage_percent: float | None, noise_mm: float | None, least: float, most_mm: float) -> bool:
    if coverage_percent is None or noise_mm is None:
        return False
    return coverage_percent >= least and noise_mm <= most_mm
