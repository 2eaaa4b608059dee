"""Owns what a judgement of a recorded scan says: a name, a yes or no, and the numbers behind it.

It also owns the grade of a scan: the one word that the screen, the gallery, lists, pages and scripts have for it.

It is made once, on board, from the numbers of the cloud and what the judges hold against the scan, and kept in the
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
    """One judgement with its numbers; ``passed`` is None where there was nothing to judge."""

    name: str
    """Name like ``ledger``, ``identity``, ``motion``, ``exposure`` …"""
    passed: bool | None
    numbers: Mapping[str, float | None] = field(default_factory=dict, hash=False)
    text: str = ""

    @classmethod
    def failed(cls, name: str, fault: Fault) -> Verdict:
        """Return the verdict that a fault stands for."""
        return cls(name, False, dict(fault.numbers), f"{fault.code.value}: {fault.detail}".rstrip(": "))


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict, and the fault to tell the diver of; ``None``: nothing to tell.

    The alerts' table says what it spoils.
    """

    verdict: Verdict
    fault: Fault | None = None
    proposal: Exposure | None = None
    """Exposure proposed for the next scan; ``None``: as this one."""
    second: Exposure | None = None
    """Exposure that a second sequence of the same scene should have, to show what this one cannot; ``None``: one
    serves."""
    remembered: object | None = None
    """Evidence for whoever compares scans with each other, given beside the verdict and never stored. ``None``:
    nothing."""


def faults_in(judgements: Iterable[Judgement]) -> tuple[Fault, ...]:
    """Return the faults of ``judgements``, in their order."""
    return tuple(one.fault for one in judgements if one.fault is not None)


GRADE_NAME = "grade"
"""Name of the verdict whose text is the grade's value."""
LENGTHS_DOUBTFUL = "lengths_doubtful"
"""Name of that verdict's number that is 1 where lengths were not to be trusted when the scan was taken."""
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
"""Faults that make points of a recorded scan wrong: the diver may keep the scan, but is never told it is good or
usable."""
TOLD_BESIDE_GOOD = frozenset({FaultCode.COMPENSATED})
"""Faults that are told of a scan and ask for nothing.

Anything else that is held against one asks the diver to repeat it, or to change something.
"""
MADE_UP_FOR = frozenset({FaultCode.TOO_BRIGHT, FaultCode.TOO_DARK})
"""Faults of one sequence that a second one with another exposure makes up for."""


class Grade(Enum):
    """The verdict on a scan."""

    GOOD = "good"
    USABLE = "usable"
    BAD = "bad"


def grade(coverage_percent: float | None, noise_mm: float | None, held_against: Collection[FaultCode]) -> Grade:
    """Return the grade of a scan whose cloud covers so much of what is lit, with that median sigma, and has these
    faults.

    No warning stands beside GOOD: whoever is told to repeat a scan is not told that it is good.
    """
    if not SPOILS_POINTS.isdisjoint(held_against) or not is_usable(coverage_percent, noise_mm):
        return Grade.BAD
    enough = _within(coverage_percent, noise_mm, GOOD_COVERAGE_PERCENT, GOOD_NOISE_MM)
    return Grade.GOOD if enough and TOLD_BESIDE_GOOD.issuperset(held_against) else Grade.USABLE


def is_usable(coverage_percent: float | None, noise_mm: float | None) -> bool:
    """Return True if there are enough points, and fine enough, to be worth keeping."""
    return _within(coverage_percent, noise_mm, USABLE_COVERAGE_PERCENT, USABLE_NOISE_MM)


def _within(coverage_percent: float | None, noise_mm: float | None, least: float, most_mm: float) -> bool:
    if coverage_percent is None or noise_mm is None:
        return False
    return coverage_percent >= least and noise_mm <= most_mm


def faults_of_both(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Return the faults of a scan of two exposures, given those held against either sequence and against the pair: but
    for too much or too little light, which the other exposure makes up for."""
    # The first one of a code stands: the order is that in which they were found.
    codes: dict[FaultCode, Fault] = {}
    for fault in faults:
        if fault.code not in MADE_UP_FOR:
            codes.setdefault(fault.code, fault)
    return tuple(codes.values())
