"""Owns ``manifest.json``: the file that makes a folder a scan, and says what every other file in it must be.

JSON with sorted keys; ``sha256`` is that of the compact form of everything else, so that a changed number is noticed.

It also owns what is written down about a scan besides its pixels and points.

Values only; ``appliance.store.manifest`` gives them their form on disk. ``None`` means not known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from appliance.base import ContentError, SealedFile
from appliance.measure import GRADE_NAME as GRADE
from appliance.measure import MADE_UP_FOR, Exposure, FaultCode, Grade, Verdict
from appliance.store.atomic import Stamp
from appliance.store.names import component, is_component

if TYPE_CHECKING:
    from appliance.measure import PatternSequence


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """Pattern that each frame shows."""

    period_px: int
    width_px: int
    height_px: int
    patterns: tuple[str, ...]
    """Names in order of projection: ``bright``, ``gray-x-0``, ``sine-y-270``."""

    @classmethod
    def of(cls, sequence: PatternSequence) -> SequenceInfo:
        """Describe a sequence."""
        names = tuple(pattern.name for pattern in sequence.patterns)
        return cls(sequence.period_px, sequence.width_px, sequence.height_px, names)

    def as_sequence(self) -> PatternSequence:
        """Return the sequence that is described. Raises ValueError where none has these patterns."""
        from appliance.measure import PatternSequence

        return PatternSequence.of_names(self.period_px, self.width_px, self.height_px, self.patterns)


@dataclass(frozen=True, slots=True)
class SecondSequence:
    """A second sequence of the same scene with another exposure, whose points were merged with the first one's."""

    exposure: Exposure
    recorded_ns: int
    """Time of the key press that asked for the sequence, like ``ScanRecord.recorded_ns``."""
    temperatures_c: Mapping[str, float | None] = field(default_factory=dict)
    ledger: Mapping[str, Any] = field(default_factory=dict)
    """Account of the four witnesses, like ``ScanRecord.ledger``."""
    verdicts: tuple[Verdict, ...] = ()
    """Verdicts on this sequence alone. What is said of both together is ``ScanRecord``'s verdict ``pair``."""


@dataclass(frozen=True, slots=True)
class ScanRecord:
    """Everything known about a scan but its files. Complete it with ``dataclasses.replace`` as more is known."""

    sequence: SequenceInfo
    rig_hash: str
    calibration_hash: str | None
    """Hash of the calibration; ``None``: reconstructed with no calibration, or not at all."""
    software_version: str
    wall_time: str | None
    """ISO 8601 with offset; ``None`` where the host has no clock."""
    clock_trusted: bool
    """True if the wall time was set from outside since power-on. Order follows from the scan's id alone."""
    recorded_ns: int
    """Host's monotonic time when the capture began: the key press, as the heartbeat that acted on it saw it."""
    response_hash: str | None = None
    """Hash of the projector's response that the patterns were drawn for; ``None``: codes, not light, were the sine."""
    exposure: Exposure | None = None
    """Exposure of the left camera; the right one's differs as the rig file says. ``None``: as the rig file has it."""
    object: int | None = None
    """Number of the object that the diver said it belongs to; ``None``: of none."""
    water: Mapping[str, float | None] = field(default_factory=dict)
    """Water it was reconstructed in: ``salinity_psu``, ``temperature_c``, ``wavelength_nm``, ``index``."""
    temperatures_c: Mapping[str, float | None] = field(default_factory=dict)
    ledger: Mapping[str, Any] = field(default_factory=dict)
    """Account of the four witnesses; JSON-ready."""
    verdicts: tuple[Verdict, ...] = ()
    second: SecondSequence | None = None
    """Second exposure; ``None``: one sequence, as most scans."""
    cloud: Mapping[str, float | None] = field(default_factory=dict)
    """Numbers of the cloud: points, coverage_percent, …; empty without one."""
    stage_times_s: Mapping[str, float] = field(default_factory=dict)
    """Monotonic, from ``recorded_ns``: ``first_pattern`` is on the scene, ``recording``: the last frame is in memory,
    ``coarse`` and ``full``: that cloud is ready to be shown, ``saved``: raw frames and ledger survive a loss of power.
    ``pair``: the cloud of two exposures is ready; it includes the time the diver took to ask for it. ``coarse_cpu``,
    ``full_cpu``, ``judged_cpu`` and ``overlap_cpu`` are the worker's CPU time for that step alone. What did not happen
    is not there.
    """

    @property
    def grade(self) -> Grade | None:
        """The grade as the diver read it; ``None``: nobody was shown one."""
        kept = self._verdict(GRADE)
        return None if kept is None else next((one for one in Grade if one.value == kept.text), None)

    @property
    def held_against(self) -> tuple[FaultCode, ...]:
        """Faults that were told of the scan, the one that takes most first; of a pair, but for the light that the other
        sequence made up for."""
        pair = self._verdict("pair")
        whole = pair is not None and pair.passed is True
        verdicts = (*self.verdicts, *(self.second.verdicts if whole and self.second is not None else ()))
        names = [
            name.removesuffix("_percent").upper() for one in verdicts if one.name == "causes" for name in one.numbers
        ]
        # A failed verdict's text begins with its fault's name.
        names += [one.text.partition(":")[0] for one in verdicts if one.passed is False]
        codes = [FaultCode(name) for name in dict.fromkeys(names) if name in FaultCode.__members__]
        return tuple(code for code in codes if not (whole and code in MADE_UP_FOR))

    @property
    def compensated(self) -> bool:
        """The scan moved, and that was taken out of its points."""
        done = self._verdict("compensation")
        return done is not None and done.passed is True

    @property
    def gap_mm(self) -> float | None:
        """Median ray gap; ``None`` where it is not known, as of a compensated scan: its rows come from the model, and
        meet whatever is wrong."""
        return None if self.compensated else self.cloud.get("gap_mm")

    def _verdict(self, name: str) -> Verdict | None:
        return next((one for one in self.verdicts if one.name == name), None)


