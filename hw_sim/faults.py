"""Fault injection: fault sentences, their parser, and the faults in force.

    <component> <verb> [how=<word>] [frame=<k>] [at_s=<t>] [for_s=<t>] [count=<n>] [amount=<x>]

A fault either *lasts* (from now, from ``at_s`` or from frame ``k`` on, until repaired or ``for_s`` has passed) or
*strikes* (a frame, ``count`` times, or every time). An unsupported combination raises and lists the supported ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar


@dataclass(frozen=True, slots=True)
class Kind:
    """One row of the table of faults."""

    hows: tuple[str, ...] = ()
    strikes: bool = False
    amount: float | None = None
    """Default of ``amount``; NaN if it must be given; ``None`` if the fault has no amount."""


Number = TypeVar("Number", int, float)
NAN = float("nan")
MOST = 1e9
"""Bound of frames, counts and seconds: 30 years."""
KINDS: dict[tuple[str, str], Kind] = {
    ("camera", "intermittent"): Kind(strikes=True),
    ("camera", "wrong"): Kind(("repeat", "swap"), strikes=True),
    ("camera", "garbage"): Kind(("truncate", "leader", "trailer"), strikes=True),
    ("camera", "off"): Kind(),
    ("camera", "stuck"): Kind(),
    ("camera", "slow"): Kind(),
    ("camera", "delayed"): Kind(strikes=True, amount=2.0),
    ("projector", "delayed"): Kind(strikes=True),
    ("projector", "wrong"): Kind(),
    ("projector", "off"): Kind(),
    ("graphics", "off"): Kind(),
    ("board", "off"): Kind(),
    ("board", "garbage"): Kind(),
    ("board", "slow"): Kind(),
    ("board", "wrong"): Kind(("reset", "vsync", "query", "glitch"), strikes=True),
    ("board", "delayed"): Kind(strikes=True, amount=8.3),
    ("board", "intermittent"): Kind(strikes=True),
    ("laser", "stuck"): Kind(),
    ("laser", "off"): Kind(),
    ("laser", "wrong"): Kind(),
    ("keypad", "off"): Kind(),
    ("keypad", "garbage"): Kind(),
    ("key", "stuck"): Kind(),
    ("sensor", "off"): Kind(),
    ("sensor", "wrong"): Kind(amount=NAN),
    ("leak", "wrong"): Kind(),
}
PARTS: dict[str, tuple[str, ...]] = {
    "camera": ("left", "right"),
    "laser": ("left", "right"),
    "key": ("scan", "back", "up", "down"),
    "sensor": ("TPROJ", "TCASE", "TBOARD", "HUM", "SUPPLY"),
}


class FaultSyntaxError(ValueError):
    """The sentence cannot be parsed, or the world has no such fault."""

    exit_code = 2


@dataclass(slots=True)
class Fault:
    """One fault sentence; ``component`` with its part, as in ``camera.left``."""

    component: str
    verb: str
    strikes: bool
    how: str | None = None
    frame: int | None = None
    """Frame of an armed sequence (0-based) that it strikes, or from which it lasts."""
    begins_ns: int = 0
    for_ns: int | None = None
    left: int | None = None
    """Number of further strikes; ``None`` without limit."""
    amount: float = NAN
    sentence: str = field(default="", compare=False)

    @property
    def waits_for_frame(self) -> bool:
        """True for a lasting fault whose frame has not come yet."""
        return self.frame is not None and not self.strikes

    def in_force(self, now_ns: int) -> bool:
        """Return True if it is in force now (or, for one that strikes, if it may strike now)."""
        ended = self.for_ns is not None and now_ns >= self.begins_ns + self.for_ns
        return not self.waits_for_frame and now_ns >= self.begins_ns and not ended and self.left != 0


def parse(sentence: str, now_ns: int = 0) -> Fault:
    """Parse a sentence that was given at ``now_ns``. Raises FaultSyntaxError."""
    component, verb, *parameters = [*sentence.split(), "", ""]
    if not verb:
        raise FaultSyntaxError(f"fault '{sentence}': a component and a verb are needed; supported: {supported()}")
    kind_name, _, part = component.partition(".")
    kind = KINDS.get((kind_name, verb))
    if kind is None or part not in PARTS.get(kind_name, ("",)):
        raise FaultSyntaxError(f"fault '{sentence}': '{component} {verb}' is not supported; supported: {supported()}")
    fault = Fault(component, verb, kind.strikes, begins_ns=now_ns, sentence=sentence)
    for parameter in filter(None, parameters):
        key, equals, value = parameter.partition("=")
        try:
            _set(fault, key if equals else "", value, parameter, now_ns)
        except ValueError as error:
            raise FaultSyntaxError(f"fault '{sentence}': {error}") from error
    _check(fault, kind)
    return fault


def _set(fault: Fault, key: str, value: str, word: str, now_ns: int) -> None:
    match key:
        case "how":
            fault.how = value
        case "frame":
            fault.frame = _number(int, key, value)
        case "at_s":
            fault.begins_ns = now_ns + int(_number(float, key, value) * 1e9)
        case "for_s":
            fault.for_ns = int(_number(float, key, value) * 1e9)
        case "count":
            fault.left = _number(int, key, value)
        case "amount":
            fault.amount = _number(float, key, value)
        case _:
            raise ValueError(f"'{word}' is not understood; allowed are how= frame= at_s= for_s= count= amount=")


def _number(kind: Callable[[str], Number], key: str, value: str) -> Number:
    try:
        number = kind(value)
    except ValueError:
        raise ValueError(f"{key}={value} is not a number") from None
    if key != "amount" and not 0 <= number < MOST:
        raise ValueError(f"{key}={value}; allowed are 0 and more, below {MOST:g}")
    return number


def _check(fault: Fault, kind: Kind) -> None:
    if fault.how not in (kind.hows or (None,)):
        allowed = " or ".join(f"how={h}" for h in kind.hows) or "no how"
        raise FaultSyntaxError(f"fault '{fault.sentence}': how={fault.how} is not supported; supported: {allowed}")
    if fault.left is not None and not kind.strikes:
        raise FaultSyntaxError(f"fault '{fault.sentence}': a lasting fault takes no count; give for_s=")
    # NaN is not equal to itself: the first test is whether an amount was given, the next whether it is missing.
    if fault.amount == fault.amount and kind.amount is None:
        raise FaultSyntaxError(f"fault '{fault.sentence}': it takes no amount")
    if fault.amount != fault.amount and kind.amount is not None:
        if kind.amount != kind.amount:
            raise FaultSyntaxError(f"fault '{fault.sentence}': amount= is needed")
        fault.amount = kind.amount
    # A named frame comes once per sequence, and the board has no frames: by default these strike once.
    if fault.left is None and kind.strikes and (fault.frame is not None or fault.component == "board"):
        fault.left = 1


def supported() -> str:
    """Return all supported sentences, one after the other."""
    sentences = []
    for (name, verb), kind in KINDS.items():
        parts = PARTS.get(name)
        component = f"{name}.{'|'.join(parts)}" if parts else name
        sentences += [f"{component} {verb}" + (f" how={how}" if how else "") for how in kind.hows or ("",)]
    return "; ".join(sentences)


class FaultBook:
    """The faults in force. Called with the world's lock held.

    ``when`` calls its second argument at a moment of world time; ``changed`` is called with the time whenever faults
    may have begun or been repaired.
    """

    def __init__(
        self,
        now_ns: Callable[[], int],
        when: Callable[[int, Callable[[int], None]], None],
        changed: Callable[[int], None],
    ) -> None:
        self._now_ns = now_ns
        self._when = when
        self._changed = changed
        self._faults: list[Fault] = []

    def add(self, sentence: str) -> Fault:
        """Add a fault by its sentence. Raises FaultSyntaxError."""
        now_ns = self._now_ns()
        fault = parse(sentence, now_ns)
        self._faults.append(fault)
        # A fault that begins later, or ends, notifies the devices at that moment, since they do not poll.
        if fault.begins_ns <= now_ns:
            self._changed(now_ns)
        else:
            self._when(fault.begins_ns, self._changed)
        if fault.for_ns is not None and not fault.waits_for_frame:
            self._when(fault.begins_ns + fault.for_ns, self._changed)
        return fault

    @property
    def sentences(self) -> tuple[str, ...]:
        """The sentences of all faults that are in force or may still strike."""
        now_ns = self._now_ns()
        return tuple(
            f.sentence for f in self._faults if f.begins_ns > now_ns or f.waits_for_frame or f.in_force(now_ns)
        )

    def mend(self, component: str, verb: str) -> int:
        """Repair the faults of that kind only, and return their number.

        Raises FaultSyntaxError for an unknown kind, or one without a fault.
        """
        kind_name, _, part = component.partition(".")
        if (kind_name, verb) not in KINDS or part not in PARTS.get(kind_name, ("",)):
            raise FaultSyntaxError(f"mend '{component} {verb}' is not supported; supported: {supported()}")
        remaining = [fault for fault in self._faults if (fault.component, fault.verb) != (component, verb)]
        mended = len(self._faults) - len(remaining)
        if not mended:
            broken = "; ".join(self.sentences) or "nothing"
            raise FaultSyntaxError(f"mend '{component} {verb}': there is no such fault; there are: {broken}")
        self._faults = remaining
        self._changed(self._now_ns())
        return mended

    def clear(self) -> None:
        """Repair all faults."""
        self._faults.clear()
        self._changed(self._now_ns())

    def reach(self, frame: int, time_ns: int) -> None:
        """Begin the faults that last from ``frame`` of an armed sequence on, which begins at ``time_ns``."""
        for fault in self._faults:
            if fault.waits_for_frame and fault.frame == frame and time_ns >= fault.begins_ns:
                fault.frame = None
                fault.begins_ns = time_ns
                if fault.for_ns is not None:
                    self._when(time_ns + fault.for_ns, self._changed)
                self._changed(time_ns)

    def active(self, component: str, verb: str) -> Fault | None:
        """Return the lasting fault of that kind in force now; ``None``: there is none."""
        now_ns = self._now_ns()
        for fault in self._faults:
            if (fault.component, fault.verb) == (component, verb) and not fault.strikes and fault.in_force(now_ns):
                return fault
        return None

    def strike(self, component: str, verb: str, how: str | None = None, frame: int | None = None) -> Fault | None:
        """Return the fault of that kind that strikes now, and count it; ``frame``: of an armed sequence, or None."""
        now_ns = self._now_ns()
        for fault in self._faults:
            if (fault.component, fault.verb, fault.how) != (component, verb, how) or not fault.in_force(now_ns):
                continue
            if fault.frame is not None and fault.frame != frame:
                continue
            if fault.left is not None:
                fault.left -= 1
            return fault
        return None
