"""Owns the course of a scan as the machine sees it: refused or armed, recorded, checked, and decided on by the diver."""

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
"""Repetitions of a capture the diver does not hear of, for a late flip only."""
READABLE_S = 2.0
"""A refusal is shown at least so long: a device that comes back right after the press must not take the answer away."""


# ------------------------------------------------------------------------------------- asked for


def wanted(machine: Machine) -> Result:
    """Begin a scan, refuse it with a reason, or ask back outside the measuring volume."""
    reason = refusal(machine)
    if reason is not None:
        # COOLING says how long it will take; a refusal would only say no.
        if reason.code is FaultCode.HOT and machine.state is State.AIM:
            return enter(machine, State.COOLING), ()
        return _refused(machine, reason), ()
    outside = out_of_reach(machine)
    if outside is not None and machine.insists_until_ns is None:
        # Asked back, not refused: the distance is that of what the dots fall on, which need not be the object.
        until_ns = machine.now_ns + seconds_ns(machine.settings.insist_s)
        return replace(machine, insists_until_ns=until_ns, notice=Notice(outside, NoticeKind.NEWS)), ()
    return arm(replace(machine, retries=0))


def _refused(machine: Machine, reason: Fault) -> Machine:
    return replace(machine, notice=Notice(reason, NoticeKind.REFUSAL, machine.now_ns + seconds_ns(READABLE_S)))


def out_of_reach(machine: Machine) -> Fault | None:
    """Return why a scan would not be of the object: it is known to be outside the measuring volume. Steps of the
    calibration say themselves where their artefact belongs."""
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
    """Make ready for the next sequence, or for the second one of the scan in hand."""
    # A number is never used twice: answers to a sequence that was given up carry the old one and are ignored.
    number, scan = machine.captures + 1, machine.scan
    second = scan.second if scan is not None and scan.adding is not None else None
    if scan is not None and second is not None:
        machine = replace(machine, scan=replace(scan, adding=number))
    if second is None:
        machine = replace(machine, overlap_of=None, overlap=None)
    machine = enter(replace(machine, captures=number), State.ARMED, machine.settings.arm_s)
    # A ball bar that the calibration wants is no part of the wreck.
    of = machine.choices.object if machine.calibrating is None else None
    return machine, (do.Arm(number, machine.choices.period_px, second or machine.exposure, second is not None, of),)


def add(machine: Machine) -> Result:
    """Begin a second sequence with the exposure that was proposed; whatever comes of it, the scan in hand is not lost."""
    scan = machine.scan
    if scan is None or second_exposure(machine) is None:
        return machine, ()
    reason = refusal(machine)
    if reason is not None:
        return _refused(machine, reason), ()
    return arm(replace(machine, retries=0, scan=replace(scan, adding=machine.captures + 1)))


# ------------------------------------------------------------------------------------- recorded


def armed(machine: Machine, number: int) -> Result:
    """Begin the capture, as everything waits for the first pulse."""
    if machine.state is not State.ARMED or number != machine.captures:
        return machine, ()
    period_px = machine.choices.period_px
    limit_s = machine.settings.capture_s(period_px)
    # Spent before the light is on: a capture that fails half-way has cost its light all the same.
    machine = thermal.spend(machine, machine.settings.light_s(period_px))
    return enter(machine, State.CAPTURE, limit_s), (do.Capture(number),)


def abandon(machine: Machine, notice: Notice | None) -> Result:
    """Give up what is being recorded."""
    if notice is not None and notice.kind is NoticeKind.FAILURE:
        notice = _failure(machine, notice.fault)
    return replace(home(machine), notice=notice), (do.Wish.ABORT_CAPTURE,)


def _failure(machine: Machine, fault: Fault) -> Notice:
    """Return the notice that nothing came of a recording; of a second exposure, it says that the first one is there as
    it was."""
    adding = machine.scan is not None and machine.scan.adding is not None
    return Notice(fault, NoticeKind.NOT_ADDED if adding else NoticeKind.FAILURE)


def late(machine: Machine) -> Result:
    """Give up a capture of which neither an end nor a fault was heard in time."""
    begun = "ready" if machine.state is State.ARMED else "end"
    waited_s = (machine.now_ns - machine.since_ns) / 1e9
    fault = Fault(FaultCode.CAPTURE_TIMEOUT, f"no {begun} after {waited_s:.1f} s")
    return abandon(machine, Notice(fault, NoticeKind.FAILURE))


