"""Owns what both cameras must do for minutes at the projector's rate: every pulse a frame, every frame whole and stamped, nothing too warm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from appliance.bringup.finding import Finding

USUAL_MINUTES = 10.0


@dataclass(frozen=True, slots=True)
class SideEndured:
    """One camera's part in an endurance run."""

    whole: int
    """Frames that arrived whole."""
    bad: tuple[str, ...]
    """The driver's words about those that did not, one each."""
    without_stamp: int
    """Whole frames without a time by the camera's clock."""
    gaps: int
    """Places at which block ids do not grow by one."""
    lost: str | None = None
    """Reason why the camera was lost; ``None``: it was not."""


@dataclass(frozen=True, slots=True)
class Endured:
    """Everything that was seen of an endurance run."""

    minutes: float
    """Length of the run, as it was."""
    wanted_minutes: float
    pulses: int
    """Pulses that were asked for."""
    reported: int
    """Pulses that the board reported."""
    lost_reports: int
    cameras: Mapping[str, SideEndured]
    before_c: Mapping[str, float | None]
    """Temperatures by place before the run; ``None``: not known."""
    after_c: Mapping[str, float | None]
    ended_by: str | None = None
    """Event that ended the run before its time; ``None``: none did."""


def judge_endurance(seen: Endured, warm_c: Mapping[str, float]) -> tuple[Finding, ...]:
    """Judge an endurance run; ``warm_c`` are the rig file's limits by place, others have none."""
    return (_whole(seen), _board(seen), *(_side(seen, side) for side in seen.cameras), *_warmth(seen, warm_c))


def _whole(seen: Endured) -> Finding:
    limits = f"{seen.wanted_minutes:g} minutes"
    numbers: dict[str, float | None] = {"minutes": seen.minutes, "frames": float(seen.pulses)}
    said = f"{seen.minutes:.2g} minutes, {seen.pulses} pulses"
    if seen.ended_by is None:
        return Finding("run", True, said, limits, "", numbers)
    return Finding(
        "run", False, f"{said}; ended by: {seen.ended_by}", limits, "the findings below say of what", numbers
    )


def _board(seen: Endured) -> Finding:
    ok = seen.reported == seen.pulses and seen.lost_reports == 0
    said = f"the board reported {seen.reported} of {seen.pulses} pulses; {seen.lost_reports} of its reports were lost"
    remedy = (
        "" if ok else "give the board a USB port of its own; look for vertical syncs that are missed when it is warm"
    )
    numbers: dict[str, float | None] = {"reported": float(seen.reported), "lost_reports": float(seen.lost_reports)}
    return Finding("pulses", ok, said, "each pulse reported, no report lost", remedy, numbers)


def _side(seen: Endured, side: str) -> Finding:
    one = seen.cameras[side]
    name, limits = f"camera.{side}", "a whole frame with a stamp for each pulse"
    numbers: dict[str, float | None] = {
        "whole": float(one.whole),
        "not_whole": float(len(one.bad)),
        "without_stamp": float(one.without_stamp),
        "gaps": float(one.gaps),
    }
    said = f"{one.whole} whole frames of {seen.pulses} pulses"
    # A camera that is gone lacks frames, too: the cause is told, not the effect.
    if one.lost is not None:
        remedy = "check its cable and supply; see the kernel's log for USB resets (dmesg)"
        return Finding(name, False, f"{said}; the camera was lost: {one.lost}", limits, remedy, numbers)
    if one.bad:
        remedy = (
            "both cameras on USB controllers of their own; usbcore.usbfs_memory_mb = 1000; no other work on the computer; "
            "DeviceLinkThroughputLimit below the port's speed"
        )
        return Finding(name, False, f"{said}; {len(one.bad)} arrived {_counted(one.bad)}", limits, remedy, numbers)
    # Ids tell a frame that was lost on the way from a pulse that made none; both want another cable first.
    if one.gaps or one.whole != seen.pulses:
        remedy = (
            "frames are lost between camera and computer: another cable or port; a trigger is missed: see step trigger"
        )
        return Finding(name, False, f"{said}, with {one.gaps} gaps", limits, remedy, numbers)
    if one.without_stamp and one.without_stamp < one.whole:
        return Finding(
            name, False, f"{said}; {one.without_stamp} without a time", limits, "update the camera's firmware", numbers
        )
    return Finding(name, True, said, limits, "", numbers)


def _warmth(seen: Endured, warm_c: Mapping[str, float]) -> list[Finding]:
    found = []
    for place, after_c in seen.after_c.items():
        before_c, most_c = seen.before_c.get(place), warm_c.get(place)
        if after_c is None:
            found.append(Finding(f"warmth.{place}", True, "has no thermometer that answers"))
            continue
        rise = "" if before_c is None else f" (from {before_c:.1f} °C)"
        ok = most_c is None or after_c < most_c
        found.append(
            Finding(
                f"warmth.{place}",
                ok,
                f"{after_c:.1f} °C after the run{rise}",
                "" if most_c is None else f"below {most_c:g} °C, in air",
                "" if ok else "lead its heat to the housing (pads, copper), or limit the lamp; in water it is cooler",
                {"before_c": before_c, "after_c": after_c},
            )
        )
    return found


def _counted(words: Sequence[str]) -> str:
    return ", ".join(f"{word} ({words.count(word)}x)" for word in dict.fromkeys(words))
