"""The step ``pad``: each key must be pressed and released once and alone when it is requested."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from appliance.workshop.finding import Finding, finding_of
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered_request
from drivers import rig as drivers_rig
from drivers.api import Clock, Key, KeyPress, KeyRelease, Keys, KeysLost, KeyStuck
from drivers.keys import HidKeypad

PATIENCE_S = 45.0
"""Time to wait for one key before it is requested again."""
AFTERWARDS_S = 0.5
"""Time after a release in which a second press belongs to the same touch."""
POLL_S = 0.25
LIMITS = "this key alone, pressed once and released"


@dataclass(frozen=True, slots=True)
class KeyTrial:
    """All events of the keypad after one key was requested."""

    key: str
    pressed: tuple[str, ...]
    """Keys that were pressed, in order."""
    released: tuple[str, ...]
    held_s: float | None = None
    """Time for which the requested key was held; ``None``: it was not released."""


def do(workplace: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError."""
    spec = drivers_rig.KeysSpec(workplace.rig.keys.vendor_id, workplace.rig.keys.product_id)
    with drivers_rig.open_keys(spec, workplace.wires) as pad:
        return StepOutcome(_findings(workplace, pad))


def _findings(workplace: Workplace, pad: HidKeypad) -> tuple[Finding, ...]:
    listener = _Listener(workplace.wires.clock)
    trials = []
    for key in Key:
        for attempt in range(MOST_ASKED):
            workplace.person.tell(numbered_request(f"press {key.value.upper()} once and let it go", attempt))
            trial = listener.hear(pad, key)
            # A key with a faulty coil sends no press: no more attempts.
            if trial.pressed or key in listener.faulty:
                break
        trials.append(trial)
    counters = pad.counters
    faulty = {key.value for key in listener.faulty}
    return judge_pad(trials, faulty, counters.lost_reports, counters.garbage_reports, listener.silences)


class _Listener:
    """Listens to a keypad, one key at a time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.faulty: set[Key] = set()
        """Keys whose coil is faulty, or that stayed pressed."""
        self.silences = 0
        """Number of times that no report came for a second."""

    def hear(self, pad: Keys, key_requested: Key) -> KeyTrial:
        """Return the events until the requested key, or another one, was released, or the time was over."""
        pressed: list[str] = []
        released: list[str] = []
        held_s: float | None = None
        until_ns = self._clock.now_ns() + int(PATIENCE_S * 1e9)
        while self._clock.now_ns() < until_ns:
            event = pad.next_event(POLL_S)
            match event:
                case KeyPress(key=key):
                    pressed.append(key.value)
                # A finger that slips presses twice: events shortly after a release still belong to it.
                case KeyRelease(key=key, held_s=duration_s):
                    released.append(key.value)
                    held_s = duration_s if key is key_requested else held_s
                    until_ns = min(until_ns, self._clock.now_ns() + int(AFTERWARDS_S * 1e9))
                case KeyStuck(key=key):
                    self.faulty.add(key)
                    if key is key_requested:
                        break
                case KeysLost():
                    self.silences += 1
                case _:
                    pass
        return KeyTrial(key_requested.value, tuple(pressed), tuple(released), held_s)


def judge_pad(
    trials: Sequence[KeyTrial], faulty: Collection[str], lost: int, garbage: int, silences: int
) -> tuple[Finding, ...]:
    """Judge a keypad: each key that was tried, then its coils, then its reports."""
    statement = f"faulty, or pressed for too long: {', '.join(sorted(faulty))}" if faulty else "no coil is faulty"
    remedy = "measure the coil (some µH, some Ω): an open or shorted one is reported so; check the converter's wires"
    coils = finding_of("coils", not faulty, statement, "none", remedy)
    statement = f"{lost} reports lost, {garbage} garbled, silent {silences} times"
    limits = "none lost, none garbled, never silent for 1 s"
    remedy = "check the pad's USB cable, and its supply while the projector's lamp is on"
    ok = not (lost or garbage or silences)
    reports = finding_of("reports", ok, statement, limits, remedy, lost=lost, garbage=garbage, silences=silences)
    return (*(judge_key(trial, trial.key in faulty) for trial in trials), coils, reports)


def judge_key(trial: KeyTrial, faulty: bool = False) -> Finding:
    """Judge one key."""
    # Each other key once: a bouncing coil is a finding of its own.
    other_keys = " and ".join(sorted({key for key in trial.pressed if key != trial.key}))
    times = trial.pressed.count(trial.key)
    statement, remedy = f"pressed once and released after {trial.held_s or 0.0:.2f} s", ""
    if not trial.pressed:
        statement = "no press is reported"
        remedy = (
            "press it; if it was pressed, check its coil's wires and its target's distance, or lower the "
            "threshold in the pad's firmware"
        )
        remedy = "its coil is faulty: see coils" if faulty else remedy
    # Causes with the most consequences first: exchanged wires explain all that follows.
    elif times == 0:
        statement = f"{other_keys} answered instead"
        remedy = f"exchange the coils' wires: {trial.key} answers as {other_keys}"
    elif other_keys:
        statement = f"{other_keys} answered as well"
        remedy = (
            "one coil senses the other's target: use more distance between coils, other sensor frequencies "
            "or higher thresholds"
        )
    elif trial.key not in trial.released:
        statement = "is reported as still pressed"
        remedy = "free the key's target; if it is free, raise the threshold in the pad's firmware"
    elif times > 1:
        statement = f"answered {times} times"
        remedy = "press it once only; if it was pressed once, raise the hysteresis in the pad's firmware"
    return finding_of(f"key.{trial.key}", not remedy, statement, LIMITS, remedy, presses=times, held_s=trial.held_s)
