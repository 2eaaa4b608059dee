"""Owns what is known of the scan in hand, from its first frame to its folder: values only; ``ScanController``, ``WorkerReports`` and ``ScanFiles`` change them."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, field, replace

from appliance.measure import Cloud, Exposure, Verdict
from appliance.store import PendingScan, ScanOrigin, ScanRecord, SecondSequence


@dataclass(slots=True)
class SecondInMemory:
    """A second sequence of the scan in work, from its first frame until the points of both are one cloud."""

    number: int
    begun_ns: int
    exposure: Exposure
    record: SecondSequence | None = None
    merged: bool = False
    stored: bool = False
    """The second sequence's frames are durable."""


@dataclass(slots=True)
class ScanInMemory:
    """One scan from its first frame to its folder."""

    number: int
    begun_ns: int
    exposure: Exposure
    origin: ScanOrigin
    """The calibration and the rig it is recorded with."""
    belongs_to: int | None = None
    """Number of its object."""
    record: ScanRecord | None = None
    coarse: Cloud | None = None
    full: Cloud | None = None
    pending: PendingScan | None = None
    raw: Future[PendingScan] | None = None
    second: SecondInMemory | None = None
    times_s: dict[str, float] = field(default_factory=dict)
    """Times since the key press and processor times by stage, as ``ScanRecord.stage_times_s``."""

    def enter(self, verdict: Verdict) -> None:
        """Write a verdict down, in place of an earlier one of its name."""
        if self.record is not None:
            # A new record each time: the disk's thread may be writing the one of before.
            others = tuple(one for one in self.record.verdicts if one.name != verdict.name)
            self.record = replace(self.record, verdicts=(*others, verdict))

    @property
    def whole(self) -> ScanRecord:
        """The record as it is to be written down: with the second sequence, once the scan is of both."""
        if self.record is None:
            raise ValueError("nothing was recorded")
        second = self.second
        return self.record if second is None or not second.merged else replace(self.record, second=second.record)

    def since_begun_s(self, time_ns: int) -> float:
        """Return seconds from the key press to a moment of the same clock."""
        return (time_ns - self.begun_ns) / 1e9

    @property
    def cloud(self) -> Cloud | None:
        """The best cloud there is."""
        return self.full or self.coarse
