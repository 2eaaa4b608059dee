"""Owns which messages a screen shows, and which one leads: the one that is read first, in full, with what to do.

    alerts, leader, in_full, …    the messages of a machine in their order, and the one that leads
    guidance_said                 words and arrow while the next view of an object is chosen
    overlap_said                  words about the overlap of the latest scan with the one before

The graver leads. Among equally grave ones the order is that of remedies: what keeps the instrument dark, what forbids a
scan, what made the scan worthless or wrong; then the place from the outside in: how far, whose light, how still, what
water, and the exposure last, for each of them changes what is right for those behind it. All else follows, small.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType
from typing import assert_never

from appliance.instrument.machine.alerts import RULES, Alert, Severity, alert_of, lasting, notice_of, seen
from appliance.instrument.machine.states import Machine, State
from appliance.instrument.machine.words import Label, Text, worded
from appliance.instrument.ranging.reach import Reach
from appliance.measure import SPOILS_POINTS, SPOILS_SCAN, FaultCode, Move


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


_TESTED = frozenset(
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
        State.BOOT: _TESTED,
        State.SELF_TEST: _TESTED,
        State.CALIBRATE: frozenset({FaultCode.UNCALIBRATED, FaultCode.LENGTH_ERROR}),
        State.COOLING: frozenset({FaultCode.HOT, FaultCode.WARM}),
        State.SAFE: frozenset({FaultCode.LEAK}),
    }
)
"""Faults that a state's own screen says already, or is the remedy for."""


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
"""Remedies that a diver has, in the order of doing them: out of the water, then about the place."""


def urgency(code: FaultCode) -> tuple[int, ...]:
    """Return what messages are ordered by: the smallest leads."""
    rule = RULES[code]
    flags = rule.forbids_light, rule.blocks_scan, code in SPOILS_SCAN, code in SPOILS_POINTS
    place = _REMEDIES.index(code) if code in _REMEDIES else len(_REMEDIES)
    # The codes' own order makes it total: the same two faults are never shown in another order.
    return (-rule.severity, *(not flag for flag in flags), place, list(FaultCode).index(code))


class Leader(Enum):
    """Part that leads a screen; whatever else there is to say is small and of no colour of its own."""

    ALERT = "alert"
    """An alert in full: what to do stands in its band."""
    DISTANCE = "distance"
    """The word beside the gauge: closer, or back."""
    PASSING = "passing"
    """Cause that a scan would fail for now, in the place of READY."""
    OVERLAP = "overlap"
    """The way back to the scan before."""
    SCREEN = "screen"
    """Nothing is wrong: the screen's own words."""


def leader(shown: Sequence[Alert], overlap: OverlapSaid | None = None, reach: Reach = Reach.UNKNOWN) -> Leader:
    """Return what leads a screen with these alerts, with what is said of the overlap, and at that distance."""
    full = in_full(shown)
    if full is not None and full.severity > Severity.INFO:
        return Leader.ALERT
    if reach in (Reach.CLOSER, Reach.BACK):
        return Leader.DISTANCE
    if any(alert.passing for alert in shown):
        return Leader.PASSING
    return Leader.OVERLAP if overlap is not None and overlap.warns else Leader.SCREEN


def in_full(shown: Sequence[Alert]) -> Alert | None:
    """Return the one that is shown in full: the first of the gravest that nobody has acknowledged."""
    return max(
        (alert for alert in shown if not alert.seen and not alert.passing),
        key=lambda alert: alert.severity,
        default=None,
    )


def passing(shown: Sequence[Alert]) -> Alert | None:
    """Return the one that is told in the title: the first of those that pass."""
    return next((alert for alert in shown if alert.passing), None)


def on_screen(machine: Machine) -> tuple[Alert, ...]:
    """Return those of ``alerts`` that the band of the screen shows: not what the screen is made of, nor what is being
    remedied."""
    quiet = QUIET.get(machine.state, frozenset())
    if machine.state is State.AIM and machine.reach in (Reach.CLOSER, Reach.BACK):
        # The distance comes first, and makes light of its own: what is too near is too bright.
        quiet |= _BY_LIGHT
    return tuple(alert for alert in alerts(machine) if alert.code not in quiet)


def alerts(machine: Machine) -> tuple[Alert, ...]:
    """Return the alerts to show now: the notice first, for it answers a key, then what lasts, by ``urgency``; nothing
    twice."""
    lasts = [replace(alert_of(fault), lasts=True, seen=seen(machine, fault)) for fault in lasting(machine)]
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
