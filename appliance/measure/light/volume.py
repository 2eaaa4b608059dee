"""Owns the working range of a housing: between which distances it measures, and what else goes with its size.

Distances are counted along the instrument's axis, from the middle between both cameras' projection centres. The rig
file states the range (``[volume]``), a calibration carries it with the cameras (``StereoRig``), and whoever needs a
distance or a length that belongs to the housing asks here (``docs/adr/0065-a-housing-states-its-volume.md``).
"""

from __future__ import annotations

from dataclasses import dataclass

STANDARD_MM = 500.0
"""Working distance of the housing that this software's lengths were found on; ``WorkingVolume.scaled`` takes them to
another."""


@dataclass(frozen=True, slots=True)
class WorkingVolume:
    """The range in which a housing measures; by default that of the standard housing.

    Raises ValueError unless the working distance lies within the range.
    """

    nearest_mm: float = 440.0
    working_mm: float = STANDARD_MM
    """Distance that is aimed for."""
    farthest_mm: float = 560.0

    def __post_init__(self) -> None:
        if not 0.0 < self.nearest_mm < self.working_mm < self.farthest_mm:
            raise ValueError(
                f"measuring volume from {self.nearest_mm:g} to {self.farthest_mm:g} mm, worked at {self.working_mm:g} "
                "mm; allowed is "
                "nearest < working < farthest; correct [volume] in the rig file"
            )

    def scaled(self, standard_mm: float) -> float:
        """Return the length of this housing that is ``standard_mm`` in the standard one: a housing for half the
        distance is half as large.

        In the standard housing it is ``standard_mm`` to the last bit.
        """
        return standard_mm * (self.working_mm / STANDARD_MM)


STANDARD = WorkingVolume()
"""The volume of the standard housing: of rig files and calibrations that say nothing else."""
