"""Decisions about a scan: refuse or arm, record, check, and the diver's decision."""

from __future__ import annotations

from dataclasses import replace
from typing import assert_never

from appliance.instrument.machine import calibrate, saving, thermal
from appliance.instrument.machine import effects as do
from appliance.instrument.machine.conditions import other_exposure, raised, refusal, second_exposure
from appliance.instrument.machine.moves import RECORDING, Result, enter, home
from appliance.instrument.machine.states import Device, Machine, Notice, NoticeKind, ScanInHand, State, seconds_ns
from appliance.instrument.ranging.reach import Reach
from appliance.measure import (
    SPOILS_SCAN,
    Bracket,
    CoarseCloud,
    Fault,
    FaultCode,
    FullCloud,
    Judgement,
    PatternIdentity,
    ReconstructionFailure,
    ScanOverlap,
    SequenceFact,
    Verdicts,
    WorkProgress,
    faults_in,
    faults_of_both,
)
from drivers.api import Key

SILENT_RETRIES = 1
"""Number of repetitions of a capture without telling the diver, for a late flip only."""
READABLE_S = 2.0
"""Least time for which a refusal is shown, even if a device comes back right after the press."""


# ------------------------------------------------------------------------------------- requested


def request(machine: Machine) -> Result:
    """Begin a scan, refuse it with a reason, or ask back outside the working volume."""
    reason = refusal(machine)
    if reason is not None:
        # COOLING says how long it will take; a refusal would only say no.
        if reason.code is FaultCode.HOT and machine.state is State.AIM:
            return enter(machine, State.COOLING), ()
        return _refused(machine, reason), ()
    outside = out_of_reach(machine)
    if outside is not None and machine.insists_until_ns is None:
        # A second press records: the laser dots may fall on something other than the object.
        until_ns = machine.now_ns + seconds_ns(machine.settings.insist_s)
        return replace(machine, insists_until_ns=until_ns, notice=Notice(outside, NoticeKind.NEWS)), ()
    return arm(replace(machine, retries=0))


def _refused(machine: Machine, reason: Fault) -> Machine:
    return replace(machine, notice=Notice(reason, NoticeKind.REFUSAL, machine.now_ns + seconds_ns(READABLE_S)))


def out_of_reach(machine: Machine) -> Fault | None:
    """Return a fault if the object is known to be outside the working volume.

    Only in AIM: steps of the calibration state where their artefact belongs.
    """
    measured = machine.range
    if machine.state is not State.AIM or measured is None:
        return None
    numbers = {"distance_mm": measured.distance_mm}
    match machine.reach:
        case Reach.CLOSER:
            return Fault(FaultCode.TOO_FAR, f"{measured.distance_mm:.0f} mm away", numbers)
        case Reach.BACK:
            return Fault(FaultCode.TOO_NEAR, f"{measured.distance_mm:.0f} mm away", numbers)
        case Reach.OK | Reach.UNKNOWN:
            return None
        case unknown:
            assert_never(unknown)


def arm(machine: Machine) -> Result:
    """Prepare the next sequence, or the second one of the scan in hand."""
    # Each number is used once: late answers to an abandoned sequence carry the old number and are ignored.
    number, scan = machine.captures + 1, machine.scan
    second = scan.second if scan is not None and scan.adding is not None else None
    if scan is not None and second is not None:
        machine = replace(machine, scan=replace(scan, adding=number))
    if second is None:
        machine = replace(machine, overlap_of=None, overlap=None)
    machine = enter(replace(machine, captures=number), State.ARMED, machine.settings.arm_s)
    # Scans of the calibration's artefacts belong to no object.
    object_number = machine.choices.object if machine.calibrating is None else None
    return machine, (
        do.Arm(number, machine.choices.period_px, second or machine.exposure, second is not None, object_number),
    )


