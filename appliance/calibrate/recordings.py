"""Observations that the solvers take: correspondences on one artefact of certified dimensions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.measure import Water

Array = NDArray[np.float64]
Labels = NDArray[np.intp]

MIN_POINTS = 30


class ArtefactKind(Enum):
    """Kind of the recorded artefact."""

    BALL_BAR = "ball bar"
    """Two spheres at a calibrated distance."""
    PLANE = "plane"
    """One flat face."""


class RecordingError(Exception):
    """Error of recordings that cannot be used for a calibration.

    The text says which, why and what to do.
    """

    def __init__(self, text: str, subject: str = "") -> None:
        """Keep ``subject``: the step of the calibration, or the recording, as the screen names it."""
        super().__init__(text)
        self.about = subject


class CertificateMissing(RecordingError):
    """Error of an artefact without a certificate, or of a certificate without one of its numbers."""


class CamerasDiffer(RecordingError):
    """The recordings are not of the cameras that the calibration starts from, or not all of the same."""


class NotConverged(RecordingError):
    """Error of recordings each of which can be used, but which no calibration fits together."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Correspondences of one scan of one artefact, and the certified dimensions of the artefact.

    Raises RecordingError for shapes that do not fit, numbers that are not finite or a missing length.
    """

    name: str
    kind: ArtefactKind
    left_px: Array
    """(n, 2); exact, as the correspondence is searched for at these pixels."""
    right_px: Array
    """(n, 2), subpixel, with the noise of the correspondence."""
    water: Water
    sphere: Labels
    """(n,): number of the bar's sphere, 0 or 1, on which each point lies; all 0 for a plane."""
    length_mm: float | None = None
    """Distance of the sphere centres by the certificate; ``None`` for a plane."""
    length_sd_mm: float = 0.003
    radius_mm: float | None = None
    """Radius of both spheres by the certificate; ``None`` for a plane."""
    radius_sd_mm: float = 0.01

    def __post_init__(self) -> None:
        n = len(self.left_px)
        if self.left_px.shape != (n, 2) or self.right_px.shape != (n, 2) or self.sphere.shape != (n,):
            raise RecordingError(
                f"recording {self.name}: shapes {self.left_px.shape}, {self.right_px.shape}, "
                f"{self.sphere.shape}; allowed are (n, 2), (n, 2), (n,); extract the correspondences again"
            )
        if not (np.isfinite(self.left_px).all() and np.isfinite(self.right_px).all()):
            raise RecordingError(
                f"recording {self.name}: a pixel is not finite; leave out points without a correspondence"
            )
        if self.kind is ArtefactKind.PLANE:
            fewest = n
        else:
            fewest = min(int(np.count_nonzero(self.sphere == k)) for k in (0, 1))
            for what, value in (("length", self.length_mm), ("radius", self.radius_mm)):
                if value is None or not (math.isfinite(value) and value > 0.0):
                    raise RecordingError(
                        f"recording {self.name}: the ball bar's {what} is {value}; give the certificate's value in mm"
                    )
        if fewest < MIN_POINTS:
            raise RecordingError(
                f"recording {self.name}: {fewest} points on a surface; at least {MIN_POINTS} are needed; record again"
            )

    def select(self, keep: NDArray[np.bool_] | Labels) -> Recording:
        """Return the recording with the points that ``keep`` selects."""
        return replace(self, left_px=self.left_px[keep], right_px=self.right_px[keep], sphere=self.sphere[keep])


def thinned(recording: Recording, at_most: int) -> Recording:
    """Return the recording with ``at_most`` points or fewer, evenly spread over their order."""
    n = len(recording.left_px)
    if n <= at_most:
        return recording
    return recording.select(np.linspace(0, n - 1, at_most).astype(np.intp))
