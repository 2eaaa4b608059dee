"""The image corrections of both lenses as calibrated in air: mean and covariance."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.correction import node_count

Array = NDArray[np.float64]

AIR_VALUES = 22
ROUNDED = 1e-6
"""Share of each variance that is added to a covariance with rounding errors: a thousandth of a standard deviation."""


def _rounded_root(covariance: Array) -> Array:
    """Return the Cholesky factor (m, m) of a covariance that is not positive definite by rounding errors.

    Raises LinAlgError if rounding does not explain it.
    """
    # In standard deviations, so that pixels and radians have the same rounding error.
    scale = np.sqrt(np.diag(covariance))
    return np.asarray(
        scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale) + ROUNDED * np.eye(len(scale)))
    )


@dataclass(frozen=True, slots=True)
class AirField:
    """The image corrections of both lenses from air, with the rig parameters.

    Mean and covariance of (22 + 4·nodes) values: the first 22 are changes of ``RIG_PARAMETERS.air``, then the nodes of
    the left image across, down, and of the right one.
    """

    EYES: ClassVar = 4
    """Blocks of nodes of a rig: left across, left down, right across, right down."""

    intervals: tuple[int, int]
    mean: tuple[float, ...]
    root: bytes
    """Lower Cholesky factor of the covariance, row by row up to the diagonal, float32 with the low byte first."""

    def __post_init__(self) -> None:
        size = AIR_VALUES + self.EYES * node_count(self.intervals)
        if len(self.mean) != size or len(self.root) != 2 * size * (size + 1):
            raise ValueError(
                f"field from air with {len(self.mean)} values and {len(self.root)} bytes; {self.intervals[0]} × "
                f"{self.intervals[1]} intervals need {size} and {2 * size * (size + 1)}; calibrate in air again"
            )

    @classmethod
    def of(cls, intervals: tuple[int, int], mean: Array, covariance: Array) -> AirField:
        """Return the field with that mean (m,) and covariance (m, m)."""
        try:
            root = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            root = _rounded_root(covariance)
        packed = root[np.tril_indices(len(root))].astype("<f4")
        return cls(intervals, tuple(float(v) for v in mean), packed.tobytes())

    @property
    def covariance(self) -> Array:
        """The covariance (m, m)."""
        root = np.zeros((len(self.mean),) * 2)
        root[np.tril_indices(len(root))] = np.frombuffer(self.root, "<f4")
        return root @ root.T

    @property
    def text(self) -> str:
        """``root`` as it is written to a file."""
        return base64.b64encode(self.root).decode("ascii")

    @classmethod
    def from_text(cls, intervals: tuple[int, int], mean: Sequence[float], text: str) -> AirField:
        """Return the field from its form in a file. Raises ValueError for a wrong length or invalid text."""
        try:
            root = base64.b64decode(text, validate=True)
        except binascii.Error as error:
            raise ValueError(f"not base64 ({error})") from error
        field = cls(intervals, tuple(mean), root)
        if not np.isfinite(np.frombuffer(root, "<f4")).all():
            raise ValueError("a value is not finite")
        return field
