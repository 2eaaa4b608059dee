"""Owns what is broken: fault sentences, parsed, and asked for by the devices at the moment they matter.

    <component> <verb> [how=<word>] [frame=<k>] [at_s=<t>] [for_s=<t>] [count=<n>] [amount=<x>]

An unsupported combination raises and lists the supported ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

SUPPORTED: dict[tuple[str, str], tuple[str | None, ...]] = {
    ("camera", "intermittent"): (None,),
    ("camera", "wrong"): ("repeat", "swap"),
    ("camera", "garbage"): ("truncate", "leader", "trailer"),
    ("camera", "off"): (None,),
    ("camera", "stuck"): (None,),
    ("camera", "slow"): (None,),
    ("camera", "delayed"): (None,),
    ("projector", "delayed"): (None,),
    ("projector", "wrong"): (None,),
    ("projector", "off"): (None,),
    ("board", "off"): (None,),
    ("board", "garbage"): (None,),
    ("board", "slow"): (None,),
    ("board", "wrong"): ("reset",),
    ("board", "intermittent"): (None,),
    ("laser", "stuck"): (None,),
    ("laser", "off"): (None,),
    ("keypad", "off"): (None,),
    ("keypad", "garbage"): (None,),
    ("key", "stuck"): (None,),
    ("sensor", "off"): (None,),
    ("sensor", "wrong"): (None,),
    ("leak", "wrong"): (None,),
}
PARTS: dict[str, tuple[str, ...]] = {
    "camera": ("left", "right"),
    "laser": ("left", "right"),
    "key": ("scan", "back", "up", "down"),
    "sensor": ("TPROJ", "TCASE", "TBOARD", "HUM", "SUPPLY"),
}


class FaultSyntaxError(ValueError):
    """The sentence is not understood, or the world cannot break that way."""


@dataclass(slots=True)
class Fault:
    """One fault sentence; ``component`` with its part, as in ``camera.left``."""

    component: str
    verb: str
    how: str | None = None
    frame: int | None = None
    """Only at this frame of the armed sequence (0-based)."""
    begins_ns: int = 0
    ends_ns: int | None = None
    left: int | None = None
    """How often it still happens; ``None`` without limit."""
    amount: float | None = None
    sentence: str = field(default="", compare=False)


def parse(sentence: str, now_ns: int = 0) -> Fault:
    """Parse a sentence said at ``now_ns``. Raises FaultSyntaxError."""
    words = sentence.split()
    if len(words) < 2:
        raise FaultSyntaxError(f"fault '{sentence}': a component and a verb are needed; supported: {supported()}")
    component, verb = words[0], words[1]
    kind, _, part = component.partition(".")
    hows = SUPPORTED.get((kind, verb))
    parts = PARTS.get(kind, ("",))
    if hows is None or part not in parts:
        raise FaultSyntaxError(f"fault '{sentence}': '{component} {verb}' is not supported; supported: {supported()}")
    fault = Fault(component, verb, begins_ns=now_ns, sentence=sentence)
    for_s: float | None = None
    for word in words[2:]:
        key, equals, value = word.partition("=")
        try:
            match key:
                case "how":
                    fault.how = value
                case "frame":
                    fault.frame = int(value)
                case "at_s":
                    fault.begins_ns = now_ns + int(float(value) * 1e9)
                case "for_s":
                    for_s = float(value)
                case "count":
                    fault.left = int(value)
                case "amount":
                    fault.amount = float(value)
                case _:
                    equals = ""
        except ValueError as error:
            raise FaultSyntaxError(f"fault '{sentence}': {key}={value} is not a number") from error
        if not equals:
            raise FaultSyntaxError(
                f"fault '{sentence}': '{word}'; allowed: how frame at_s for_s count amount, each with ="
            )
    if fault.how not in hows:
        wanted = " or ".join(f"how={h}" for h in hows if h) or "no how"
        raise FaultSyntaxError(f"fault '{sentence}': how={fault.how}; supported: {wanted}")
    if for_s is not None:
        fault.ends_ns = fault.begins_ns + int(for_s * 1e9)
    if fault.frame is not None and fault.left is None:
        # A frame fault happens once, except those that last from there on.
        fault.left = None if verb in ("off", "stuck") else 1
    return fault


def supported() -> str:
    """All supported sentences, one after the other."""
    sentences = []
    for (kind, verb), hows in SUPPORTED.items():
        parts = PARTS.get(kind)
        name = f"{kind}.{'|'.join(parts)}" if parts else kind
        sentences += [f"{name} {verb}" + (f" how={how}" if how else "") for how in hows]
    return "; ".join(sentences)


class FaultBook:
    """The faults in force. Called with the world's lock held."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._faults: list[Fault] = []

    def add(self, sentence: str) -> Fault:
        """Say a fault sentence. Raises FaultSyntaxError."""
        fault = parse(sentence, self._now_ns())
        self._faults.append(fault)
        return fault

    def clear(self) -> None:
        """Repair everything."""
        self._faults.clear()

    def active(self, component: str, verb: str, how: str | None = None, frame: int | None = None) -> Fault | None:
        """The fault of that kind in force now, at that frame if it names one; not counted."""
        now_ns = self._now_ns()
        for fault in self._faults:
            if (fault.component, fault.verb) != (component, verb) or (how is not None and fault.how != how):
                continue
            if now_ns < fault.begins_ns or (fault.ends_ns is not None and now_ns >= fault.ends_ns):
                continue
            if fault.left is not None and fault.left <= 0:
                continue
            if fault.frame is not None and fault.frame != frame:
                continue
            return fault
        return None

    def happens(self, component: str, verb: str, how: str | None = None, frame: int | None = None) -> Fault | None:
        """As ``active``, and counted as having happened once. A lasting fault that began at a frame stays from now on."""
        fault = self.active(component, verb, how, frame)
        if fault is not None:
            if fault.left is not None:
                fault.left -= 1
            elif fault.frame is not None:
                fault.frame = None
        return fault
