"""The step ``cameras``: each camera's link, its settings as read back, and its dark images."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from appliance.base import png
from appliance.instrument import Devices, ask_devices
from appliance.measure import SIDES, of_side
from appliance.store import CameraRig, Instrument
from appliance.workshop.bench import Image, LightBench, bench_on
from appliance.workshop.finding import Finding, finding_of
from appliance.workshop.page import side_by_side
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered_request, refusal
from appliance.workshop.trigger import PULSES, fire_triggers, trigger_findings
from drivers.api import Camera, CameraSettings, DeviceError, FeatureValue, HeldSetting, Projector, ReadsBack

DARK_FRAMES = 16
"""Number of frames: the noise of one pixel is known to a fifth, that of all pixels exactly."""
PATIENCE_S = 60.0
PAUSE_S = 0.5
SHORT_US = 500
"""Exposure with next to no light; pulses of 500 µs pass every opto-coupler."""
STRETCHED = 8
"""Factor by which a dark image is brightened for the page."""
ROUNDED = 0.01
"""Share by which a number may differ from its setting: cameras have steps."""
BLACK_OFF_DN = 1.5
"""Largest distance of the black level from that of the rig file."""
CLIPPED_SHARE = 0.2
"""Largest share of pixels at zero: beyond, noise is cut off and the black level unknown."""
MOST_NOISE, NOISE_FLOOR_DN = 2.0, 0.3
"""Limit of the noise: this factor of the data sheet's read noise, plus a floor."""
HOT_DN, MOST_HOT = 20.0, 0.001
"""Grey values above black from which a pixel is hot, and the largest share of hot pixels."""
LIT_DN = 1.5
"""Largest difference of a part of a covered image from its median, and of its median from a short exposure's."""
PARTS = 8
"""Number of parts, in each direction, into which an image is divided to find light."""
LEAST_MBPS = 5000


@dataclass(frozen=True, slots=True)
class DarkFigures:
    """Figures of a camera's images without light."""

    level_dn: float
    """Median of the pixels' means."""
    noise_dn: float
    """Standard deviation over time, RMS of the pixels but the hot ones."""
    hot: float
    """Share of hot pixels."""
    clipped: float
    """Share of grey values that are zero."""
    brightest_dn: float
    """Largest median of a part of the image."""
    rise_dn: float
    """Rise of the median from a short exposure to these frames: only light causes one, a black level does not."""

    @property
    def is_covered(self) -> bool:
        """True if no light reaches the sensor."""
        return max(self.rise_dn, self.brightest_dn - self.level_dn) <= LIT_DN


