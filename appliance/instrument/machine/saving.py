"""Decisions about saving a scan: keep, publish, and repeat when the disk refuses."""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine import calibrate
from appliance.instrument.machine import effects as do
from appliance.instrument.machine.conditions import cleared, raised
from appliance.instrument.machine.moves import Result, enter
from appliance.instrument.machine.states import Ending, Machine, ScanInHand, State, seconds_ns
from appliance.measure import Fault, FaultCode

RETRIES = 3
"""Number of automatic tries after the disk refused; then the diver decides."""
RETRY_S = 5.0


def keep(machine: Machine, scan: ScanInHand) -> Result:
    """Publish a scan that is kept, as soon as the worker has no more results for it."""
    scan = replace(scan, is_kept=True, adding=None, failures=0, retry_ns=None)
    # Publishing early would store the scan without its cloud; the wait is bounded by the worker's deadline.
    if scan.settled:
        return publish(machine, scan)
    machine = enter(machine, _where(machine), machine.settings.reconstruct_s)
    return replace(machine, scan=scan), ()


def publish(machine: Machine, scan: ScanInHand) -> Result:
    """Start publishing the scan with its results so far."""
    machine = enter(machine, _where(machine), machine.settings.saving_s)
    return replace(machine, scan=replace(scan, publishing=True, retry_ns=None)), (do.Publish(scan.number),)


def raw_stored(machine: Machine, number: int) -> Machine:
    """Record that the raw frames are durable."""
    machine = cleared(machine, FaultCode.NOT_SAVED)
    if machine.scan is None or machine.scan.number != number:
        return machine
    return replace(machine, scan=replace(machine.scan, raw_durable=True, retry_ns=None))


def saved(machine: Machine, number: int, scan_id: str) -> Result:
    """Go on after the scan was published."""
    # Cleared for any number: an answer after its deadline still shows that the disk works again.
    machine = replace(cleared(machine, FaultCode.NOT_SAVED), last_scan=scan_id)
    if machine.scan is None or machine.scan.number != number:
        return machine, ()
    if machine.stopping is not None:
        return end(machine)
    if machine.state is State.SAFE:
        return replace(machine, scan=None, just_saved=scan_id, deadline_ns=None), ()
    return replace(enter(machine, State.AIM), just_saved=scan_id, notice=None), ()


def failed(machine: Machine, number: int, fault: Fault) -> Result:
    """Handle a refusal of the disk to write frames or publish the scan."""
    scan = machine.scan
    if scan is not None and scan.number == number and scan.publishing:
        return unsaved(machine, fault)
    machine = raised(machine, Fault(FaultCode.NOT_SAVED, fault.detail))
    if scan is not None and scan.number == number and not scan.raw_durable:
        return replace(machine, scan=_again(machine, scan)), ()
    return calibrate.not_saved(machine, number, fault.detail)


def unsaved(machine: Machine, fault: Fault) -> Result:
    """Go back to the decision, since the scan was not published.

    It is tried again automatically; OK tries at once, BACK repeats the scan.
    """
    machine = raised(machine, Fault(FaultCode.NOT_SAVED, fault.detail))
    scan = machine.scan
    if scan is None:
        return enter(machine, State.AIM), ()
    scan = replace(_again(machine, scan), publishing=False)
    if machine.stopping is not None and scan.retry_ns is None:
        return end(machine)
    if machine.state is not State.SAFE:
        machine = enter(machine, State.REVIEW if machine.stopping is None else State.SAVING)
    return replace(machine, scan=scan, deadline_ns=None), ()


def retry(machine: Machine) -> Result:
    """Try to save once more, if it is time."""
    scan = machine.scan
    if scan is None or scan.retry_ns is None or machine.now_ns < scan.retry_ns:
        return machine, ()
    if scan.is_kept and not scan.publishing and scan.settled:
        return publish(machine, scan)
    # Before the diver decides, only the raw frames are tried again, so that they are durable meanwhile.
    updated = replace(machine, scan=replace(scan, retry_ns=None))
    return updated, () if scan.raw_durable or scan.publishing else (do.StoreRaw(scan.number),)


def late(machine: Machine) -> Result:
    """Treat the save as refused, as the disk did not answer in time."""
    return unsaved(machine, Fault(FaultCode.NOT_SAVED, f"no answer of the disk for {machine.settings.saving_s:g} s"))


def _where(machine: Machine) -> State:
    """Return the state to save in: a save that began in SAFE stays there."""
    return State.SAFE if machine.state is State.SAFE else State.SAVING


def _again(machine: Machine, scan: ScanInHand) -> ScanInHand:
    """Count one more failure, and plan another try while some are left."""
    retry_ns = machine.now_ns + seconds_ns(RETRY_S) if scan.failures < RETRIES else None
    return replace(scan, failures=scan.failures + 1, retry_ns=retry_ns)


def end(machine: Machine) -> Result:
    """End the service or switch off, after the save."""
    power_off = machine.stopping is Ending.POWER_OFF
    return enter(machine, State.SHUTDOWN), (do.Quit(power_off),)
