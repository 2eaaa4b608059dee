"""Rules between keys of the rig file: limits of one value that depend on the others."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from appliance.store.config.rig import OutputRig, Rig
from drivers.camera_families import USUAL, families
from drivers.registered_wires import NATIVE, REGISTERED

BOUNDARY_US = 100
"""Largest distance of a trigger from the beginning of a sub-frame."""
WHOLE_MS = 0.02
"""Largest difference of an exposure from whole sub-frames: a little more than rounding to hundredths of a
millisecond makes."""
MOST_DELAY_US = 15_000
"""Largest delay that the board takes (ARM)."""


@dataclass(frozen=True, slots=True)
class BrokenRule:
    """One broken rule: the key, its value, its relation to the allowed range, and the remedy."""

    key: str
    value: object
    relation: str
    """Relation that is violated: ``> 16.16``, ``missing``, ``same as camera.left.serial``."""
    allowed: str
    remedy: str


def broken_rules(rig: Rig) -> Iterator[BrokenRule]:
    """Yield every broken rule, in the order of the file."""
    if rig.rig.wires not in REGISTERED:
        yield BrokenRule(
            "rig.wires",
            rig.rig.wires,
            "not registered",
            ", ".join(REGISTERED),
            f"correct it; on an instrument it is {NATIVE}",
        )
    if rig.camera.kind not in families():
        yield BrokenRule(
            "camera.kind",
            rig.camera.kind,
            "is no family of cameras",
            ", ".join(families()),
            f'correct it, or leave it out for "{USUAL}"',
        )
    yield from _exposures_fit(rig)
    yield from _volume_is_seen(rig)
    if rig.camera.left.serial == rig.camera.right.serial:
        yield BrokenRule(
            "camera.right.serial",
            rig.camera.right.serial,
            "same as camera.left.serial",
            "two different serial numbers",
            "read both from the cameras' type plates or with `kingfisher check`",
        )
    yield from _output_is_complete("projector", rig.projector)
    yield from _output_is_complete("display", rig.display)
    # One card may drive both outputs, and on the instrument it does; one connector cannot.
    same_output = (rig.projector.card, rig.projector.connector) == (rig.display.card, rig.display.connector)
    if rig.projector.kind == "kms" and rig.display.kind == "kms" and same_output:
        yield BrokenRule(
            "display.connector",
            rig.display.connector,
            "same as projector.connector",
            "two different connectors",
            "give the projector and the diver's display a connector each",
        )
    limits = rig.limits
    for part, warm, hot, off in (
        ("case", limits.case_warm_c, limits.case_hot_c, limits.case_off_c),
        ("projector", limits.projector_warm_c, limits.projector_hot_c, limits.projector_off_c),
    ):
        if hot >= off:
            yield BrokenRule(
                f"limits.{part}_off_c",
                off,
                f"<= {hot:g}",
                f"above {part}_hot_c",
                "give a limit for cooling below the one for switching off",
            )
        if warm >= hot:
            yield BrokenRule(
                f"limits.{part}_warm_c",
                warm,
                f">= {hot:g}",
                f"below {part}_hot_c",
                "give a limit for the warning below the one that blocks scans",
            )


def _exposures_fit(rig: Rig) -> Iterator[BrokenRule]:
    period_ms = 1000.0 / rig.projector.refresh_hz
    delay_ms = into_light_us(rig) / 1000.0
    # The exposure must end before the next pattern is on the screen. It begins trigger_delay_us after the vsync; where
    # the light begins later, it also ends later.
    longest_ms = period_ms - delay_ms
    for side, camera in (("left", rig.camera.left), ("right", rig.camera.right)):
        if camera.exposure_ms > longest_ms:
            yield BrokenRule(
                f"camera.{side}.exposure_ms",
                camera.exposure_ms,
                f"> {_floor_2(longest_ms):g}",
                f"0.05..{_floor_2(longest_ms):g} ms (period {period_ms:.2f} ms less trigger delay {delay_ms:g} ms)",
                "shorten the exposure, or board.trigger_delay_us",
            )
    allowed_ms, left_ms = rig.scan.exposures_ms, rig.camera.left.exposure_ms
    if allowed_ms is not None and left_ms not in allowed_ms:
        yield BrokenRule(
            "camera.left.exposure_ms",
            left_ms,
            "is not in scan.exposures_ms",
            ", ".join(f"{exposure_ms:g}" for exposure_ms in allowed_ms),
            "choose one of them, or measure this one with `kingfisher calibration measure exposures`",
        )
    if rig.projector.sub_frames > 1:
        yield from _whole_sub_frames(rig)


def into_light_us(rig: Rig) -> int:
    """Return the delay from the beginning of a picture's light to the exposure.

    This is the trigger's delay, less the light's where that is known and not longer.
    """
    delay_us, begins_us = rig.board.trigger_delay_us, rig.projector.light_begins_us
    return delay_us - begins_us if delay_us >= begins_us else delay_us


def _whole_sub_frames(rig: Rig) -> Iterator[BrokenRule]:
    """Yield exposures of other than whole sub-frames: these would weigh some grey values more than others."""
    projector, delay_us = rig.projector, rig.board.trigger_delay_us
    step_ms = projector.sub_frame_ms
    begins_us = [projector.light_begins_us + round(1000.0 * k * step_ms) for k in range(projector.sub_frames)]
    if min(abs(delay_us - begins) for begins in begins_us) > BOUNDARY_US:
        yield BrokenRule(
            "board.trigger_delay_us",
            delay_us,
            f"is not at the beginning of one of projector.sub_frames {projector.sub_frames}",
            ", ".join(str(begin_us) for begin_us in begins_us if begin_us <= MOST_DELAY_US)
            + f" us, each to {BOUNDARY_US} us",
            "choose the beginning of a sub-frame, or measure the projector with `kingfisher setup measure projector`",
        )
    left_ms, right_ms = rig.camera.left.exposure_ms, rig.camera.right.exposure_ms
    exposures = [
        ("camera.left.exposure_ms", left_ms),
        *(("scan.exposures_ms", allowed_ms) for allowed_ms in rig.scan.exposures_ms or ()),
    ]
    for key, exposure_ms in exposures:
        count = round(exposure_ms / step_ms)
        if count < 1 or abs(exposure_ms - count * step_ms) > WHOLE_MS:
            yield BrokenRule(
                key,
                exposure_ms,
                f"is no multiple of a sub-frame of {step_ms:.3f} ms",
                ", ".join(f"{k * step_ms:.3f}" for k in range(1, projector.sub_frames + 1)),
                "choose one of them, or correct projector.sub_frames",
            )
    if right_ms != left_ms:
        yield BrokenRule(
            "camera.right.exposure_ms",
            right_ms,
            "differs from camera.left.exposure_ms",
            f"{left_ms:g}, as on the left",
            "set both alike; set a camera's brightness by its gain_db",
        )


def _volume_is_seen(rig: Rig) -> Iterator[BrokenRule]:
    """Yield a volume whose distances are not in order, or at which the nominal cameras do not look."""
    volume = rig.volume
    if not volume.nearest_mm < volume.working_mm < volume.farthest_mm:
        yield BrokenRule(
            "volume.working_mm",
            volume.working_mm,
            "not between volume.nearest_mm and volume.farthest_mm",
            "nearest_mm < working_mm < farthest_mm",
            "give the distances for which the housing is built",
        )
        return
    if rig.design.toe_in_deg <= 0.0:
        return
    crossing_mm = 0.5 * rig.design.baseline_mm / math.tan(math.radians(rig.design.toe_in_deg))
    if not volume.nearest_mm <= crossing_mm <= volume.farthest_mm:
        yield BrokenRule(
            "volume.working_mm",
            volume.working_mm,
            f"does not fit [design], whose cameras' axes cross at {crossing_mm:.0f} mm",
            f"a volume that includes this distance; it is {volume.nearest_mm:g}..{volume.farthest_mm:g} mm",
            "correct [volume] for this housing, or design.baseline_mm and design.toe_in_deg",
        )


def _output_is_complete(table: str, output: OutputRig) -> Iterator[BrokenRule]:
    if output.kind == "window":
        return
    for key, value in (("card", output.card), ("connector", output.connector)):
        if value is None:
            yield BrokenRule(
                f"{table}.{key}",
                None,
                "missing",
                'a name, since kind = "kms"',
                'add it, or set kind = "window"',
            )


def _floor_2(value: float) -> float:
    # Rounded down, so that the limit in the message is itself accepted.
    return int(value * 100.0) / 100.0
