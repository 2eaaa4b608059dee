"""Owns what describes a cloud without its points: its numbers, its ray gaps, and where in a table its points are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:  # carried as they are by whoever decides: no array is looked at to do that
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CloudSummary:
    """Numbers of a cloud that the diver and the manifest are told."""

    points: int
    coverage_percent: float | None
    """Points over left pixels with projector light; ``None`` when nothing was lit."""
    distance_mm: float | None
    """Median distance of the points from the rig's front along the viewing direction, as depth in the left frame."""
    noise_mm: float | None
    """Median expected sigma."""
    gap_mm: float | None
    """Median ray gap; ``None`` also where points have none."""


@dataclass(frozen=True, slots=True)
class PatchGaps:
    """Mean signed ray gaps of one scan, before any limit of quality. Arrays have one row per patch that was seen."""

    GRID: ClassVar = (8, 6)
    """Patches across and down the left image."""
    COUNT: ClassVar = 48
    DOUBTS: ClassVar = 3
    """Causes for which what backscatter adds may be wrong everywhere at once: its strength, and two directions in which
    the projector may stand elsewhere."""

    patch: NDArray[np.intp]
    """(k,) row·8 + column of the patch in the left image."""
    gap_um: NDArray[np.float64]
    """(k,) robust mean."""
    noise_um: NDArray[np.float64]
    """(k,) its standard error, from the scatter inside the patch."""
    modes: NDArray[np.float64]
    """(k, 4) the patterns of ``GapModes`` there."""
    samples: int
    """Correspondences that were looked at."""
    water_index: float
    """Refractive index of the water in which the rays were traced."""
    veil_um: NDArray[np.float64] | None = None
    """(k,) what backscatter with fringes of its own added to the gap; ``gap_um`` is without it.

    ``None``, as the next two: there is none.
    """
    doubts_um: NDArray[np.float64] | None = None
    """(k, DOUBTS) by how much that may be wrong, one standard deviation of each cause, all patches together."""
    shape_um: NDArray[np.float64] | None = None
    """(k,) standard deviation of what is left of it, smooth over the image."""
    turns_um: NDArray[np.float64] | None = None
    """(3, 4) amplitudes per degree that the right camera is turned by, about x, y, z; ``None``: nobody asked."""
    sample_px: NDArray[np.float32] | None = None
    """(m, 6) some true matches: left pixel, right pixel, pattern coordinates; ``None``: nobody asked."""
    pattern_size_px: tuple[int, int] | None = None
    """Width and height of the pattern, where there is a sample."""

    @staticmethod
    def patch_of(left_px: NDArray[np.float64], size_px: tuple[int, int]) -> NDArray[np.intp]:
        """Return the patches (n,) that pixels (n, 2) of a left image of ``size_px`` lie in."""
        across, down = PatchGaps.GRID
        column = (left_px[:, 0] / size_px[0] * across).clip(0, across - 1).astype("intp")
        row = (left_px[:, 1] / size_px[1] * down).clip(0, down - 1).astype("intp")
        patch: NDArray[np.intp] = row * across + column
        return patch


@dataclass(frozen=True, slots=True)
class Found:
    """A found cloud: where in the table its points are, and what describes it."""

    pieces: tuple[tuple[int, int], ...]
    """(first, stop) of each thread's share; what lies between them means nothing."""
    summary: CloudSummary
    gaps: PatchGaps | None = None
    """Signed gaps before any limit, as ``Cloud.gaps``; of the full cloud only."""