def add(machine: Machine) -> Result:
    """Begin a second sequence with the proposed exposure; the scan in hand is kept if it fails."""
    scan = machine.scan
    if scan is None or second_exposure(machine) is None:
        return machine, ()
    reason = refusal(machine)
    if reason is not None:
        return _refused(machine, reason), ()
    return arm(replace(machine, retries=0, scan=replace(scan, adding=machine.captures + 1)))


# ------------------------------------------------------------------------------------- recorded


def armed(machine: Machine, number: int) -> Result:
    """Begin the capture: all devices wait for the first pulse."""
    if machine.state is not State.ARMED or number != machine.captures:
        return machine, ()
    period_px = machine.choices.period_px
    limit_s = machine.settings.capture_s(period_px)
    # The light is counted before it is on: a capture that fails half-way has used it, too.
    machine = thermal.spend(machine, machine.settings.light_s(period_px))
    return enter(machine, State.CAPTURE, limit_s), (do.Capture(number),)


def abandon(machine: Machine, notice: Notice | None) -> Result:
    """Give up the sequence that is being recorded."""
    if notice is not None and notice.kind is NoticeKind.FAILURE:
        notice = _failure(machine, notice.fault)
    return replace(home(machine), notice=notice), (do.Wish.ABORT_CAPTURE,)


def _failure(machine: Machine, fault: Fault) -> Notice:
    """Return the notice of a failed capture; for a second exposure it says that the first is unchanged."""
    adding = machine.scan is not None and machine.scan.adding is not None
    return Notice(fault, NoticeKind.NOT_ADDED if adding else NoticeKind.FAILURE)


def late(machine: Machine) -> Result:
    """Give up a capture that neither ended nor failed in time."""
    begun = "ready" if machine.state is State.ARMED else "end"
    waited_s = (machine.now_ns - machine.since_ns) / 1e9
    fault = Fault(FaultCode.CAPTURE_TIMEOUT, f"no {begun} after {waited_s:.1f} s")
    return abandon(machine, Notice(fault, NoticeKind.FAILURE))


def finished(machine: Machine, number: int) -> Result:
    """Store the frames and start their reconstruction, as every witness agrees."""
    if machine.state is not State.CAPTURE or number != machine.captures:
        return machine, ()
    if machine.calibrating is not None:
        return calibrate.captured(machine, number)
    if machine.scan is not None and machine.scan.adding == number:
        # A second sequence is not stored yet: its frames are written when the merge has succeeded (ADR 0025), so
        # that a refused one leaves nothing to be undone.
        machine = enter(machine, State.RECONSTRUCT, machine.settings.reconstruct_s)
        return machine, (do.Wish.RECONSTRUCT,)
    machine = enter(machine, State.CHECK, machine.settings.reconstruct_s)
    machine = replace(machine, scan=ScanInHand(number, machine.exposure), overlap_of=number)
    return machine, (do.StoreRaw(number), do.Wish.RECONSTRUCT)


def failed(machine: Machine, number: int, fault: Fault) -> Result:
    """End a failed capture; after a late flip it is repeated once, without a notice."""
    if machine.state not in RECORDING or number != machine.captures:
        return machine, ()
    # The diver could only press the same key again.
    if fault.code is FaultCode.LATE_FLIP and machine.retries < SILENT_RETRIES:
        return arm(replace(machine, retries=machine.retries + 1))
    machine = replace(home(machine), notice=_failure(machine, fault))
    match fault.code:
        case FaultCode.LASER_ON:
            # A fault that the board reports is the condition that telemetry clears. One seen in images keeps its
            # device.
            witness = None if fault.device == Device.BOARD.value else fault.device
            return raised(machine, Fault(fault.code, fault.detail, device=witness)), ()
        case FaultCode.CAMERA_STUCK:
            stuck = next((device for device in Device if device.value == fault.device), None)
            # A camera that repeats an image otherwise answers as if it worked: only opening it again helps.
            return machine, (do.ReopenDevice(stuck),)
        case _:
            return machine, ()


