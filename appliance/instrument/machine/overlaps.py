"""Owns what the diver reads about the overlap of the latest scan with the one before."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.instrument.machine.states import Machine
from appliance.instrument.machine.words import Label, Text


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
