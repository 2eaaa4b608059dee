"""Objects for scripts at the desk: poses, placed points, surface, errors and lengths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from appliance.base import Progress, refuse_wrong_types, silent
from appliance.desk import object_store as objects
from appliance.desk.comparing import Comparison, NominalSurface, compare
from appliance.desk.object_errors import errors_of, length_between
from appliance.desk.object_store import ObjectError, StoredObject
from appliance.desk.objects import placed_scans, surface_of
from appliance.desk.registration.joint import JointErrors, LengthSigma
from appliance.desk.scripting import open_dive
from appliance.desk.surface.deviation import LIMIT_MM
from appliance.desk.surface.fusion import SPACING_MM, FusedCloud, PlacedScan
from appliance.measure import Rigid
from appliance.store import ScanOptions


@dataclass(frozen=True, slots=True)
class ObjectOfDive:
    """One object under a storage root, whose file is read on each access.

    All values are in the object's frame, mm.
    """

    root: Path
    name: str
    wish: ScanOptions

    @property
    def stored(self) -> StoredObject:
        """The record: scans, places, pairs, warnings. Raises ObjectError."""
        return objects.read_object(self.root, self.name)

    @property
    def errors(self) -> JointErrors:
        """Joint errors of all scan poses. Raises ObjectError where it is not solved."""
        return errors_of(self.stored)

    @refuse_wrong_types
    def placed_scans(self, progress: Progress = silent) -> Iterator[PlacedScan]:
        """Yield the scans that have a pose, one at a time. Raises ObjectError, ScanError, CalibrationError."""
        return placed_scans(self.root, self.stored, self.wish, progress)

    @refuse_wrong_types
    def surface(self, spacing_mm: float = SPACING_MM, progress: Progress = silent) -> FusedCloud:
        """Return one surface of all placed scans, a point about every ``spacing_mm``.

        Raises ObjectError, ScanError, CalibrationError.
        """
        return surface_of(self.root, self.stored, self.wish, progress, spacing_mm)

    @refuse_wrong_types
    def length(
        self, first: str, at_first_mm: Sequence[float], second: str, at_second_mm: Sequence[float]
    ) -> LengthSigma:
        """Return the distance between points of scans ``first`` and ``second``, with its standard deviation.

        Raises ObjectError.
        """
        return length_between(self.stored, first, at_first_mm, second, at_second_mm)

    @refuse_wrong_types
    def compare(
        self,
        nominal: NominalSurface,
        spacing_mm: float = SPACING_MM,
        limit_mm: float = LIMIT_MM,
        start: Rigid | None = None,
    ) -> Comparison:
        """Register its surface to ``nominal`` and return the deviations, with all errors in their sigma.

        Raises SurfaceMatchError, and the errors of ``surface``.
        """
        return compare(self.surface(spacing_mm), nominal, limit_mm, start, self.errors)

    def __repr__(self) -> str:
        """Return one line; it never raises an error, also for a damaged file."""
        try:
            stored = self.stored
        except ObjectError as error:
            return f"<object {self.name}: {error}>"
        placed = "not solved" if stored.places is None else f"{len(stored.places.places)} placed"
        return f"<object {self.name}: {len(stored.scans)} scans, {placed}>"


def open_object(
    root: Path | str,
    name: str,
    rig: Path | str | None = None,
    calibration: Path | str | None = None,
    *,
    current_calibration: bool = False,
    foreign_calibration: bool = False,
) -> ObjectOfDive:
    """Return the object of that name under a storage root.

    The options are those of ``open_dive``; ``calibration``: a file in place of each scan's own calibration, as
    ``--calibration``. Raises ObjectError, NotADirectoryError, ConfigError.
    """
    dive = open_dive(root, rig, current_calibration=current_calibration, foreign_calibration=foreign_calibration)
    options = dive.wish if calibration is None else replace(dive.wish, calibration=Path(calibration), current=False)
    opened = ObjectOfDive(dive.root, name, options)
    # Read the file to report a wrong name now rather than at the first points.
    objects.read_object(opened.root, name)
    return opened