# ------------------------------------------------------------------------------------- checked


def apply_fact(machine: Machine, number: int, fact: SequenceFact) -> Result:
    """Apply a fact about the frames of scan ``number``."""
    if isinstance(fact, ScanOverlap):
        # Applied even if the diver has kept the scan before the overlap was known.
        return (replace(machine, overlap=fact.overlap), ()) if number == machine.overlap_of else (machine, ())
    scan = machine.scan
    if scan is None or scan.number != number:
        return machine, ()
    match fact:
        case PatternIdentity(judgement):
            return _patterns_right(machine) if judgement.fault is None else _no_points(machine, scan, judgement.fault)
        case CoarseCloud(cloud):
            return _show(replace(machine, scan=replace(scan, coarse=cloud.summary)))
        case Verdicts(judgements):
            return replace(machine, scan=_with_judgements(scan, judgements)), ()
        case FullCloud(cloud, judgements):
            return _show(
                replace(machine, scan=replace(_with_judgements(scan, judgements), full=cloud.summary, failed=None))
            )
        case Bracket():
            return _finish_bracket(machine, scan, fact)
        case ReconstructionFailure(fault):
            return _no_points(machine, scan, fault)
        case WorkProgress():
            return machine, ()
        case _:
            assert_never(fact)


def _patterns_right(machine: Machine) -> Result:
    """Go on to the points, since each frame shows the right pattern."""
    if machine.state is not State.CHECK:
        return machine, ()
    return enter(machine, State.RECONSTRUCT, machine.settings.reconstruct_s), ()


def _with_judgements(scan: ScanInHand, judgements: tuple[Judgement, ...]) -> ScanInHand:
    """Return the scan with the verdicts' faults and the first proposals of its judges."""
    proposal = next((judgement.proposal for judgement in judgements if judgement.proposal is not None), None)
    second = next((judgement.second for judgement in judgements if judgement.second is not None), None)
    return replace(scan, warnings=faults_in(judgements), proposal=proposal, second=second)


def _no_points(machine: Machine, scan: ScanInHand, fault: Fault) -> Result:
    """Go on without points of the sequence that was recorded last."""
    if scan.publishing:
        return machine, ()  # the diver has kept it without them
    # If the scan has its points, it is the second sequence that failed.
    if scan.full is not None:
        return _not_added(machine, scan, fault)
    if fault.code in SPOILS_SCAN:
        dropped, effects = drop(machine, fault.detail or fault.code.value)
        return replace(dropped, notice=Notice(fault, NoticeKind.FAILURE)), effects
    return no_cloud(machine, fault, cancel=False)


def _finish_bracket(machine: Machine, scan: ScanInHand, bracket: Bracket) -> Result:
    """Go to the review of the merged bracket, or of the first exposure alone."""
    if bracket.cloud is None:
        return _not_added(machine, scan, bracket.fault)
    if machine.state is not State.RECONSTRUCT or scan.adding is None:
        return machine, ()
    summary = bracket.cloud.summary
    scan = replace(
        scan,
        full=summary,
        coarse=summary,
        added=scan.second,
        second=None,
        warnings=faults_of_both((*scan.warnings, *faults_in((*bracket.second, bracket.pair)))),
        # Durable refers to all frames: the second ones are in memory only until StoreRaw is answered.
        adding=None,
        proposal=None,
        raw_durable=False,
    )
    return replace(enter(machine, State.REVIEW), scan=scan), (do.StoreRaw(scan.number),)


def _not_added(machine: Machine, scan: ScanInHand, fault: Fault) -> Result:
    """Go back to the review of the first sequence, unchanged."""
    if machine.state is not State.RECONSTRUCT or scan.adding is None:
        return machine, ()
    return replace(home(machine), notice=_failure(machine, fault)), ()


