"""Owns what the diver reads, and which way is shown, while the next view of an object is chosen.

It also owns what the diver reads about the overlap of the latest scan with the one before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never

from appliance.instrument.machine.states import Machine, State
from appliance.instrument.machine.words import Label, Text, worded
from appliance.instrument.ranging.reach import Reach
from appliance.measure import Move


@dataclass(frozen=True, slots=True)
class OverlapSaid:
    """Words for the screen, and whether they are a warning."""

    words: Label
    warns: bool = False


def overlap_said(machine: Machine) -> OverlapSaid | None:
    """Return what is said of the latest scan; ``None``: nothing.

    Without an object, scans need not have anything to do with each other: then only an overlap is told, no lack of one.
    """
    overlap, runs = machine.overlap, machine.choices.object is not None
    if overlap is None:
        return None
    if overlap.share is None:
        return OverlapSaid(Text.OVERLAP_UNSURE) if runs else None
    if overlap.none:
        return OverlapSaid((Text.NO_OVERLAP, Text.GO_BACK), warns=True) if runs else None
    return OverlapSaid((Text.OVERLAP, f"{100.0 * overlap.share:.0f} %"), warns=overlap.scant)


STALE_NS = 1_500_000_000
"""Guidance that is older is of another place: hands go on."""
STEP_PERCENT = 5
"""Percentages are told in steps of so many: that is about what they are off by."""


@dataclass(frozen=True, slots=True)
class GuidanceSaid:
    """Words for the screen, and the arrow beside them."""

    overlap: Label | None
    """Overlap that a scan from here would have; ``None``: none is known."""
    words: Text | None
    """Words for the remedy; ``None``: the distance says so."""
    move: Move | None = None
    toward: tuple[float, float] | None = None
    """Direction in the left picture, right and down, of length 1; ``None``: no arrow."""

    @property
    def whole(self) -> str:
        """Both in one line of English, as the status file has it."""
        return ": ".join(worded(label) for label in (self.overlap, self.words) if label is not None)


def guides(machine: Machine) -> bool:
    """Return whether what was seen last still guides: the diver aims at an object by light, and it is not too old."""
    fresh = machine.now_ns - machine.guided_ns <= STALE_NS
    return machine.state is State.AIM and machine.choices.object is not None and fresh


def guidance_said(machine: Machine) -> GuidanceSaid | None:
    """Return what is said of the place that the diver aims at; ``None``: nothing."""
    guidance = machine.guidance
    if guidance is None:
        return None
    match guidance.move:
        case Move.GO_BACK:
            word = Text.TURN_BACK
        case Move.SCAN_NOW:
            word = Text.SCAN_NOW
        case Move.GO_ON:
            word = Text.GO_ON
        case unknown:
            assert_never(unknown)
    share = guidance.expected.share
    # Where nothing of the kept scan is found, the way back is all that is known.
    known = share is not None and not guidance.expected.none
    overlap = (Text.OVERLAP, f"{STEP_PERCENT * round(100.0 * (share or 0.0) / STEP_PERCENT)} %") if known else None
    if machine.reach in (Reach.CLOSER, Reach.BACK):
        # The distance leads: nobody is told to scan, or which way to go, where it says otherwise.
        return None if overlap is None else GuidanceSaid(overlap, None)
    return GuidanceSaid(overlap, word, guidance.move, guidance.toward)
