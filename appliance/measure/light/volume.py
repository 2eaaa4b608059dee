"""The working volume of a housing: its range of distances, and lengths in proportion to its size.

Distances are counted along the instrument's axis, from the middle between both cameras' projection centres. The rig
file states the range (``[volume]``), and a calibration has it with the cameras (``StereoRig``). Distances and lengths
that depend on the housing are scaled here (``docs/adr/0065-a-housing-states-its-volume.md``).
"""

from __future__ import annotations

from dataclasses import dataclass

STANDARD_MM = 500.0
"""Working distance of the standard housing; ``WorkingVolume.scaled`` scales its lengths to another."""


@dataclass(frozen=True, slots=True)
class WorkingVolume:
    """The range in which a housing measures; by default that of the standard housing.

    Raises ValueError unless the working distance lies within the range.
    """

    nearest_mm: float = 440.0
    working_mm: float = STANDARD_MM
    """Best distance."""
    farthest_mm: float = 560.0

    def __post_init__(self) -> None:
        if not 0.0 < self.nearest_mm < self.working_mm < self.farthest_mm:
            raise ValueError(
                f"measuring volume from {self.nearest_mm:g} to {self.farthest_mm:g} mm, worked at {self.working_mm:g} "
                "mm; allowed is "
                "nearest < working < farthest; correct [volume] in the rig file"
            )

    def scaled(self, standard_mm: float) -> float:
        """Return the length of this housing that corresponds to ``standard_mm`` of the standard one.

        A housing for half the distance is half as large. In the standard housing it is exactly ``standard_mm``.
        """
        return standard_mm * (self.working_mm / STANDARD_MM)


STANDARD = WorkingVolume()
"""The volume of the standard housing: the default of rig files and calibrations."""