def stopped_adding(machine: Machine) -> Result:
    """Give up only the second sequence, while its points are computed."""
    if machine.scan is None or machine.scan.adding is None:
        return machine, ()
    return abandon(replace(machine, back_from=None), None)  # held on, this press does not reject the first one


def rejected(machine: Machine) -> Result:
    """Reject the scan in hand, as BACK was held; not while a second sequence is being added."""
    if machine.scan is None or machine.scan.adding is not None:
        return machine, ()
    when = "by the diver" if machine.state is State.REVIEW else "before the cloud was ready"
    return drop(machine, f"rejected {when}")


def no_cloud_in_time(machine: Machine) -> Result:
    """Go on without a cloud, as the worker exceeded its time."""
    limit_s = machine.settings.reconstruct_s
    late = Fault(FaultCode.RECONSTRUCTION_FAILED, f"no cloud after {limit_s:g} s")
    if machine.scan is not None and machine.scan.adding is not None:
        return abandon(machine, Notice(late, NoticeKind.FAILURE))
    return no_cloud(machine, late)


def no_cloud(machine: Machine, fault: Fault, *, cancel: bool = True) -> Result:
    """Go on without a cloud, as the worker failed; the raw frames can be kept."""
    scan = machine.scan
    if scan is None:
        return enter(machine, State.AIM), ()
    machine, effects = _show(replace(machine, scan=replace(scan, failed=fault)))
    return machine, (do.Wish.CANCEL_RECONSTRUCTION, *effects) if cancel else effects


def _show(machine: Machine) -> Result:
    """Go to the review with the worker's result, or publish a scan that waited for it."""
    scan = machine.scan
    if machine.state in (State.CHECK, State.RECONSTRUCT):
        return enter(machine, State.REVIEW), ()
    is_awaited = machine.state in (State.SAVING, State.SAFE)
    # A failed save is repeated at its own time (`retry_ns`), even if a cloud comes meanwhile.
    if (
        is_awaited
        and scan is not None
        and scan.settled
        and scan.is_kept
        and not scan.publishing
        and scan.retry_ns is None
    ):
        return saving.publish(machine, scan)
    return machine, ()


# ------------------------------------------------------------------------------------- decided on


def review_key(machine: Machine, key: Key) -> Result:
    """Handle a key in REVIEW: SCAN keeps, UP turns the cloud, DOWN applies the proposed exposure."""
    scan = machine.scan
    if scan is None:  # REVIEW without a scan cannot be reached; if it were, the way out is AIM
        return enter(machine, State.AIM), ()
    match key:
        case Key.SCAN:
            return saving.keep(machine, scan)
        case Key.BACK:
            return machine, ()  # it is held to reject the scan
        case Key.UP:
            return replace(machine, scan=replace(scan, turn_steps=scan.turn_steps + 1)), ()
        case Key.DOWN:
            # DOWN concerns the exposure: a press changes that of the next scan. A second sequence, for which the
            # instrument must be held still, needs DOWN to be held.
            exposure = None if second_exposure(machine) is not None else other_exposure(machine)
            if exposure is None:
                return machine, ()
            return replace(machine, choices=replace(machine.choices, exposure=exposure)), ()
        case _:
            assert_never(key)


def drop(machine: Machine, reason: str) -> Result:
    """Move an unwanted or worthless scan to the rejected ones. SAFE stays SAFE."""
    scan = machine.scan
    machine = replace(machine, overlap_of=None, overlap=None)
    after: tuple[do.Effect, ...] = ()
    if machine.stopping is not None:
        # The instrument waited only for this scan to be saved before ending.
        machine, after = saving.end(machine)
    elif machine.state is State.SAFE:
        machine = replace(machine, scan=None, deadline_ns=None)
    else:
        machine = enter(machine, State.AIM)
    if scan is None:
        return machine, after
    cancel = () if scan.settled else (do.Wish.CANCEL_RECONSTRUCTION,)
    return machine, (*cancel, do.Reject(scan.number, reason), *after)
