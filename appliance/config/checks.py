"""Owns the rules between keys of the rig file: what each value may be in view of the others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from appliance.config.rig import OutputRig, Rig
from drivers.camera_families import USUAL, families
from drivers.registered_wires import NATIVE, REGISTERED


@dataclass(frozen=True, slots=True)
class Complaint:
    """One broken rule: the key, its value, how it relates to what is allowed, and what to do."""

    key: str
    value: object
    relation: str
    """Relation that is violated: ``> 16.16``, ``missing``, ``same as camera.left.serial``."""
    allowed: str
    remedy: str


def complaints(rig: Rig) -> Iterator[Complaint]:
    """Yield every broken rule, in the order of the file."""
    if rig.rig.wires not in REGISTERED:
        yield Complaint(
            "rig.wires",
            rig.rig.wires,
            "not registered",
            ", ".join(REGISTERED),
            f"correct it; on an instrument it is {NATIVE}",
        )
    if rig.camera.kind not in families():
        yield Complaint(
            "camera.kind",
            rig.camera.kind,
            "is no family of cameras",
            ", ".join(families()),
            f'correct it; usually it is "{USUAL}", and may be left out',
        )
    yield from _exposures_fit(rig)
    if rig.camera.left.serial == rig.camera.right.serial:
        yield Complaint(
            "camera.right.serial",
            rig.camera.right.serial,
            "same as camera.left.serial",
            "two different serial numbers",
            "read both from the cameras' type plates or with `kingfisher check`",
        )
    yield from _output_is_complete("projector", rig.projector)
    yield from _output_is_complete("display", rig.display)
    # One card may drive both, and on the instrument it does; one connector cannot.
    same_output = (rig.projector.card, rig.projector.connector) == (rig.display.card, rig.display.connector)
    if rig.projector.kind == "kms" and rig.display.kind == "kms" and same_output:
        yield Complaint(
            "display.connector",
            rig.display.connector,
            "same as projector.connector",
            "two different connectors",
            "the projector and the diver's screen each need their own",
        )
    limits = rig.limits
    for part, warm, hot, off in (
        ("case", limits.case_warm_c, limits.case_hot_c, limits.case_off_c),
        ("projector", limits.projector_warm_c, limits.projector_hot_c, limits.projector_off_c),
    ):
        if hot >= off:
            yield Complaint(
                f"limits.{part}_off_c", off, f"<= {hot:g}", f"above {part}_hot_c", "cool down before switching off"
            )
        if warm >= hot:
            yield Complaint(
                f"limits.{part}_warm_c", warm, f">= {hot:g}", f"below {part}_hot_c", "warn before scans are blocked"
            )


def _exposures_fit(rig: Rig) -> Iterator[Complaint]:
    period_ms = 1000.0 / rig.projector.refresh_hz
    delay_ms = rig.board.trigger_delay_us / 1000.0
    # The exposure must end before the next pattern is on the screen: it begins trigger_delay_us after the vertical
    # sync.
    longest_ms = period_ms - delay_ms
    for side, camera in (("left", rig.camera.left), ("right", rig.camera.right)):
        if camera.exposure_ms > longest_ms:
            yield Complaint(
                f"camera.{side}.exposure_ms",
                camera.exposure_ms,
                f"> {_floor_2(longest_ms):g}",
                f"0.05..{_floor_2(longest_ms):g} ms (period {period_ms:.2f} ms less trigger delay {delay_ms:g} ms)",
                "shorten the exposure, or board.trigger_delay_us",
            )
    allowed_ms, left_ms = rig.scan.exposures_ms, rig.camera.left.exposure_ms
    if allowed_ms is not None and left_ms not in allowed_ms:
        yield Complaint(
            "camera.left.exposure_ms",
            left_ms,
            "is none of scan.exposures_ms",
            ", ".join(f"{one:g}" for one in allowed_ms),
            "choose one of them, or measure this one with `kingfisher measure exposures`",
        )


def _output_is_complete(table: str, output: OutputRig) -> Iterator[Complaint]:
    if output.kind == "window":
        return
    for key, value in (("card", output.card), ("connector", output.connector)):
        if value is None:
            yield Complaint(
                f"{table}.{key}",
                None,
                "missing",
                'a name, since kind = "kms"',
                'add it, or set kind = "window"',
            )


def _floor_2(value: float) -> float:
    # Rounded down: the limit that the message names must itself be accepted.
    return int(value * 100.0) / 100.0
