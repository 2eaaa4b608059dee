"""The description of a cloud without its points: numbers, ray gaps, and its place in a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:  # importers that only pass these values on need no NumPy
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CloudSummary:
    """Numbers of a cloud for the diver and the manifest."""

    points: int
    coverage_percent: float | None
    """Points over illuminated left pixels; ``None``: none were illuminated."""
    distance_mm: float | None
    """Median distance of the points from the rig's front along the viewing direction, as depth in the left frame."""
    noise_mm: float | None
    """Median sigma."""
    gap_mm: float | None
    """Median ray gap; ``None`` also if points have no gap."""


@dataclass(frozen=True, slots=True)
class PatchGaps:
    """Mean signed ray gaps of one scan, before any quality limit. Arrays have one row per occupied patch."""

    GRID: ClassVar = (8, 6)
    """Patches across and down the left image."""
    COUNT: ClassVar = 48
    DOUBTS: ClassVar = 3
    """Number of common error sources of the gaps by backscatter: its strength and two directions of the projector's
    position."""

    patch: NDArray[np.intp]
    """(k,) row·8 + column of the patch in the left image."""
    gap_um: NDArray[np.float64]
    """(k,) robust mean."""
    noise_um: NDArray[np.float64]
    """(k,) standard error of the mean, from the scatter inside the patch."""
    modes: NDArray[np.float64]
    """(k, 4) the patterns of ``GapModes`` at the patches."""
    samples: int
    """Number of correspondences."""
    water_index: float
    """Refractive index of the water in which the rays were traced."""
    veil_um: NDArray[np.float64] | None = None
    """(k,) part of the gap by backscatter fringes; ``gap_um`` is without it.

    ``None``, as the next two: there are no backscatter fringes.
    """
    doubts_um: NDArray[np.float64] | None = None
    """(k, DOUBTS) its errors by one standard deviation of each source; each is common to all patches."""
    shape_um: NDArray[np.float64] | None = None
    """(k,) standard deviation of its remaining error, smooth over the image."""
    turns_um: NDArray[np.float64] | None = None
    """(3, 4) amplitudes per degree of rotation of the right camera about x, y, z; ``None``: not computed."""
    sample_px: NDArray[np.float32] | None = None
    """(m, 6) some true matches: left pixel, right pixel, pattern coordinates; ``None``: not sampled."""
    pattern_size_px: tuple[int, int] | None = None
    """Width and height of the pattern, if there is a sample."""

    @staticmethod
    def patch_of(left_px: NDArray[np.float64], size_px: tuple[int, int]) -> NDArray[np.intp]:
        """Return the patches (n,) of pixels (n, 2) of a left image of ``size_px``."""
        across, down = PatchGaps.GRID
        column = (left_px[:, 0] / size_px[0] * across).clip(0, across - 1).astype("intp")
        row = (left_px[:, 1] / size_px[1] * down).clip(0, down - 1).astype("intp")
        patch: NDArray[np.intp] = row * across + column
        return patch


@dataclass(frozen=True, slots=True)
class CloudLocation:
    """A cloud in a table: the place of its points, and its description."""

    pieces: tuple[tuple[int, int], ...]
    """(first, stop) of each thread's share; the elements between them have no meaning."""
    summary: CloudSummary
    gaps: PatchGaps | None = None
    """Signed gaps before any limit, as ``Cloud.gaps``; only in a full cloud."""
