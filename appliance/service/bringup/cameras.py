"""Owns the step ``cameras``: each one's link and settings, and what both see with their caps on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from appliance.bringup.bench import Image
from appliance.bringup.camera_check import DarkSeen, judge_dark, judge_link, judge_settings, see_dark
from appliance.bringup.finding import Finding
from appliance.bringup.guide import StepOutcome
from appliance.bringup.guide_page import side_by_side
from appliance.bringup.person import MOST_ASKED, numbered
from appliance.bringup.plots import png
from appliance.bringup.triggers import PULSES
from appliance.config.rig import CameraRig
from appliance.instrument import noise_of
from appliance.scan.sides import SIDES, of_side
from appliance.service.bringup.trigger import fired, trigger_findings
from appliance.service.bringup.workplace import Workplace, refusal
from appliance.service.checkup import ask_devices
from appliance.service.devices import Devices
from appliance.service.light_bench import LightBench, bench_on
from drivers.api import Camera, CameraSettings, DeviceError, HeldSetting, Projector, ReadsBack

DARK_FRAMES = 16
"""Frames of which a pixel's noise is known to a fifth, and that of all of them exactly."""
PATIENCE_S = 60.0
PAUSE_S = 0.5
SHORT_US = 500
"""Exposure in which there is next to no light; pulses of 500 µs pass every opto-coupler."""
STRETCHED = 8
"""Factor by which a dark picture is brightened for the page."""


def cameras_step(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError."""
    names = [f"camera.{side}" for side in SIDES]
    asked = ask_devices(at.rig, at.wires, names)
    findings = [
        Finding(one.device, one.ok, one.summary, "what `kingfisher check` wants", "" if one.ok else one.summary)
        for one in asked
    ]
    tables: dict[str, tuple[Mapping[str, object], ...]] = {
        "As they say": side_by_side("", {one.device: one.details for one in asked})
    }
    # Without both there is nothing to be set, and no picture to be taken.
    if not all(one.ok for one in findings):
        return StepOutcome(tuple(findings), tables)
    read: dict[str, dict[str, str]] = {}
    for side in SIDES:
        found, held = _set_up(at, side)
        findings += found
        read[f"camera.{side}"] = {one.feature: _shown(one) for one in held}
    if any(read.values()):
        tables["Settings, read back"] = side_by_side("feature", read)
    if not all(one.ok for one in findings):
        return StepOutcome(tuple(findings), tables)
    with bench_on(at.rig, at.wires) as bench:
        more, pictures = _dark(at, bench)
    return StepOutcome((*findings, *more), tables, pictures)


def _set_up(at: Workplace, side: str) -> tuple[list[Finding], tuple[HeldSetting, ...]]:
    """Set one camera as every scan does, and return what it holds."""

    def nothing_to_load(_projector: Projector) -> None:
        """The projector is not opened here."""

    with Devices(at.rig, at.wires, nothing_to_load) as devices:
        # One by itself: a camera that refuses a setting must not hide what the other one holds.
        try:
            with devices.open_camera(side) as camera:
                return _settled(camera, side, of_side(at.rig.camera, side))
        except DeviceError as error:
            return [refusal(error)], ()


def _settled(camera: Camera, side: str, spec: CameraRig) -> tuple[list[Finding], tuple[HeldSetting, ...]]:
    link = judge_link(side, camera.identity.link_speed_mbps, camera.slow_link)
    if not link.ok:
        return [link], ()
    camera.configure(CameraSettings(spec.width_px, spec.height_px, 1000.0 * spec.exposure_ms, spec.gain_db))
    held = _held(camera)
    if held is None:
        said = "this family of cameras cannot be asked for its settings"
        return [link, Finding(f"camera.{side} settings", True, said)], ()
    return [link, *judge_settings(side, held)], held


def _held(camera: Camera) -> tuple[HeldSetting, ...] | None:
    return camera.read_back() if isinstance(camera, ReadsBack) else None


def _shown(one: HeldSetting) -> str:
    if one.held is None:
        return "not offered"
    held = f"{one.held:g}" if isinstance(one.held, float) else str(one.held)
    # Asked for and held are nearly always the same; where not, both are wanted.
    return held if one.wanted in (None, one.held) else f"{held} (asked for {one.wanted})"


def _dark(at: Workplace, bench: LightBench) -> tuple[list[Finding], dict[str, tuple[str, bytes]]]:
    """Return what covered cameras see, and pictures of it."""
    clock = at.wires.clock
    for turn in range(MOST_ASKED):
        at.person.tell(numbered("put the caps on both lenses", turn))
        until_ns = clock.now_ns() + int(PATIENCE_S * 1e9)
        while True:
            at.say("waiting for dark images", None)
            short: dict[str, Image] = {}
            # Both lengths: what a longer exposure adds is light, what both have is the black level.
            for exposure_us in (SHORT_US, None):
                report = fired(bench, at.rig, exposure_us)
                if report.fault is not None:
                    # No picture without a trigger: which is wrong is what the next step would say, word for word.
                    return list(trigger_findings(report.ledger)), {}
                frames = {side: bench.frames(side, PULSES)[-DARK_FRAMES:] for side in SIDES}
                short = short or {side: images.copy() for side, images in frames.items()}
            seen = {side: see_dark(images, short[side]) for side, images in frames.items()}
            last = {side: images[-1].copy() for side, images in frames.items()}
            if all(one.covered for one in seen.values()):
                return _judged(at, seen), _pictures(last)
            if clock.now_ns() > until_ns:
                break
            clock.sleep_s(PAUSE_S)
    return _judged(at, seen), _pictures(last)


def _judged(at: Workplace, seen: Mapping[str, DarkSeen]) -> list[Finding]:
    # At the gain of the rig file, at which the pictures were taken.
    noise = noise_of(at.rig)
    found: list[Finding] = []
    for side, one in seen.items():
        found += judge_dark(side, one, of_side(at.rig.camera, side).black_level_dn, of_side(noise, side).read_dn)
    return found


def _pictures(last: Mapping[str, Image]) -> dict[str, tuple[str, bytes]]:
    return {
        f"dark_{side}.png": (
            f"Covered, {STRETCHED} times brighter ({side} camera)",
            png(np.minimum(image.astype(np.uint16) * STRETCHED, 255).astype(np.uint8)),
        )
        for side, image in last.items()
    }
