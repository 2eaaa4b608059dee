"""Order of the alerts on a screen, and the one that leads: in full, with its remedy.

    alerts, leader, in_full, …    the alerts of a machine in their order, and the one that leads
    guidance_text                 text and arrow while the diver looks for the next view of an object
    overlap_text                  text about the overlap of the latest scan with the one before

The most severe alert leads. Equally severe ones are in the order of remedies: those that keep the instrument dark, that
forbid a scan, that made the scan worthless or wrong. Then come the place from the outside in: distance, ambient light,
motion, water; and exposure last, since each of them changes the right value of those after it. The others follow,
small.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType
from typing import assert_never

from appliance.instrument.machine.alerts import RULES, Alert, Severity, alert_of, is_acknowledged, lasting, notice_of
from appliance.instrument.machine.states import Machine, State
from appliance.instrument.machine.words import Label, Text, worded
from appliance.instrument.ranging.reach import Reach
from appliance.measure import SPOILS_POINTS, SPOILS_SCAN, FaultCode, Move


@dataclass(frozen=True, slots=True)
class OverlapText:
    """Text about an overlap, and whether it is a warning."""

    label: Label
    warns: bool = False


def overlap_text(machine: Machine) -> OverlapText | None:
    """Return the text about the latest scan's overlap; ``None``: none.

    Without an object, scans may be unrelated: then an overlap is shown, but not the lack of one.
    """
    overlap, runs = machine.overlap, machine.choices.object is not None
    if overlap is None:
        return None
    if overlap.share is None:
        return OverlapText(Text.OVERLAP_UNSURE) if runs else None
    if overlap.none:
        return OverlapText((Text.NO_OVERLAP, Text.GO_BACK), warns=True) if runs else None
    return OverlapText((Text.OVERLAP, f"{100.0 * overlap.share:.0f} %"), warns=overlap.scant)


STALE_NS = 1_500_000_000
"""Age after which guidance is outdated, since the hands have moved on."""
STEP_PERCENT = 5
"""Step to which percentages are rounded, about their uncertainty."""


@dataclass(frozen=True, slots=True)
class GuidanceText:
    """Guidance to the next view, as text and arrow."""

    overlap: Label | None
    """Overlap that a scan from here would have; ``None``: not known."""
    instruction: Text | None
    """Instruction for the diver; ``None``: the distance leads."""
    move: Move | None = None
    toward: tuple[float, float] | None = None
    """Direction in the left image, right and down, of length 1; ``None``: no arrow."""

    @property
    def english(self) -> str:
        """Overlap and instruction in one line of English, for the status file."""
        return ": ".join(worded(label) for label in (self.overlap, self.instruction) if label is not None)


def guides(machine: Machine) -> bool:
    """Return True if the latest guidance holds: the diver aims at an object, and it is not too old."""
    fresh = machine.now_ns - machine.guided_ns <= STALE_NS
    return machine.state is State.AIM and machine.choices.object is not None and fresh


def guidance_text(machine: Machine) -> GuidanceText | None:
    """Return the guidance for the place that the diver aims at; ``None``: none."""
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
    # Without overlap with the kept scan there is no percentage, only the direction back.
    has_overlap = share is not None and not guidance.expected.none
    overlap = (
        (Text.OVERLAP, f"{STEP_PERCENT * round(100.0 * (share or 0.0) / STEP_PERCENT)} %") if has_overlap else None
    )
    if machine.reach in (Reach.CLOSER, Reach.BACK):
        # The distance leads: no other instruction is given until it is right.
        return None if overlap is None else GuidanceText(overlap, None)
    return GuidanceText(overlap, word, guidance.move, guidance.toward)


_IN_SELF_TEST = frozenset(
    {
        FaultCode.CAMERA_LOST,
        FaultCode.CAMERA_SLOW_LINK,
        FaultCode.CAMERA_REFUSED,
        FaultCode.PROJECTOR_LOST,
        FaultCode.DISPLAY_LOST,
        FaultCode.BOARD_LOST,
        FaultCode.KEYS_LOST,
        FaultCode.UNCALIBRATED,
    }
)
"""Faults that have a line of their own in the self-test."""
QUIET: Mapping[State, frozenset[FaultCode]] = MappingProxyType(
    {
        State.BOOT: _IN_SELF_TEST,
        State.SELF_TEST: _IN_SELF_TEST,
        State.CALIBRATE: frozenset({FaultCode.UNCALIBRATED, FaultCode.LENGTH_ERROR}),
        State.COOLING: frozenset({FaultCode.HOT, FaultCode.WARM}),
        State.SAFE: frozenset({FaultCode.LEAK}),
    }
)
"""Faults that a state's screen shows already, or remedies."""


