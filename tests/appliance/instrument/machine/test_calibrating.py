"""Calibrations in water as the diver lives them, key by key."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from appliance.calibrate.guide import LengthCheck, RecordingCheck, Refusal, Session, Step
from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.conditions import may_light
from appliance.instrument.machine.states import Device, Failure, FailureKind, Machine, State, Task
from appliance.instrument.machine.step import step
from appliance.instrument.machine.words import STEP_NAMES
from appliance.instrument.ranging.reach import Range
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import NOMINAL
from drivers.api import Key, KeyLongPress, KeyPress
from tests.appliance.instrument.machine.courses import (
    BACK,
    DOWN,
    EIO,
    LEAK,
    SCAN,
    STOP,
    Then,
    codes,
    course,
    seen,
    wait,
    warm,
)
from tests.appliance.instrument.machine.walks import (
    IN_USE,
    MISSING,
    RECORDED,
    SESSIONS,
    SOLVED,
    VERIFIED,
    after,
    aim,
    calibrating,
    calibrating_at,
    good,
    labels,
    run,
    trial_in_work,
)

S = State
M1, BAR = good(Step.M1), good(Step.VERIFY)
REFUSED = RecordingCheck(Step.M1, Refusal.TILT_MORE, 12.0, 900, "bar 150.0 mm, 12.0° in depth")
NO_BAR = Failure(FailureKind.RECORDING, "no bar", "M1")
RECORD = (SCAN, on.Armed(1), on.CaptureFinished(1))
NEW = (DOWN, KeyLongPress(Key.DOWN, 0))
ONE_BAR = Session((BAR,), None, LengthCheck(-0.006, None, 0.0001))


def recorded() -> Machine:
    return run(calibrating_at(RECORDED))


def solving() -> Machine:
    return run(recorded(), SCAN)


def verified() -> Machine:
    return calibrating_at(VERIFIED)


def in_use() -> Machine:
    return calibrating_at(IN_USE)


def storing() -> Machine:
    return run(calibrating(), *RECORD)


def entered() -> Machine:
    return run(trial_in_work(), on.TrialExamined(1, M1))


def checked() -> Machine:
    """The bar alone: past SOLVE, for which there is nothing."""
    return run(calibrating(), *(DOWN,) * 4, *RECORD, on.RawStored(1), on.TrialExamined(1, BAR))


@pytest.mark.parametrize(
    ("start", "events", "facts"),
    [
        course("the menu leads to the first step not done", lambda: calibrating_at(Session((M1, good(Step.M2)))), task=(Step.M3, None),
               state=S.CALIBRATE),
        # A recording.
        course("is armed", calibrating, SCAN, state=S.ARMED, among=do.Arm(1, 16, NOMINAL)),
        course("a far object is no reason to ask", calibrating, on.RangeMeasured(Range(700.0, 0.0, 0.5, 2)), SCAN, state=S.ARMED),
        course("stored and not reconstructed", calibrating, *RECORD, among=do.StoreRaw(1), never=do.Wish.RECONSTRUCT),
        course("examined, not before its frames are safe", storing, on.RawStored(1), effects=[do.CheckRecording(1, Step.M1)]),
        course("entered", trial_in_work, on.TrialExamined(1, M1), effects=[do.AcceptRecording(1, M1)]),
        course("and the next step follows", entered, on.Saved(1, "000001"), Session((M1,)), task=(Step.M2, None), latest=M1),
        course("entered it is not taken back by leaving", entered, BACK, state=S.AIM, never=(do.Wish.CANCEL_CALIBRATION, do.Reject)),
        course("looked at it is", trial_in_work, BACK,
               among=(do.Wish.CANCEL_CALIBRATION, do.Reject(1, "calibration M1: ended by the diver"))),
        course("refused with its reason", trial_in_work, on.TrialExamined(1, REFUSED), task=(Step.M1, None), latest=REFUSED,
               effects=[do.Reject(1, "calibration M1: TILT_MORE: bar 150.0 mm, 12.0° in depth")]),
        course("which goes with the next key", trial_in_work, on.TrialExamined(1, REFUSED), SCAN, state=S.ARMED, latest=None),
        course("a capture that fails", calibrating, SCAN, on.CaptureFailed(1, MISSING), task=(Step.M1, None), full="INCOMPLETE 23/24"),
        course("a camera lost", calibrating, SCAN, on.DeviceDown(Device.CAMERA_LEFT, "gone"), task=(Step.M1, None), full="SCAN FAILED"),
        course("stopped", calibrating, SCAN, BACK, task=(Step.M1, None), shown=[]),
        course("refused for the same reasons", calibrating, on.DeviceDown(Device.BOARD, "silent"), SCAN, state=S.CALIBRATE, never=do.Arm,
               full="BOARD LOST"),
        course("by heat as well", calibrating, warm(61.0), SCAN, state=S.CALIBRATE, full="HOT 61 °C"),
        course("the disk refuses the frames", storing, on.SaveFailed(1, EIO), task=(Step.M1, None), codes=[FaultCode.NOT_SAVED],
               failed=Failure(FailureKind.DISK, "EIO")),
        course("and the session goes on", storing, on.SaveFailed(1, EIO), SCAN, state=S.ARMED),
        course("of another recording", storing, on.SaveFailed(2, EIO), task=(Step.M1, Task.STORE)),
        course("a task that came to nothing", trial_in_work, NO_BAR, task=(Step.M1, None), failed=NO_BAR,
               among=do.Reject(1, "calibration M1: no bar")),
        *(course(f"{task} is not awaited for ever", way, wait(60.0), task=(Step.M1, None),
                 among=do.Wish.CANCEL_CALIBRATION) for way, task in ((storing, "the disk"), (trial_in_work, "the examination"))),
        course("but as long as it may take", trial_in_work, wait(59.999), task=(Step.M1, Task.EXAMINE)),
        course("stopped, it is put away", trial_in_work, STOP,
               among=(do.Wish.CANCEL_CALIBRATION, do.Reject(1, "calibration M1: switched off"), do.Quit(power_off=False))),
        *(course(f"water ends it: {said}", trial_in_work, on.ConditionRaised(Fault(FaultCode.LEAK, detail)), state=S.SAFE,
                 among=(do.Wish.CANCEL_CALIBRATION, do.Reject(1, f"calibration M1: {said}"))) for detail, said in (("wet", "wet"), ("", "LEAK"))),
        # The adjustment.
        course("solved", recorded, SCAN, effects=[do.Wish.SOLVE_CALIBRATION], task=(Step.SOLVE, Task.SOLVE)),
        course("left at any time, progress is kept", solving, BACK, state=S.AIM, among=do.Wish.CANCEL_CALIBRATION, session=RECORDED),
        course("and the same press does not switch off", solving, BACK, KeyLongPress(Key.BACK, 0), state=S.AIM, asked=False),
        course("solved it goes on", solving, SOLVED, task=(Step.VERIFY, None)),
        course("failed it says why", solving, NO_BAR, task=(Step.SOLVE, None), failed=NO_BAR, effects=[]),
        course("and may be tried again", solving, NO_BAR, SCAN, effects=[do.Wish.SOLVE_CALIBRATION]),
        course("stopped while it is solved", solving, STOP, effects=[do.Wish.CANCEL_CALIBRATION, do.Quit(power_off=False)]),
        # The result.
        course("kept", verified, SCAN, effects=[do.Wish.USE_SOLVED]),
        course("then it can be restored", verified, SCAN, IN_USE, task=(Step.RESULT, None), on_scan="RESTORE"),
        course("restored", in_use, SCAN, effects=[do.Wish.RESTORE_KEPT]),
        course("then it can be kept", in_use, SCAN, VERIFIED, on_scan="KEEP"),
        course("a new session needs a long press", in_use, DOWN, effects=[]),
        course("and begins", in_use, *NEW, effects=[do.Wish.BEGIN_SESSION]),
        course("with the first step", in_use, *NEW, Session(), task=(Step.M1, None)),
        *(course(f"not before there is a result {n}", partial(calibrating_at, SESSIONS[n]), *NEW, never=do.Wish.BEGIN_SESSION) for n in (0, 2, 3)),
        course("another session leads on from what can be done", in_use, SOLVED, task=(Step.VERIFY, None)),
        course("while aiming nowhere", aim, IN_USE, state=S.AIM),
        # The bar alone checks the calibration in use.
        course("a wrong length is told", checked, ONE_BAR, task=(Step.RESULT, None), on_scan=None, full="LENGTH ERR 0.6 %"),
        course("and can be left", checked, ONE_BAR, BACK, state=S.AIM),
        course("until it is right", checked, ONE_BAR,
               Session((BAR,), None, LengthCheck(0.0004, None, 0.0001)), codes=[]),
        course("or another one is in use", checked, ONE_BAR,
               Session(VERIFIED.trials, SOLVED.solved, LengthCheck(0.006, 0.0002, 0.0001), True, "0001.json"),
               codes=[]),
        course("what was solved is checked", lambda: calibrating_at(SOLVED), *RECORD, on.RawStored(1), on.TrialExamined(1, BAR),
               task=(Step.VERIFY, Task.ACCEPT)),
        course("and decided on", lambda: calibrating_at(SOLVED), *RECORD, on.RawStored(1), on.TrialExamined(1, BAR), VERIFIED,
               task=(Step.RESULT, None)),
    ],
)  # fmt: skip
def test_a_calibration_takes_its_course(
    start: Callable[[], Machine], events: tuple[Then, ...], facts: dict[str, object]
) -> None:
    assert seen(start, events, facts) == facts


def test_up_and_down_lead_where_their_labels_say_and_no_farther_than_what_is_done() -> None:
    machine, steps = calibrating(), [Step.M1]
    assert Key.UP not in labels(machine)
    while Key.DOWN in labels(machine):
        said = labels(machine)[Key.DOWN]
        machine = run(machine, DOWN)
        assert machine.calibrating is not None
        steps.append(machine.calibrating.step)
        assert said in (STEP_NAMES[steps[-1]].english, steps[-1].value)
    assert steps == [Step.M1, Step.M2, Step.M3, Step.M4, Step.VERIFY], "nothing can be solved yet, but checked"
    machine, steps = verified(), []
    while Key.UP in labels(machine):
        machine = run(machine, KeyPress(Key.UP, 0))
        assert machine.calibrating is not None
        steps.append(machine.calibrating.step)
    assert steps == [Step.VERIFY, Step.SOLVE, Step.M4, Step.M3, Step.M2, Step.M1]
    assert labels(machine)[Key.SCAN] == "REDO"


def test_solving_tells_how_far_it_is_and_only_back_does_something() -> None:
    machine = run(solving(), on.CalibrationProgressed(0.4))
    assert machine.calibrating is not None
    assert machine.calibrating.progress == 0.4
    for key in (Key.UP, Key.DOWN, Key.SCAN):
        assert after(machine, KeyPress(key, 0)) == (machine, [])


def test_water_in_the_housing_puts_the_light_out_at_every_step() -> None:
    for session in SESSIONS:
        machine, effects = after(calibrating_at(session), *LEAK)
        assert (machine.state, may_light(machine), codes(machine)[0]) == (S.SAFE, False, FaultCode.LEAK)
        assert do.Wish.DARK in effects
        assert not any(isinstance(e, do.GoLive) and (e.light or e.lasers) for e in after(machine, BACK)[1])


@pytest.mark.parametrize(
    ("way", "events"),
    [
        (trial_in_work, (on.TrialExamined(2, M1), on.TrialExamined(1, good(Step.M2)), on.RawStored(2), on.CalibrationProgressed(0.5))),
        (storing, (on.TrialExamined(1, M1),)),
        (calibrating, (NO_BAR,)), (aim, (NO_BAR,)),
        (lambda: run(trial_in_work(), BACK), (on.TrialExamined(1, M1), on.CalibrationProgressed(0.5))),
    ],
)  # fmt: skip
def test_answers_about_another_recording_or_step_change_nothing(
    way: Callable[[], Machine], events: tuple[on.Event, ...]
) -> None:
    for event in events:
        machine, effects = step(way(), event)
        assert (machine.calibrating, machine.state, effects) == (way().calibrating, way().state, ())


@pytest.mark.parametrize(("error", "told"), [(0.0009, False), (0.0013, True), (-0.0013, True), (-0.0009, False)])
def test_a_length_is_told_as_wrong_from_a_thousandth_on_in_either_direction(error: float, told: bool) -> None:
    machine = run(aim(), Session((BAR,), None, LengthCheck(error, None, 0.0001)))
    found = [fault for fault in machine.conditions if fault.code is FaultCode.LENGTH_ERROR]
    assert [dict(fault.numbers) for fault in found] == [{"error_percent": pytest.approx(0.13)}] * told
    assert all(f"{100 * error:+.3f} %" in fault.detail for fault in found)
