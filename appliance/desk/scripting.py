"""Scans of a dive for scripts at the desk: their frames, and points that are made of them.

``import kingfisher`` exports it. Results are of the classes that the program itself uses, arrays are NumPy's with units
in their names, and errors are those of the command line: one sentence with the fault and the remedy.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Literal, assert_never

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress, refuse_wrong_types, silent
from appliance.desk.export.content import CAMERA_FRAME, OBJECT_FRAME, Metadata
from appliance.desk.export.files import write_mesh, write_scan, write_surface
from appliance.desk.organised import OrganisedScan, organised_scan
from appliance.desk.surface.fusion import FusedCloud
from appliance.desk.surface.mesh import Mesh
from appliance.measure import (
    Calibration,
    CalibrationError,
    Exposure,
    Grade,
    OrganisedCloud,
    Verdict,
    Water,
    encode_calibration,
)
from appliance.store import (
    ChosenCalibration,
    Library,
    LocalFileSystem,
    Manifest,
    ScanEntry,
    ScanError,
    ScanOptions,
    SourceScan,
    StoredScan,
    load_rig,
    standing_root,
)


@dataclass(frozen=True, slots=True)
class ScanOfDive:
    """One stored scan, which is read on demand."""

    folder: Path
    wish: ScanOptions = field(default_factory=ScanOptions)

    @property
    def name(self) -> str:
        """Number of the scan, by its folder."""
        return self.folder.name

    @property
    def manifest(self) -> Manifest:
        """The scan's manifest with its record and results, read from the disk on each access.

        Raises ScanError.
        """
        return StoredScan.manifest_of(self.folder)

    @property
    def time(self) -> datetime | None:
        """Time of the capture by the instrument's clock (``manifest.record.clock_trusted``).

        ``None``: it had none. Raises ScanError.
        """
        wall_time = self.manifest.record.wall_time
        return None if wall_time is None else datetime.fromisoformat(wall_time)

    @property
    def object(self) -> int | None:
        """Number of the object to which it belongs by the diver's choice; ``None``: to none. Raises ScanError."""
        return self.manifest.record.object

    @property
    def exposure(self) -> Exposure | None:
        """Exposure of the left camera; ``None``: as the rig file has it. Raises ScanError."""
        return self.manifest.record.exposure

    @property
    def grade(self) -> Grade | None:
        """Grade of the scan, as on screens, lists and pages; ``None``: it has no cloud. Raises ScanError."""
        return self.manifest.record.grade

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts of all judges, as in the manifest. Raises ScanError."""
        return self.manifest.record.verdicts

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that the diver read, in words, with the judge's name in front; mostly none.

        Raises ScanError.
        """
        failed = [verdict for verdict in self.verdicts if verdict.passed is False]
        return tuple(f"{verdict.name}: {verdict.text}" if verdict.text else verdict.name for verdict in failed)

    @property
    def calibration(self) -> Calibration:
        """The default calibration of its points. Raises CalibrationError, ScanError."""
        return SourceScan.open(self.folder, self.wish).calibration_for(self.wish).calibration

    @refuse_wrong_types
    def frames(self, side: Literal["left", "right"] = "left", *, second: bool = False) -> NDArray[np.uint8]:
        """Return the raw frames of one camera, (n, h, w) uint8, packed or not.

        ``manifest.record.sequence.patterns`` names them. Every byte is compared with its checksum first. ``second``:
        of the second exposure. Raises ScanError, MissingLibraryError.
        """
        StoredScan.refuse_damage(self.folder)
        scan = StoredScan.load(self.folder, only_raw=True)
        frames = scan.second if second else scan.frames
        if frames is None:
            raise ScanError(f"{self.folder}: has one exposure; take second=False")
        return frames[side]

    @refuse_wrong_types
    def points(
        self,
        calibration: Calibration | Path | str | None = None,
        water: Water | None = None,
        progress: Progress = silent,
    ) -> OrganisedScan:
        """Make the scan's points from its raw frames, after comparing every byte with its checksum.

        ``calibration``: one in place of the scan's own, or the path of its file; ``water``: one in place of the recorded water.
        Points are in the left camera frame. Raises ScanError, also if no points are left, and CalibrationError.
        """
        options = self.wish
        if isinstance(calibration, Path | str):
            options = replace(options, calibration=Path(calibration), current=False)
        source = SourceScan.open(self.folder, options, whole=True)
        if isinstance(calibration, Calibration):
            chosen = ChosenCalibration(calibration, "the given one")
            source.refuse_misfit(calibration, chosen.whose, foreign=options.foreign)
        else:
            chosen = source.calibration_for(options)
        if water is not None:
            conditions = {
                "temperature_c": water.temperature_c,
                "salinity_psu": water.salinity_psu,
                "wavelength_nm": water.wavelength_nm,
            }
            manifest = source.scan.manifest
            changed = replace(manifest, record=replace(manifest.record, water=conditions))
            source = replace(source, scan=replace(source.scan, manifest=changed))
        return organised_scan(source, chosen, progress)

    def __repr__(self) -> str:
        """Return one line; it never raises an error, also for a damaged folder."""
        try:
            record = self.manifest.record
        except ScanError as error:
            return f"<scan {self.name}: {error}>"
        points, noise_mm = record.cloud.get("points"), record.cloud.get("noise_mm")
        parts = ["no points" if points is None else f"{points:,.0f} points"]
        if noise_mm is not None:
            parts.append(f"{1000.0 * noise_mm:.0f} µm")
        if record.grade is not None:
            parts.append(record.grade.value)
        return f"<scan {self.name}: {', '.join(parts)}>"