def finished(machine: Machine, number: int) -> Result:
    """Every witness agrees: secure the frames, and look at what they show."""
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
    """End a capture that no scan came of; a late flip is repeated once in silence."""
    if machine.state not in RECORDING or number != machine.captures:
        return machine, ()
    # The diver could do nothing against it but press the same key again.
    if fault.code is FaultCode.LATE_FLIP and machine.retries < SILENT_RETRIES:
        return arm(replace(machine, retries=machine.retries + 1))
    machine = replace(home(machine), notice=_failure(machine, fault))
    match fault.code:
        case FaultCode.LASER_ON:
            # What the board read back is the condition that telemetry clears; what images showed has its own witness.
            witness = None if fault.device == Device.BOARD.value else fault.device
            return raised(machine, Fault(fault.code, fault.detail, device=witness)), ()
        case FaultCode.CAMERA_STUCK:
            stuck = next((device for device in Device if device.value == fault.device), None)
            # A camera that repeats an image answers every question as if it worked: only opening it anew helps.
            return machine, (do.ReopenDevice(stuck),)
        case _:
            return machine, ()


# ------------------------------------------------------------------------------------- checked


def told(machine: Machine, number: int, fact: SequenceFact) -> Result:
    """Take over a fact about what the frames of scan ``number`` give."""
    if isinstance(fact, ScanOverlap):
        # Also where the diver kept it before this was known.
        return (replace(machine, overlap=fact.overlap), ()) if number == machine.overlap_of else (machine, ())
    scan = machine.scan
    if scan is None or scan.number != number:
        return machine, ()
    match fact:
        case PatternIdentity(judgement):
            return _patterns_right(machine) if judgement.fault is None else _no_points(machine, scan, judgement.fault)
        case CoarseCloud(found):
            return _show(replace(machine, scan=replace(scan, coarse=found.summary)))
        case Verdicts(judgements):
            return replace(machine, scan=_judged(scan, judgements)), ()
        case FullCloud(found, judgements):
            return _show(replace(machine, scan=replace(_judged(scan, judgements), full=found.summary, failed=None)))
        case Bracket():
            return _second_known(machine, scan, fact)
        case ReconstructionFailure(fault):
            return _no_points(machine, scan, fault)
        case WorkProgress():
            return machine, ()
        case _:
            assert_never(fact)


def _patterns_right(machine: Machine) -> Result:
    """Go on to the points, as each frame shows the pattern it should."""
    if machine.state is not State.CHECK:
        return machine, ()
    return enter(machine, State.RECONSTRUCT, machine.settings.reconstruct_s), ()


def _judged(scan: ScanInHand, judgements: tuple[Judgement, ...]) -> ScanInHand:
    """Return the scan with what is held against it now, and with the first proposals of its judges."""
    proposal = next((one.proposal for one in judgements if one.proposal is not None), None)
    second = next((one.second for one in judgements if one.second is not None), None)
    return replace(scan, warnings=faults_in(judgements), proposal=proposal, second=second)


def _no_points(machine: Machine, scan: ScanInHand, fault: Fault) -> Result:
    """Go on without points of the sequence that was recorded last."""
    if scan.publishing:
        return machine, ()  # it was accepted with what there was
    # Where the scan has its points, only a second sequence can have failed to get any.
    if scan.full is not None:
        return _not_added(machine, scan, fault)
    if fault.code in SPOILS_SCAN:
        dropped, effects = drop(machine, fault.detail or fault.code.value)
        return replace(dropped, notice=Notice(fault, NoticeKind.FAILURE)), effects
    return no_cloud(machine, fault, cancel=False)


def _second_known(machine: Machine, scan: ScanInHand, bracket: Bracket) -> Result:
    """Go to the review of a scan that is one of two exposures now, or of the first one alone."""
    if bracket.found is None:
        return _not_added(machine, scan, bracket.fault)
    if machine.state is not State.RECONSTRUCT or scan.adding is None:
        return machine, ()
    summary = bracket.found.summary
    scan = replace(
        scan,
        full=summary,
        coarse=summary,
        added=scan.second,
        second=None,
        warnings=faults_of_both((*scan.warnings, *faults_in((*bracket.second, bracket.pair)))),
        # The second frames are in memory only until StoreRaw is answered; durable is said of all of the scan.
        adding=None,
        proposal=None,
        raw_durable=False,
    )
    return replace(enter(machine, State.REVIEW), scan=scan), (do.StoreRaw(scan.number),)


