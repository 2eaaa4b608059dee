"""Ways into every state, through events only, and the set of all events: what the machine's tests share."""

from __future__ import annotations

from collections.abc import Iterable

from hypothesis import strategies as st

from appliance.calibration.guide import USED, Refusal, Session, Solved, Step, Trial, Verified
from appliance.capture.exposure import Exposure
from appliance.capture.fault import Fault, FaultCode
from appliance.capture.ranging import Range
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.states import Device, Machine, State, boot
from appliance.machine.step import step
from appliance.reconstruct.quality import CloudSummary
from drivers.api import Key, LaserState, Telemetry

SECOND_NS = 1_000_000_000
SUMMARY = CloudSummary(1000, coverage_percent=70.0, distance_mm=500.0, noise_mm=0.03, gap_mm=0.02)
MISSING = Fault(FaultCode.FRAME_MISSING, "left frame 9", {"received": 23, "expected": 24})


def run(machine: Machine, *events: on.Event) -> Machine:
    for event in events:
        machine, _ = step(machine, event)
    return machine


def after(machine: Machine, *events: on.Event) -> tuple[Machine, list[do.Effect]]:
    """The machine and all effects of all events, in order."""
    effects: list[do.Effect] = []
    for event in events:
        machine, wanted = step(machine, event)
        effects += wanted
    return machine, effects


def aim() -> Machine:
    ups = [on.DeviceUp(device) for device in Device]
    return run(boot(0), *ups, on.StorageCounted(0, None, 100), on.BootFinished())


def capturing() -> Machine:
    return run(aim(), on.KeyPressed(Key.SCAN))


def reconstructing() -> Machine:
    return run(capturing(), on.CaptureFinished(1))


def reviewing() -> Machine:
    return run(reconstructing(), on.RawStored(1), on.CoarseReady(1, SUMMARY), on.FullReady(1, SUMMARY))


def saving() -> Machine:
    return run(reviewing(), on.KeyPressed(Key.SCAN))


def calibrating() -> Machine:
    return run(aim(), on.KeyPressed(Key.UP), on.KeyHeld(Key.UP))


def trial_in_work() -> Machine:
    """The frames of M1 are stored, and the bar is looked for."""
    return run(calibrating(), on.KeyPressed(Key.SCAN), on.CaptureFinished(1), on.RawStored(1))


def good(step: Step) -> Trial:
    return Trial(step, None, 0.03, 4000, "bar 150.1 mm", "000001")


RECORDED = Session(tuple(good(step) for step in USED))
SOLVED = Session(RECORDED.trials, Solved("bundle", 0.03, (), "abc"))
VERIFIED = Session((*RECORDED.trials, good(Step.VERIFY)), SOLVED.solved, Verified(0.004, 0.0002, 0.00003))
IN_USE = Session(VERIFIED.trials, VERIFIED.solved, VERIFIED.verified, True, "0001.json")
SESSIONS = (Session(), Session((good(Step.M1),)), RECORDED, SOLVED, VERIFIED, IN_USE)


def calibrating_at(session: Session) -> Machine:
    return run(aim(), on.SessionChanged(session), on.KeyPressed(Key.UP), on.KeyHeld(Key.UP))


def ended() -> Machine:
    return run(aim(), on.KeyPressed(Key.BACK), on.KeyHeld(Key.BACK))


WAYS = {
    State.BOOT: lambda: boot(0),
    State.AIM: aim,
    State.CAPTURE: capturing,
    State.RECONSTRUCT: reconstructing,
    State.REVIEW: reviewing,
    State.SAVING: saving,
    State.CALIBRATE: calibrating,
    State.SHUTDOWN: ended,
}


def heartbeat(**sensors: float | bool | None) -> on.TelemetryArrived:
    lasers = LaserState(bool(sensors.pop("left_on", False)), bool(sensors.pop("right_on", False)))
    return on.TelemetryArrived(Telemetry(0, 0, 0, lasers, **sensors))  # type: ignore[arg-type]


_numbers = st.integers(0, 3)
_keys = st.sampled_from(list(Key))
_devices = st.sampled_from(list(Device))
_temperatures = st.one_of(st.none(), st.floats(-10, 120))
_faults = st.builds(
    Fault,
    st.sampled_from(list(FaultCode)),
    st.just("detail"),
    st.sampled_from([{}, {"received": 23.0, "expected": 24.0}, {"shift_px": 1.8}]),
    st.sampled_from([None, "camera.left", "board"]),
)
_summaries = st.sampled_from([SUMMARY, CloudSummary(0, None, None, None, None)])
_trials = st.builds(Trial, st.sampled_from(list(Step)), st.sampled_from([None, *Refusal]), st.sampled_from([None, 0.1]))
_warnings = st.lists(_faults, max_size=2).map(tuple)

EVENTS: st.SearchStrategy[on.Event] = st.one_of(
    st.builds(on.Tick, st.integers(0, 200).map(lambda s: s * SECOND_NS)),
    st.builds(on.KeyPressed, _keys),
    st.builds(on.KeyHeld, _keys),
    st.builds(on.KeyJammed, _keys),
    st.builds(on.DeviceUp, _devices),
    st.builds(on.DeviceDown, _devices, st.just("gone")),
    st.builds(on.BoardReset, st.just("BROWNOUT")),
    st.builds(
        heartbeat,
        left_on=st.booleans(),
        leak=st.sampled_from([None, False, True]),
        temperature_case_c=_temperatures,
        temperature_projector_c=_temperatures,
    ),
    st.builds(on.ConditionRaised, _faults),
    st.builds(on.ConditionCleared, st.sampled_from(list(FaultCode))),
    st.builds(on.StorageCounted, _numbers, st.none(), st.sampled_from([None, 0, 5])),
    st.builds(on.BootFinished),
    st.builds(on.CaptureFinished, _numbers),
    st.builds(on.CaptureFailed, _numbers, _faults),
    st.builds(on.RawStored, _numbers),
    st.builds(on.CoarseReady, _numbers, _summaries),
    st.builds(on.FullReady, _numbers, _summaries),
    st.builds(on.Judged, _numbers, _warnings, st.sampled_from([None, Exposure(8_000), Exposure(16_000, 4.0)])),
    st.builds(on.ReconstructionFailed, _numbers, _faults),
    st.builds(on.Saved, _numbers, st.just("000007")),
    st.builds(on.SaveFailed, _numbers, _faults),
    st.builds(on.Rejected, _numbers, st.just("000007")),
    st.builds(on.TrialExamined, _numbers, _trials),
    st.builds(on.SessionChanged, st.sampled_from(SESSIONS)),
    st.builds(on.CalibrationProgressed, st.floats(0, 1)),
    st.builds(on.CalibrationFailed, st.just("the adjustment did not converge")),
    st.builds(on.Ranged, st.sampled_from([None, Range(500.0, 2.0, 0.3, 2), Range(800.0, None, 1.0, 1)])),
    st.builds(on.StopRequested, st.just("SIGTERM")),
)

STARTS = (*WAYS.values(), trial_in_work, *(lambda s=session: calibrating_at(s) for session in SESSIONS))
START: st.SearchStrategy[Machine] = st.sampled_from(STARTS).map(lambda way: way())
WALKS = st.lists(EVENTS, max_size=25)


def walk(start: Machine, events: Iterable[on.Event]) -> Machine:
    return run(start, *events)
