"""Owns what a worker process is started for, and the bounds of what it may take before it is started again."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.measure import TYPICAL_PAIR, Calibration, StereoNoise, Water


@dataclass(frozen=True, slots=True)
class WorkOrder:
    """Everything a worker must know to reconstruct scans; another order needs another worker."""

    calibration: Calibration
    water: Water
    period_px: int
    projector_width_px: int
    projector_height_px: int
    noise: StereoNoise = TYPICAL_PAIR
    """Noise of the cameras as they are set."""


@dataclass(frozen=True, slots=True)
class WorkLimits:
    """The bounds of what a worker may take; beyond, it is started again."""

    start_s: float = 240.0
    """A cold start without compiled kernels takes most of a minute, and more on a busy machine."""
    cloud_s: float = 10.0
    """Longest time from one step to the next of those that lead from the last frame to the full cloud; a hundred times what they take."""
    computing_s: float = 60.0
    """The same where it is seen to compute: on a processor that is throttled, or shared."""
    alive_s: float = 5.0
    """Longest time from a question to its answer while it has nothing to do."""
    memory_mb: float = 1000.0
    """Largest memory of its own, MB; the shared frames do not count. Compensating a scan of 1600 × 1200 takes 740."""
    start_memory_mb: float = 1500.0
    """The same until it is ready: without compiled kernels, the compiler is in it, too."""
