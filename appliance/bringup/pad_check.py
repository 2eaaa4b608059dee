"""Owns what a key pad must be like: each key pressed and released once and alone, no faulty coil, no report lost."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.bringup.finding import Finding

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


@dataclass(frozen=True, slots=True)
class PadHeard:
    """Everything that a pad said while its keys were tried."""

    tried: tuple[KeyTried, ...]
    faulty: frozenset[str]
    """Keys whose coil is faulty, or that stayed pressed."""
    lost_reports: int
    garbage_reports: int
    silences: int
    """Times at which no report came for a second."""


def judge_pad(heard: PadHeard) -> tuple[Finding, ...]:
    """Judge a pad: each key that was tried, then its coils, then its reports."""
    return (*(judge_key(one, one.key in heard.faulty) for one in heard.tried), _coils(heard), _reports(heard))


def judge_key(tried: KeyTried, faulty: bool = False) -> Finding:
    """Judge one key."""
    name = f"key.{tried.key}"
    numbers: dict[str, float | None] = {"presses": float(tried.pressed.count(tried.key)), "held_s": tried.held_s}
    # Once each: a coil that bounces is its own finding, not many others.
    others = sorted({one for one in tried.pressed if one != tried.key})
    if not tried.pressed:
        remedy = (
            "its coil is faulty: see coils"
            if faulty
            else "check its coil's wires and its target's distance; lower the threshold in the pad's firmware"
        )
        return Finding(name, False, "was not pressed, or the pad did not notice", LIMITS, remedy, numbers)
    # From the most to the least telling: exchanged wires explain everything that follows.
    if tried.key not in tried.pressed:
        remedy = f"exchange the coils' wires: {tried.key} answers as {' and '.join(others)}"
        return Finding(name, False, f"{' and '.join(others)} answered instead", LIMITS, remedy, numbers)
    if others:
        remedy = (
            "coils see each other's target: more distance between them, other sensor frequencies, higher thresholds"
        )
        return Finding(name, False, f"{' and '.join(others)} answered as well", LIMITS, remedy, numbers)
    if tried.key not in tried.released:
        remedy = "the target does not come back, or the threshold is too near to rest: raise it in the pad's firmware"
        return Finding(name, False, "was pressed and stays pressed", LIMITS, remedy, numbers)
    times = tried.pressed.count(tried.key)
    if times > 1:
        remedy = "press it once; if that was so, the coil bounces: raise the hysteresis in the pad's firmware"
        return Finding(name, False, f"answered {times} times", LIMITS, remedy, numbers)
    return Finding(name, True, f"pressed once and released after {tried.held_s or 0.0:.2f} s", LIMITS, "", numbers)


def _coils(heard: PadHeard) -> Finding:
    if not heard.faulty:
        return Finding("coils", True, "no coil is faulty", "none")
    which = ", ".join(sorted(heard.faulty))
    remedy = "measure the coil (some µH, some Ω): an open or shorted one is reported so; check the converter's wires"
    return Finding("coils", False, f"faulty, or pressed for too long: {which}", "none", remedy)


def _reports(heard: PadHeard) -> Finding:
    numbers: dict[str, float | None] = {
        "lost": float(heard.lost_reports),
        "garbage": float(heard.garbage_reports),
        "silences": float(heard.silences),
    }
    ok = not (heard.lost_reports or heard.garbage_reports or heard.silences)
    said = f"{heard.lost_reports} reports lost, {heard.garbage_reports} garbled, silent {heard.silences} times"
    remedy = "" if ok else "check the pad's USB cable, and its supply while the projector's lamp is on"
    return Finding("reports", ok, said, "none lost, none garbled, never silent for 1 s", remedy, numbers)