MANIFEST_FILE = "manifest.json"
INCOMPLETE_MANIFEST_FILE = "incomplete.json"
"""The file that stands in its place where a scan broke off (``incomplete``): such a folder is no scan."""


class Stage(Enum):
    """Stages that a scan goes through."""

    RAW = "raw"
    """The frames are durable; nothing else was added."""
    COMPLETE = "complete"
    """Published or rejected by the diver's decision."""


class Decision(Enum):
    """Decisions of the diver about a scan."""

    UNDECIDED = "undecided"
    KEPT = "kept"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class Manifest:
    """The whole manifest. ``files`` maps the name of every file but the manifest to its length and checksum."""

    scan_id: str
    stage: Stage
    decision: Decision
    record: ScanRecord
    files: Mapping[str, Stamp]
    reason: str = ""
    """Reason of the rejection."""
    recovered: bool = False
    """True if the scan was found unpublished at a start and published then."""
    frame_crc32: Mapping[str, tuple[str, ...]] = field(kw_only=True)
    """CRC-32 (hexadecimal) of each frame, by the name of the file of frames, so that it can be said which one is
    damaged."""

    def as_json(self) -> dict[str, Any]:
        """Return the content as JSON holds it. Raises TypeError for a value that it cannot hold."""
        return MANIFEST.content(with_known_times(self))

    @property
    def raw_only(self) -> bool:
        """True if nothing was added to the frames."""
        return self.stage is Stage.RAW


def refuse_names(manifest: Manifest) -> None:
    """Raises ValueError where a manifest names something that no part of a path may be called."""
    # Scans are copied around and come from strangers, too: a name must not lead out of the scan's folder, nor out of
    # one that is named after the scan.
    component(manifest.scan_id, "scan_id")
    for file_name in manifest.files:
        if not is_component(file_name) or file_name == MANIFEST_FILE:
            raise ValueError(f"{file_name!r:.60} is not the name of a file beside it")


MANIFEST = SealedFile(Manifest, schema=1, max_bytes=16 * 1024 * 1024, indent=1, check=refuse_names)
AnyManifest = TypeVar("AnyManifest", bound=Manifest)


def encode(manifest: Manifest) -> bytes:
    """Return the file's bytes. Raises TypeError for a value JSON cannot hold; NaN and infinity become null: not
    known."""
    return MANIFEST.encode(with_known_times(manifest))


def with_known_times(manifest: AnyManifest) -> AnyManifest:
    """Return the manifest without times that are not known: they have no null in the schema."""
    times_s = {name: s for name, s in manifest.record.stage_times_s.items() if math.isfinite(s)}
    return replace(manifest, record=replace(manifest.record, stage_times_s=times_s))


def read(folder: Path) -> Manifest:
    """Return the manifest of a scan's folder. Raises ContentError."""
    path = folder / MANIFEST_FILE
    found = MANIFEST.load(path, name=str(path))
    if found is not None:
        return found
    if (folder / INCOMPLETE_MANIFEST_FILE).exists():
        raise ContentError(
            str(folder),
            "an incomplete recording is no scan, and nothing is measured, evaluated or calibrated with it",
            remedy="`kingfisher cloud incomplete:N` makes an unchecked cloud of it",
        )
    raise ContentError(str(path), "missing")
