"""Owns the step ``pad``: each key is asked for by its name, and what the pad says is listened to until it was released."""

from __future__ import annotations

from appliance.bringup.finding import Finding
from appliance.bringup.guide import StepOutcome
from appliance.bringup.pad_check import KeyTried, PadHeard, judge_pad
from appliance.bringup.person import MOST_ASKED, numbered
from appliance.service.bringup.workplace import Workplace
from drivers import rig as drivers_rig
from drivers.api import Clock, Key, KeyPress, KeyRelease, Keys, KeysLost, KeyStuck
from drivers.keys import HidKeypad

PATIENCE_S = 45.0
"""Time for which one key is waited for before it is asked for again."""
AFTERWARDS_S = 0.5
"""Time after a release in which a second press is still the same finger's."""
POLL_S = 0.25


def pad_step(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError: the pad is not there, or went away."""
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
    faulty = frozenset(key.value for key in listener.faulty)
    return judge_pad(PadHeard(tuple(tried), faulty, counters.lost_reports, counters.garbage_reports, listener.silences))


class _Listener:
    """Listens to a pad, one key at a time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.faulty: set[Key] = set()
        self.silences = 0

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