@dataclass(frozen=True, slots=True)
class Dive:
    """The scans under one storage root, in the order of their numbers."""

    root: Path
    wish: ScanOptions = field(default_factory=ScanOptions)

    def scans(self) -> list[ScanOfDive]:
        """Return all kept scans, also damaged ones; ``entries`` names their faults."""
        return [ScanOfDive(entry.folder, self.wish) for entry in self.entries()]

    def entries(self) -> list[ScanEntry]:
        """Return the list that ``kingfisher scans list`` prints."""
        return Library(self.root).entries()

    @refuse_wrong_types
    def scan(self, number: int | str) -> ScanOfDive:
        """Return a scan by its number from any folder under the root; ``dive[7]`` is the same.

        Raises UnknownScan.
        """
        return ScanOfDive(Library(self.root).entry(str(number)).folder, self.wish)

    __getitem__ = scan

    def __iter__(self) -> Iterator[ScanOfDive]:
        return iter(self.scans())

    def __len__(self) -> int:
        return len(self.entries())

    def __repr__(self) -> str:
        return f"<dive {self.root}: {len(self)} scans>"


def open_dive(
    root: Path | str | None = None,
    rig: Path | str | None = None,
    *,
    current_calibration: bool = False,
    foreign_calibration: bool = False,
) -> Dive:
    """Return the dive under a storage root, the folder that holds ``scans/``.

    ``None``: the root around the working directory, else that of the environment variable ``KINGFISHER_ROOT``. ``rig``: a
    rig file in place of each scan's own. ``current_calibration``: the one in use under the root instead of each scan's own;
    ``foreign_calibration``: also one of another instrument. Raises NotADirectoryError, ConfigError.
    """
    place, vain = standing_root(os.environ) if root is None else (Path(root), "")
    if place is None:
        raise NotADirectoryError(f"no storage root: {vain}; give open_dive(root)")
    if not place.is_dir():
        raise NotADirectoryError(f"{place}: no such folder; give the storage root that holds scans/")
    return Dive(place, _wish(rig, place, current=current_calibration, foreign=foreign_calibration))


def open_scan(folder: Path | str, rig: Path | str | None = None, *, foreign_calibration: bool = False) -> ScanOfDive:
    """Return one scan by its folder, also by that of a copy.

    Raises ScanError for a folder without a scan, ConfigError.
    """
    scan = ScanOfDive(Path(folder), _wish(rig, None, foreign=foreign_calibration))
    # Read the manifest to report a wrong folder now rather than at the first points.
    StoredScan.manifest_of(scan.folder)
    return scan


def save_calibration(calibration: Calibration, path: Path | str) -> None:
    """Write a calibration, for ``load_calibration``, ``--calibration`` and desks of other instruments.

    It never replaces a file. Raises CalibrationError if there is one of that name, StorageError.
    """
    target = Path(path)
    if target.exists():
        raise CalibrationError(f"{target}: exists already, and a calibration is never replaced; give a new name")
    LocalFileSystem().replace_file(target, encode_calibration(calibration))


def export(
    what: OrganisedScan | OrganisedCloud | FusedCloud | Mesh,
    path: Path | str,
    title: str = "",
    notes: tuple[str, ...] = (),
    frame: str | None = None,
) -> None:
    """Write points or a mesh for other programs in the format of the suffix, as ``kingfisher cloud`` does.

    ``frame``: the frame of reference in words; by default the object's of a fused surface, else the left camera's.
    Raises ExportError for a suffix that is not allowed, MissingLibraryError, StorageError.
    """
    target = Path(path)
    metadata = Metadata(
        title or target.stem, frame or (OBJECT_FRAME if isinstance(what, FusedCloud) else CAMERA_FRAME), notes
    )
    match what:
        case Mesh():
            write_mesh(target, what, metadata)
        case FusedCloud():
            write_surface(target, what, metadata)
        case OrganisedScan():
            write_scan(target, what.cloud, metadata)
        case OrganisedCloud():
            write_scan(target, what, metadata)
        case unknown:
            assert_never(unknown)


def _wish(rig: Path | str | None, root: Path | None, *, current: bool = False, foreign: bool = False) -> ScanOptions:
    return ScanOptions(rig=None if rig is None else load_rig(Path(rig)), root=root, current=current, foreign=foreign)
