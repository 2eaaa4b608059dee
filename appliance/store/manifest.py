"""``manifest.json``, the file that makes a folder a scan, and the record of a scan in it.

JSON with sorted keys; ``sha256`` is that of the compact form of all other keys, so that a changed number is noticed.
``None`` means not known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from appliance.base import ContentError, SealedFile
from appliance.measure import EXPOSURE_FAULTS, Exposure, FaultCode, Grade, Verdict
from appliance.measure import GRADE_NAME as GRADE
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
    """The second sequence of a bracket, with another exposure; its points were merged with the first's."""

    exposure: Exposure
    recorded_ns: int
    """Time of the key press that asked for the sequence, like ``ScanRecord.recorded_ns``."""
    temperatures_c: Mapping[str, float | None] = field(default_factory=dict)
    ledger: Mapping[str, Any] = field(default_factory=dict)
    """Account of the four witnesses, like ``ScanRecord.ledger``."""
    verdicts: tuple[Verdict, ...] = ()
    """Verdicts on this sequence alone. That on both together is ``ScanRecord``'s verdict ``pair``."""


@dataclass(frozen=True, slots=True)
class ScanRecord:
    """The metadata of a scan: all but its files.

    Complete it with ``dataclasses.replace`` as more is known.
    """

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
    """Host's monotonic time when the capture began: that of the cycle that acted on the key press."""
    response_hash: str | None = None
    """Hash of the projector's response that the patterns were drawn for; ``None``: the codes are a sine,
    not the light.
    """
    exposure: Exposure | None = None
    """Exposure of the left camera; the right one's differs as the rig file says. ``None``: as the rig file has it."""
    object: int | None = None
    """Number of the object to which the diver assigned the scan; ``None``: to none."""
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
    ``coarse`` and ``full``: that cloud is ready to be shown, ``saved``: raw frames and ledger are durable. ``pair``:
    the cloud of two exposures is ready; it includes the time the diver took to request it. ``coarse_cpu``,
    ``full_cpu``, ``judged_cpu`` and ``overlap_cpu`` are the worker's CPU time for that step alone. Steps that did
    not happen have no time.
    """

    @property
    def grade(self) -> Grade | None:
        """The grade as the diver read it; ``None``: no grade was shown."""
        verdict = self._verdict(GRADE)
        return (
            None
            if verdict is None
            else next((candidate for candidate in Grade if candidate.value == verdict.text), None)
        )

    @property
    def held_against(self) -> tuple[FaultCode, ...]:
        """Faults that were shown for the scan, the most severe cause first.

        Of a bracket, without those of light that the other sequence made up for.
        """
        pair = self._verdict("pair")
        is_merged = pair is not None and pair.passed is True
        verdicts = (*self.verdicts, *(self.second.verdicts if is_merged and self.second is not None else ()))
        names = [
            name.removesuffix("_percent").upper()
            for verdict in verdicts
            if verdict.name == "causes"
            for name in verdict.numbers
        ]
        # A failed verdict's text begins with its fault's name.
        names += [verdict.text.partition(":")[0] for verdict in verdicts if verdict.passed is False]
        codes = [FaultCode(name) for name in dict.fromkeys(names) if name in FaultCode.__members__]
        return tuple(code for code in codes if not (is_merged and code in EXPOSURE_FAULTS))

    @property
    def compensated(self) -> bool:
        """True if the scan moved and the motion was compensated."""
        done = self._verdict("compensation")
        return done is not None and done.passed is True

    @property
    def gap_mm(self) -> float | None:
        """Median ray gap; ``None`` where it is unknown.

        It counts as unknown for a compensated scan, too: its rows come from the model, so that its rays always meet.
        """
        return None if self.compensated else self.cloud.get("gap_mm")

    def _verdict(self, name: str) -> Verdict | None:
        return next((verdict for verdict in self.verdicts if verdict.name == name), None)


MANIFEST_FILE = "manifest.json"
INCOMPLETE_MANIFEST_FILE = "incomplete.json"
"""The file that stands in its place where a scan broke off (``incomplete``): such a folder is no scan."""


class Stage(Enum):
    """Stages that a scan goes through."""

    RAW = "raw"
    """The frames are durable; cloud and preview are not added yet."""
    COMPLETE = "complete"
    """Published or rejected by the diver's decision."""


class Decision(Enum):
    """Decisions of the diver about a scan."""

    UNDECIDED = "undecided"
    KEPT = "kept"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class Manifest:
    """The whole manifest.

    ``files`` maps the name of every file but the manifest to its length and checksum.
    """

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
    """CRC-32 (hexadecimal) of each frame, by the name of the file of frames, to find the damaged ones."""

    def as_json(self) -> dict[str, Any]:
        """Return the content as JSON holds it. Raises TypeError for a value that it cannot hold."""
        return MANIFEST.content(with_known_times(self))

    @property
    def raw_only(self) -> bool:
        """True if the scan has only its raw frames."""
        return self.stage is Stage.RAW


def refuse_names(manifest: Manifest) -> None:
    """Raise ValueError for a manifest with a name that cannot be a component of a path."""
    # Scans are copied around and come from strangers, too: a name must not lead out of the scan's folder, nor out of
    # a folder that is named after the scan.
    component(manifest.scan_id, "scan_id")
    for file_name in manifest.files:
        if not is_component(file_name) or file_name == MANIFEST_FILE:
            raise ValueError(f"{file_name!r:.60} is not the name of a file beside it")


MANIFEST = SealedFile(Manifest, schema=1, max_bytes=16 * 1024 * 1024, indent=1, check=refuse_names)
AnyManifest = TypeVar("AnyManifest", bound=Manifest)


def encode(manifest: Manifest) -> bytes:
    """Return the file's bytes, with null for NaN and infinity.

    Raises TypeError for a value that JSON cannot hold.
    """
    return MANIFEST.encode(with_known_times(manifest))


def with_known_times(manifest: AnyManifest) -> AnyManifest:
    """Return the manifest without unknown times, since the schema has no null for them."""
    times_s = {name: s for name, s in manifest.record.stage_times_s.items() if math.isfinite(s)}
    return replace(manifest, record=replace(manifest.record, stage_times_s=times_s))


def read(folder: Path) -> Manifest:
    """Return the manifest of a scan's folder. Raises ContentError."""
    path = folder / MANIFEST_FILE
    manifest = MANIFEST.load(path, name=str(path))
    if manifest is not None:
        return manifest
    if (folder / INCOMPLETE_MANIFEST_FILE).exists():
        raise ContentError(
            str(folder),
            "an incomplete scan cannot be used for measuring, evaluating or calibrating",
            remedy="`kingfisher cloud incomplete:N` makes an unchecked cloud of it",
        )
    raise ContentError(str(path), "missing")