def _not_added(machine: Machine, scan: ScanInHand, fault: Fault) -> Result:
    """Go back to the review of the first sequence, as it was."""
    if machine.state is not State.RECONSTRUCT or scan.adding is None:
        return machine, ()
    return replace(home(machine), notice=_failure(machine, fault)), ()


def stopped_adding(machine: Machine) -> Result:
    """Give up a second sequence whose points are being found, and no more."""
    if machine.scan is None or machine.scan.adding is None:
        return machine, ()
    return abandon(replace(machine, back_from=None), None)  # held on, this press does not reject the first one


def rejected(machine: Machine) -> Result:
    """Reject a scan that is not wanted, as BACK was held. One whose second sequence is under way is not decided on."""
    if machine.scan is None or machine.scan.adding is not None:
        return machine, ()
    when = "by the diver" if machine.state is State.REVIEW else "before the cloud was ready"
    return drop(machine, f"rejected {when}")


def no_cloud_in_time(machine: Machine) -> Result:
    """Go on without a cloud, as the worker said nothing for too long."""
    limit_s = machine.settings.reconstruct_s
    late = Fault(FaultCode.RECONSTRUCTION_FAILED, f"no cloud after {limit_s:g} s")
    if machine.scan is not None and machine.scan.adding is not None:
        return abandon(machine, Notice(late, NoticeKind.FAILURE))
    return no_cloud(machine, late)


def no_cloud(machine: Machine, fault: Fault, *, cancel: bool = True) -> Result:
    """Show that the worker failed: the raw frames can be kept without a cloud."""
    scan = machine.scan
    if scan is None:
        return enter(machine, State.AIM), ()
    machine, effects = _show(replace(machine, scan=replace(scan, failed=fault)))
    return machine, (do.Wish.CANCEL_RECONSTRUCTION, *effects) if cancel else effects


def _show(machine: Machine) -> Result:
    """Go to the review with the worker's news, or on with a save that waited for it."""
    scan = machine.scan
    if machine.state in (State.CHECK, State.RECONSTRUCT):
        return enter(machine, State.REVIEW), ()
    waited = machine.state in (State.SAVING, State.SAFE)
    # A save that the disk refused has its own time (`retry_ns`), and a cloud that comes meanwhile must not hurry
    # it.
    if waited and scan is not None and scan.settled and scan.kept and not scan.publishing and scan.retry_ns is None:
        return saving.publish(machine, scan)
    return machine, ()


# ------------------------------------------------------------------------------------- decided on


def review_key(machine: Machine, key: Key) -> Result:
    """SCAN keeps, UP turns the cloud, DOWN takes the proposed exposure for the next scan; the rest wants to be held."""
    scan = machine.scan
    if scan is None:  # REVIEW without a scan cannot be reached; if it were, the way out is AIM
        return enter(machine, State.AIM), ()
    match key:
        case Key.SCAN:
            return saving.keep(machine, scan)
        case Key.BACK:
            return machine, ()  # it is held to reject the scan
        case Key.UP:
            return replace(machine, scan=replace(scan, turn=scan.turn + 1)), ()
        case Key.DOWN:
            # DOWN is about the exposure, whatever the scan: a press changes the next scan's, and a second sequence,
            # which shines and must be held still for, wants it held.
            other = None if second_exposure(machine) is not None else other_exposure(machine)
            if other is None:
                return machine, ()
            return replace(machine, choices=replace(machine.choices, exposure=other)), ()
        case _:
            assert_never(key)


def drop(machine: Machine, reason: str) -> Result:
    """Put a scan that is not wanted, or worthless, among the rejected ones. From SAFE there is no way but SAFE."""
    scan = machine.scan
    machine = replace(machine, overlap_of=None, overlap=None)
    after: tuple[do.Effect, ...] = ()
    if machine.stopping is not None:
        # The end waited for this scan's save only: with nothing left to save it follows at once.
        machine, after = saving.end(machine)
    elif machine.state is State.SAFE:
        machine = replace(machine, scan=None, deadline_ns=None)
    else:
        machine = enter(machine, State.AIM)
    if scan is None:
        return machine, after
    cancel = () if scan.settled else (do.Wish.CANCEL_RECONSTRUCTION,)
    return machine, (*cancel, do.Reject(scan.number, reason), *after)