_BY_LIGHT = frozenset({FaultCode.AIM_LIGHT, FaultCode.AIM_TURBID, FaultCode.AIM_DARK})
_REMEDIES = (
    *(FaultCode.LEAK, FaultCode.TOO_HOT, FaultCode.HOT),
    *(
        FaultCode.NOT_IN_WATER,
        FaultCode.TOO_NEAR,
        FaultCode.TOO_FAR,
        FaultCode.SCAN_NEAR,
        FaultCode.SCAN_FAR,
        FaultCode.NOTHING_SEEN,
    ),
    *(FaultCode.AIM_LIGHT, FaultCode.AMBIENT, FaultCode.LIGHT_FLICKERS),
    *(FaultCode.AIM_FAST, FaultCode.MOVED, FaultCode.PART_MISSING),
    *(FaultCode.AIM_TURBID, FaultCode.WATER_DIRTY, FaultCode.WINDOW),
    *(FaultCode.AIM_DARK, FaultCode.TOO_BRIGHT, FaultCode.TOO_DARK, FaultCode.FRINGES_BENT, FaultCode.SCAN_POOR),
)
"""Faults in the order of the diver's remedies: out of the water, then about the place."""


def urgency(code: FaultCode) -> tuple[int, ...]:
    """Return the sort key of alerts: the smallest leads."""
    rule = RULES[code]
    flags = rule.forbids_light, rule.blocks_scan, code in SPOILS_SCAN, code in SPOILS_POINTS
    place = _REMEDIES.index(code) if code in _REMEDIES else len(_REMEDIES)
    # The order of the codes makes it total, so that two faults never change places.
    return (-rule.severity, *(not flag for flag in flags), place, list(FaultCode).index(code))


class Leader(Enum):
    """Part that leads a screen; the other parts are small and without colour."""

    ALERT = "alert"
    """An alert in full, with its remedy in the band."""
    DISTANCE = "distance"
    """The advice beside the gauge: closer, or back."""
    PASSING = "passing"
    """Cause for which a scan would fail now, in the place of READY."""
    OVERLAP = "overlap"
    """The instruction to go back to the scan before."""
    SCREEN = "screen"
    """The screen's own text, as there is no fault."""


def leader(shown: Sequence[Alert], overlap: OverlapText | None = None, reach: Reach = Reach.UNKNOWN) -> Leader:
    """Return the leading part of a screen with these alerts, overlap and distance."""
    full = in_full(shown)
    if full is not None and full.severity > Severity.INFO:
        return Leader.ALERT
    if reach in (Reach.CLOSER, Reach.BACK):
        return Leader.DISTANCE
    if any(alert.passing for alert in shown):
        return Leader.PASSING
    return Leader.OVERLAP if overlap is not None and overlap.warns else Leader.SCREEN


def in_full(shown: Sequence[Alert]) -> Alert | None:
    """Return the alert to show in full: the first of the most severe that are not acknowledged."""
    return max(
        (alert for alert in shown if not alert.is_acknowledged and not alert.passing),
        key=lambda alert: alert.severity,
        default=None,
    )


def passing(shown: Sequence[Alert]) -> Alert | None:
    """Return the alert for the title: the first of those that pass."""
    return next((alert for alert in shown if alert.passing), None)


def on_screen(machine: Machine) -> tuple[Alert, ...]:
    """Return the alerts for the band: those that the screen does not show or remedy itself."""
    quiet = QUIET.get(machine.state, frozenset())
    if machine.state is State.AIM and machine.reach in (Reach.CLOSER, Reach.BACK):
        # The distance comes first, and changes the light: an object that is too near is too bright.
        quiet |= _BY_LIGHT
    return tuple(alert for alert in alerts(machine) if alert.code not in quiet)


def alerts(machine: Machine) -> tuple[Alert, ...]:
    """Return the alerts to show now, without duplicates.

    First the notice, which answers a key; then the lasting ones by ``urgency``.
    """
    lasts = [
        replace(alert_of(fault), lasts=True, is_acknowledged=is_acknowledged(machine, fault))
        for fault in lasting(machine)
    ]
    if machine.scan is not None:
        lasts += [alert_of(fault) for fault in machine.scan.warnings]
        if machine.scan.failed is not None:
            lasts.append(alert_of(machine.scan.failed))
    lasts.sort(key=lambda alert: urgency(alert.code))
    shown: list[Alert] = []
    notice = notice_of(machine)
    if notice is not None:
        shown.append(notice)
    for alert in lasts:
        if not any((s.code, s.headline) == (alert.code, alert.headline) for s in shown):
            shown.append(alert)
    return tuple(shown)
