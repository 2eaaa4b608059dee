"""The verdict of a judge, and the grade of a scan.

A verdict has a name, passed or failed, and numbers. The grade is one word for the screen, the gallery, lists, pages and
scripts. It is computed once, on the instrument, from the numbers of the cloud and the faults, and stored in the
manifest as the verdict ``NAME``. See ``docs/causes.md``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure


@dataclass(frozen=True, slots=True)
class Verdict:
    """A verdict with its numbers; ``passed`` is None if it was not judged."""

    name: str
    """Name like ``ledger``, ``identity``, ``motion``, ``exposure`` …"""
    passed: bool | None
    numbers: Mapping[str, float | None] = field(default_factory=dict, hash=False)
    text: str = ""

    @classmethod
    def failed(cls, name: str, fault: Fault) -> Verdict:
        """Return the verdict of a fault."""
        return cls(name, False, dict(fault.numbers), f"{fault.code.value}: {fault.detail}".rstrip(": "))


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict, and the fault to report to the diver; ``None``: no fault.

    The table of alerts says which results the fault spoils.
    """

    verdict: Verdict
    fault: Fault | None = None
    proposal: Exposure | None = None
    """Exposure proposed for the next scan; ``None``: the same."""
    second: Exposure | None = None
    """Exposure of a second sequence of the same scene, for surfaces that this one does not show; ``None``: not needed.
    """
    remembered: object | None = None
    """Evidence for the comparison of scans with each other; never stored. ``None``: no evidence."""


def faults_in(judgements: Iterable[Judgement]) -> tuple[Fault, ...]:
    """Return the faults of ``judgements``, in their order."""
    return tuple(judgement.fault for judgement in judgements if judgement.fault is not None)


GRADE_NAME = "grade"
"""Name of the verdict whose text is the grade's value."""
LENGTHS_DOUBTFUL = "lengths_doubtful"
"""Name of that verdict's number that is 1 if lengths were doubtful at the time of the scan."""
GOOD_COVERAGE_PERCENT, GOOD_NOISE_MM = 60.0, 0.06
USABLE_COVERAGE_PERCENT, USABLE_NOISE_MM = 25.0, 0.25
SPOILS_SCAN = frozenset(
    {
        FaultCode.FRAME_MISSING,
        FaultCode.FRAME_REPEATED,
        FaultCode.FRAME_ORDER,
        FaultCode.FRAME_TRUNCATED,
        FaultCode.FRAME_CORRUPT,
        FaultCode.CAMERA_TOO_SLOW,
        FaultCode.CAMERA_SILENT,
        FaultCode.CAMERA_STUCK,
        FaultCode.PATTERN_WRONG,
        FaultCode.PICTURE_MIRRORED,
        FaultCode.SYNC_LOST,
        FaultCode.LATE_FLIP,
        FaultCode.PROJECTOR_TIMING,
        FaultCode.PROJECTOR_DARK,
        FaultCode.PULSE_MISSING,
        FaultCode.CAPTURE_TIMEOUT,
        FaultCode.BOARD_RESET,
        FaultCode.INTERNAL,
    }
)
"""Faults that make a recorded scan worthless: it is not kept."""
SPOILS_POINTS = frozenset(
    {FaultCode.MOVED, FaultCode.LIGHT_FLICKERS, FaultCode.SIDES_EXCHANGED, FaultCode.NOT_IN_WATER}
)
"""Faults that make points of a recorded scan wrong: the diver may keep it, but its grade is never good or usable."""
HARMLESS_FAULTS = frozenset({FaultCode.COMPENSATED})
"""Faults that are reported and need no action.

Every other fault of a scan asks the diver to repeat it, or to change something.
"""
EXPOSURE_FAULTS = frozenset({FaultCode.TOO_BRIGHT, FaultCode.TOO_DARK})
"""Faults of one sequence that a second one with another exposure corrects."""


class Grade(Enum):
    """The verdict on a scan."""

    GOOD = "good"
    USABLE = "usable"
    BAD = "bad"


def grade(coverage_percent: float | None, noise_mm: float | None, fault_codes: Collection[FaultCode]) -> Grade:
    """Return the grade of a scan by its coverage, median sigma and faults.

    A scan with a warning is never GOOD, since the diver is told to repeat it.
    """
    if not SPOILS_POINTS.isdisjoint(fault_codes) or not is_usable(coverage_percent, noise_mm):
        return Grade.BAD
    enough = _within(coverage_percent, noise_mm, GOOD_COVERAGE_PERCENT, GOOD_NOISE_MM)
    return Grade.GOOD if enough and HARMLESS_FAULTS.issuperset(fault_codes) else Grade.USABLE


def is_usable(coverage_percent: float | None, noise_mm: float | None) -> bool:
    """Return True if there are enough points, and fine enough, to be worth keeping."""
    return _within(coverage_percent, noise_mm, USABLE_COVERAGE_PERCENT, USABLE_NOISE_MM)


def _within(coverage_percent: float | None, noise_mm: float | None, least_coverage: float, most_mm: float) -> bool:
    if coverage_percent is None or noise_mm is None:
        return False
    return coverage_percent >= least_coverage and noise_mm <= most_mm


def faults_of_both(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Return the faults of a bracket, given those of either sequence and of both together.

    Those of too much or too little light are left out, since the other exposure corrects them.
    """
    # The first fault of each code is kept, in the order of detection.
    codes: dict[FaultCode, Fault] = {}
    for fault in faults:
        if fault.code not in EXPOSURE_FAULTS:
            codes.setdefault(fault.code, fault)
    return tuple(codes.values())