def do(workplace: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError."""
    names = [f"camera.{side}" for side in SIDES]
    checks = ask_devices(workplace.rig, workplace.wires, names)
    findings = [
        Finding(
            check.device, check.ok, check.summary, "as `kingfisher check` requires", "" if check.ok else check.summary
        )
        for check in checks
    ]
    tables: dict[str, tuple[Mapping[str, object], ...]] = {
        "As they say": side_by_side("", {check.device: check.details for check in checks})
    }
    # Settings and images need both cameras.
    if not all(check.ok for check in findings):
        return StepOutcome(tuple(findings), tables)
    held_by_camera: dict[str, dict[str, str]] = {}
    for side in SIDES:
        settings_findings, held = _set_up(workplace, side)
        findings += settings_findings
        held_by_camera[f"camera.{side}"] = {check.feature: _setting_text(check) for check in held}
    if any(held_by_camera.values()):
        tables["Settings, read back"] = side_by_side("feature", held_by_camera)
    if not all(check.ok for check in findings):
        return StepOutcome(tuple(findings), tables)
    with bench_on(workplace.rig, workplace.wires) as bench:
        dark_findings, pictures = _dark(workplace, bench)
    return StepOutcome((*findings, *dark_findings), tables, pictures)


def _set_up(workplace: Workplace, side: str) -> tuple[list[Finding], tuple[HeldSetting, ...]]:
    """Set one camera as every scan does, and return its findings and the settings that it holds."""

    def nothing_to_load(_projector: Projector) -> None:
        """Load no pictures: the projector is not opened here."""

    with Devices(workplace.rig, workplace.wires, nothing_to_load) as devices:
        # One camera at a time: if it refuses a setting, the other one is read back all the same.
        try:
            with devices.open_camera(side) as camera:
                return _configure(camera, side, of_side(workplace.rig.camera, side))
        except DeviceError as error:
            return [refusal(error)], ()


def _configure(camera: Camera, side: str, spec: CameraRig) -> tuple[list[Finding], tuple[HeldSetting, ...]]:
    link = judge_link(side, camera.identity.link_speed_mbps, camera.slow_link)
    if not link.ok:
        return [link], ()
    camera.configure(CameraSettings(spec.width_px, spec.height_px, 1000.0 * spec.exposure_ms, spec.gain_db))
    held = _read_back(camera)
    if held is None:
        statement = "this family of cameras does not report its settings"
        return [link, Finding(f"camera.{side} settings", True, statement)], ()
    return [link, *judge_settings(side, held)], held


def _read_back(camera: Camera) -> tuple[HeldSetting, ...] | None:
    return camera.read_back() if isinstance(camera, ReadsBack) else None


def _setting_text(setting: HeldSetting) -> str:
    if setting.held is None:
        return "not offered"
    held = f"{setting.held:g}" if isinstance(setting.held, float) else str(setting.held)
    # Both values are shown only where they differ, which is rare.
    return held if setting.requested in (None, setting.held) else f"{held} (asked for {setting.requested})"


def _dark(workplace: Workplace, bench: LightBench) -> tuple[list[Finding], dict[str, tuple[str, bytes]]]:
    """Record covered cameras, and return their findings and images."""
    clock = workplace.wires.clock
    for attempt in range(MOST_ASKED):
        workplace.person.tell(numbered_request("put the caps on both lenses", attempt))
        until_ns = clock.now_ns() + int(PATIENCE_S * 1e9)
        while True:
            workplace.say("waiting for dark images")
            short: dict[str, Image] = {}
            # Two exposure times: light grows with the exposure time, the black level does not.
            for exposure_us in (SHORT_US, None):
                report = fire_triggers(bench, workplace.rig, exposure_us)
                if report.fault is not None:
                    # Without a trigger there is no image; report the findings of the next step instead.
                    return list(trigger_findings(report.ledger)), {}
                frames = {side: bench.frames(side, PULSES)[-DARK_FRAMES:] for side in SIDES}
                short = short or {side: images.copy() for side, images in frames.items()}
            figures = {side: see_dark(images, short[side]) for side, images in frames.items()}
            last = {side: images[-1].copy() for side, images in frames.items()}
            if all(camera_figures.is_covered for camera_figures in figures.values()):
                return _dark_findings(workplace, figures), _pictures(last)
            if clock.now_ns() > until_ns:
                break
            clock.sleep_s(PAUSE_S)
    return _dark_findings(workplace, figures), _pictures(last)


def _dark_findings(workplace: Workplace, figures: Mapping[str, DarkFigures]) -> list[Finding]:
    # At the gain of the rig file, with which the images were taken.
    noise = Instrument(workplace.rig).noise()
    findings: list[Finding] = []
    for side, camera_figures in figures.items():
        findings += judge_dark(
            side, camera_figures, of_side(workplace.rig.camera, side).black_level_dn, of_side(noise, side).read_dn
        )
    return findings


def _pictures(last: Mapping[str, Image]) -> dict[str, tuple[str, bytes]]:
    return {
        f"dark_{side}.png": (
            f"Covered, {STRETCHED} times brighter ({side} camera)",
            png(np.minimum(image.astype(np.uint16) * STRETCHED, 255).astype(np.uint8)),
        )
        for side, image in last.items()
    }


def see_dark(frames: Image, short: Image) -> DarkFigures:
    """Return the figures of images (n, h, w) uint8 of one camera, n >= 2.

    ``short`` (m, h, w) were exposed for a fraction of the time.
    """
    total, squares = np.zeros((2, *frames.shape[1:]))
    # One frame at a time: as float64 all of them would fill a gigabyte.
    for frame in frames:
        values = frame.astype(np.float64)
        total += values
        squares += values**2
    mean = total / len(frames)
    variance = np.maximum(squares / len(frames) - mean**2, 0.0) * len(frames) / (len(frames) - 1)
    level_dn = float(np.median(mean))
    hot = mean > level_dn + HOT_DN
    # In parts: a light leak beside the lens lights one corner, which does not change the median of the whole image.
    rows, columns = (np.linspace(0, size, PARTS + 1).astype(int) for size in mean.shape)
    # Medians, so that hot pixels do not count as light.
    parts = [
        float(np.median(mean[rows[j] : rows[j + 1], columns[k] : columns[k + 1]]))
        for j in range(PARTS)
        for k in range(PARTS)
    ]
    calm = variance[~hot] if not hot.all() else variance
    return DarkFigures(
        level_dn,
        math.sqrt(float(calm.mean())),
        float(hot.mean()),
        float((frames == 0).mean()),
        max(parts),
        level_dn - float(np.median(short.mean(axis=0))),
    )


def judge_dark(side: str, figures: DarkFigures, black_level_dn: float, expected_dn: float) -> tuple[Finding, ...]:
    """Judge a covered camera by light, black level, noise and hot pixels.

    ``black_level_dn`` is the rig file's; ``expected_dn`` is the standard deviation that a dark grey value should have,
    with rounding.
    """
    name = f"camera.{side}"
    return (
        _light(name, figures),
        _black(name, figures, black_level_dn),
        _noise(name, figures, expected_dn),
        _hot(name, figures),
    )


def _light(name: str, figures: DarkFigures) -> Finding:
    above_dn = figures.brightest_dn - figures.level_dn
    statement = f"the longer exposure is {figures.rise_dn:.1f} grey values brighter than a short one, the brightest part {above_dn:.1f} above the rest"
    remedy = "put the cap on, darken the room, look for light between lens and sensor and for LEDs inside"
    numbers = {"rise_dn": figures.rise_dn, "above_dn": above_dn}
    return finding_of(f"{name} light", figures.is_covered, statement, f"up to {LIT_DN:g}", remedy, **numbers)


def _black(name: str, figures: DarkFigures, expected_dn: float) -> Finding:
    limits = f"{expected_dn:g} ± {BLACK_OFF_DN:g} (black_level_dn), at most {100.0 * CLIPPED_SHARE:g} % at zero"
    numbers = {"level_dn": figures.level_dn, "at_zero_percent": 100.0 * figures.clipped}
    statement, remedy = f"black is {figures.level_dn:.2f} grey values; {100.0 * figures.clipped:.0f} % are zero", ""
    if expected_dn > 0.0 and figures.clipped > CLIPPED_SHARE:
        remedy = f"raise BlackLevel under features of [{name}]: what is cut off at zero bends dark fringes"
    elif abs(figures.level_dn - expected_dn) > BLACK_OFF_DN:
        remedy = f"set BlackLevel under features of [{name}], or black_level_dn of [{name}] to {figures.level_dn:.1f}"
    return finding_of(f"{name} black", not remedy, statement, limits, remedy, **numbers)


def _noise(name: str, figures: DarkFigures, expected_dn: float) -> Finding:
    limit_dn = MOST_NOISE * expected_dn + NOISE_FLOOR_DN
    limits = f"above 0, up to {limit_dn:.2f} (of the rig file's read_noise_e and full_well_e: {expected_dn:.2f})"
    statement, remedy = f"a pixel's noise is {figures.noise_dn:.2f} grey values", ""
    if figures.noise_dn == 0.0:
        remedy = "the images are all alike: switch the test pattern off, and raise the black level above zero"
    elif figures.noise_dn > limit_dn:
        remedy = f"switch gamma, tables and automatic gain off; set gain_db, read_noise_e and full_well_e of [{name}] as in the data sheet"
    return finding_of(f"{name} noise", not remedy, statement, limits, remedy, noise_dn=figures.noise_dn)


def _hot(name: str, figures: DarkFigures) -> Finding:
    percent, most_percent = 100.0 * figures.hot, 100.0 * MOST_HOT
    statement = f"{percent:.3f} % of the pixels are more than {HOT_DN:g} grey values above black"
    remedy = "let the camera cool down; switch its defect correction on; exchange it"
    ok = figures.hot <= MOST_HOT
    return finding_of(f"{name} hot pixels", ok, statement, f"up to {most_percent:g} %", remedy, hot_percent=percent)


def judge_link(side: str, link_mbps: int | None, slow: str | None) -> Finding:
    """Judge the speed of a camera's link; ``slow`` is the driver's objection to it."""
    statement = slow or ("its speed is not known" if link_mbps is None else f"{link_mbps} Mbit/s")
    remedy = "plug the camera into a USB 3 port of its own, with a short cable for SuperSpeed, screwed tight"
    return finding_of(
        f"camera.{side} link", slow is None, statement, f"{LEAST_MBPS} Mbit/s and more", remedy, mbps=link_mbps
    )


def judge_settings(side: str, held: Sequence[HeldSetting]) -> tuple[Finding, Finding]:
    """Judge the settings that a camera holds, and whether its grey values are proportional to light."""
    name = f"camera.{side}"
    assigned = [setting for setting in held if setting.requested is not None]
    wrong = [setting for setting in assigned if not _alike(setting.requested, setting.held)]
    missing = [setting.feature for setting in held if setting.held is None]
    not_offered = f"; not offered: {', '.join(missing)}" if missing else ""
    statement = ", ".join(f"{setting.feature} is {setting.held}, not {setting.requested}" for setting in wrong)
    statement = statement or f"all {len(assigned)} settings read back as they were set{not_offered}"
    remedy = f"set them under [{name}.features] of the rig file, in an order that this camera takes"
    numbers: dict[str, float] = {"settings": len(assigned), "different": len(wrong)}
    settings = finding_of(f"{name} settings", not wrong, statement, "each as it was set", remedy, **numbers)
    # Reported even where the rig file sets it: scans assume grey values proportional to light.
    statement, remedy = "no gamma and no table is on", ""
    if tone_features := _tone_features(held):
        statement = f"{' and '.join(tone_features)} bends grey values"
        remedy = (
            f'set "{tone_features[0]}" under [{name}.features]: GammaEnable = false, Gamma = 1.0, LUTEnable = false'
        )
    return settings, finding_of(f"{name} tone", not remedy, statement, "gamma 1 or off, tables off", remedy)


def _tone_features(held: Sequence[HeldSetting]) -> list[str]:
    """Return the names of features that make grey values no longer proportional to light."""
    values = {setting.feature: setting.held for setting in held}
    names = [name for name in ("GammaEnable", "LUTEnable") if values.get(name) is True]
    gamma = values.get("Gamma")
    # Where gamma is switched off, its value has no effect.
    if isinstance(gamma, float) and abs(gamma - 1.0) > ROUNDED and values.get("GammaEnable") is not False:
        names.append("Gamma")
    return names


def _alike(expected: FeatureValue | None, held: FeatureValue | None) -> bool:
    if expected is None or held is None or isinstance(expected, bool | str) or isinstance(held, bool | str):
        return expected == held
    return abs(held - expected) <= ROUNDED * abs(expected)
