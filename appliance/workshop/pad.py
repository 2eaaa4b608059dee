"""Owns the step ``pad``: each key is asked for by its name, and must be pressed and released once and alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from appliance.workshop.finding import Finding, judged
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered
from drivers import rig as drivers_rig
from drivers.api import Clock, Key, KeyPress, KeyRelease, Keys, KeysLost, KeyStuck
from drivers.keys import HidKeypad

PATIENCE_S = 45.0
"""Time for which one key is waited for before it is asked for again."""
AFTERWARDS_S = 0.5
"""Time after a release in which a second press is still the same finger's."""
POLL_S = 0.25
LIMITS = "this key alone, pressed once and released"


@dataclass(frozen=True, slots=True)
class KeyTried:
    """Everything that the pad said after one key was asked for."""

    key: str
    pressed: tuple[str, ...]
    """Keys that were pressed, in order."""
    released: tuple[str, ...]
    held_s: float | None = None
    """Time for which the wanted key was held; ``None``: it was not released."""


def do(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError."""
    spec = drivers_rig.KeysSpec(at.rig.keys.vendor_id, at.rig.keys.product_id)
    with drivers_rig.open_keys(spec, at.wires) as pad:
        return StepOutcome(_findings(at, pad))


def _findings(at: Workplace, pad: HidKeypad) -> tuple[Finding, ...]:
    listener = _Listener(at.wires.clock)
    tried = []
    for key in Key:
        for turn in range(MOST_ASKED):
            at.person.tell(numbered(f"press {key.value.upper()} once and let it go", turn))
            heard = listener.hear(pad, key)
            # A key whose coil is faulty says nothing, however often it is asked for.
            if heard.pressed or key in listener.faulty:
                break
        tried.append(heard)
    counters = pad.counters
    faulty = {key.value for key in listener.faulty}
    return judge_pad(tried, faulty, counters.lost_reports, counters.garbage_reports, listener.silences)


class _Listener:
    """Listens to a pad, one key at a time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.faulty: set[Key] = set()
        """Keys whose coil is faulty, or that stayed pressed."""
        self.silences = 0
        """Times at which no report came for a second."""

    def hear(self, pad: Keys, wanted: Key) -> KeyTried:
        """Return what came until the wanted key, or another one in its place, was released, or patience was over."""
        pressed: list[str] = []
        released: list[str] = []
        held_s: float | None = None
        until_ns = self._clock.now_ns() + int(PATIENCE_S * 1e9)
        while self._clock.now_ns() < until_ns:
            event = pad.next_event(POLL_S)
            match event:
                case KeyPress(key=key):
                    pressed.append(key.value)
                # A finger that slips answers twice: what comes shortly after still belongs to it.
                case KeyRelease(key=key, held_s=held):
                    released.append(key.value)
                    held_s = held if key is wanted else held_s
                    until_ns = min(until_ns, self._clock.now_ns() + int(AFTERWARDS_S * 1e9))
                case KeyStuck(key=key):
                    self.faulty.add(key)
                    if key is wanted:
                        break
                case KeysLost():
                    self.silences += 1
                case _:
                    pass
        return KeyTried(wanted.value, tuple(pressed), tuple(released), held_s)


def judge_pad(
    tried: Sequence[KeyTried], faulty: Collection[str], lost: int, garbage: int, silences: int
) -> tuple[Finding, ...]:
    """Judge a pad: each key that was tried, then its coils, then its reports."""
    said = f"faulty, or pressed for too long: {', '.join(sorted(faulty))}" if faulty else "no coil is faulty"
    remedy = "measure the coil (some µH, some Ω): an open or shorted one is reported so; check the converter's wires"
    coils = judged("coils", not faulty, said, "none", remedy)
    said = f"{lost} reports lost, {garbage} garbled, silent {silences} times"
    limits = "none lost, none garbled, never silent for 1 s"
    remedy = "check the pad's USB cable, and its supply while the projector's lamp is on"
    ok = not (lost or garbage or silences)
    reports = judged("reports", ok, said, limits, remedy, lost=lost, garbage=garbage, silences=silences)
    return (*(judge_key(one, one.key in faulty) for one in tried), coils, reports)


def judge_key(tried: KeyTried, faulty: bool = False) -> Finding:
    """Judge one key."""
    # Once each: a coil that bounces is its own finding, not many others.
    others = " and ".join(sorted({one for one in tried.pressed if one != tried.key}))
    times = tried.pressed.count(tried.key)
    said, remedy = f"pressed once and released after {tried.held_s or 0.0:.2f} s", ""
    if not tried.pressed:
        said = "was not pressed, or the pad did not notice"
        remedy = "check its coil's wires and its target's distance; lower the threshold in the pad's firmware"
        remedy = "its coil is faulty: see coils" if faulty else remedy
    # From the most to the least telling: exchanged wires explain everything that follows.
    elif times == 0:
        said = f"{others} answered instead"
        remedy = f"exchange the coils' wires: {tried.key} answers as {others}"
    elif others:
        said = f"{others} answered as well"
        remedy = (
            "coils see each other's target: more distance between them, other sensor frequencies, higher thresholds"
        )
    elif tried.key not in tried.released:
        said = "was pressed and stays pressed"
        remedy = "the target does not come back, or the threshold is too near to rest: raise it in the pad's firmware"
    elif times > 1:
        said = f"answered {times} times"
        remedy = "press it once; if that was so, the coil bounces: raise the hysteresis in the pad's firmware"
    return judged(f"key.{tried.key}", not remedy, said, LIMITS, remedy, presses=times, held_s=tried.held_s)
