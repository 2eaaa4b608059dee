"""Owns the step ``cameras``: each one's link, what it holds of its settings, and what both see with their caps on."""

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
from appliance.workshop.finding import Finding, judged
from appliance.workshop.page import side_by_side
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered, refusal
from appliance.workshop.trigger import PULSES, fired, trigger_findings
from drivers.api import Camera, CameraSettings, DeviceError, FeatureValue, HeldSetting, Projector, ReadsBack

DARK_FRAMES = 16
"""Frames of which a pixel's noise is known to a fifth, and that of all of them exactly."""
PATIENCE_S = 60.0
PAUSE_S = 0.5
SHORT_US = 500
"""Exposure in which there is next to no light; pulses of 500 µs pass every opto-coupler."""
STRETCHED = 8
"""Factor by which a dark picture is brightened for the page."""
ROUNDED = 0.01
"""Share by which a number may differ from what was asked for: cameras have steps."""
BLACK_OFF_DN = 1.5
"""Largest distance of the black level from that of the rig file."""
CLIPPED_SHARE = 0.2
"""Largest share of pixels at zero: from there on noise is cut off, and the black level is not known."""
MOST_NOISE, NOISE_FLOOR_DN = 2.0, 0.3
"""Factor of the data sheet's read noise that is taken, and what may be added to it."""
HOT_DN, MOST_HOT = 20.0, 0.001
"""Grey values above black from which a pixel is hot, and the largest share of those."""
LIT_DN = 1.5
"""Grey values that no part of a covered image is above its median, nor above a short exposure's."""
PARTS = 8
"""Parts of an image, each way, in which light is looked for."""
LEAST_MBPS = 5000


@dataclass(frozen=True, slots=True)
class DarkSeen:
    """Figures of a camera's images of no light."""

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
    """Median's rise from a short exposure to these: light does that, a black level does not."""

    @property
    def covered(self) -> bool:
        """True if no light falls in."""
        return max(self.rise_dn, self.brightest_dn - self.level_dn) <= LIT_DN


def do(at: Workplace) -> StepOutcome:
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
            at.say("waiting for dark images")
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
    noise = Instrument(at.rig).noise()
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


def see_dark(frames: Image, short: Image) -> DarkSeen:
    """Return the figures of images (n, h, w) uint8 of one camera, n >= 2; ``short`` (m, h, w) were exposed for a
    fraction of the time."""
    total, squares = np.zeros((2, *frames.shape[1:]))
    # One after the other: as floating numbers all of them would fill a gigabyte.
    for frame in frames:
        values = frame.astype(np.float64)
        total += values
        squares += values**2
    mean = total / len(frames)
    variance = np.maximum(squares / len(frames) - mean**2, 0.0) * len(frames) / (len(frames) - 1)
    level_dn = float(np.median(mean))
    hot = mean > level_dn + HOT_DN
    # In parts: a leak beside the lens lights one corner, and the median of all knows nothing of it.
    rows, columns = (np.linspace(0, size, PARTS + 1).astype(int) for size in mean.shape)
    # Medians: a hot pixel is no light.
    parts = [
        float(np.median(mean[rows[j] : rows[j + 1], columns[k] : columns[k + 1]]))
        for j in range(PARTS)
        for k in range(PARTS)
    ]
    calm = variance[~hot] if not hot.all() else variance
    return DarkSeen(
        level_dn,
        math.sqrt(float(calm.mean())),
        float(hot.mean()),
        float((frames == 0).mean()),
        max(parts),
        level_dn - float(np.median(short.mean(axis=0))),
    )


def judge_dark(side: str, seen: DarkSeen, black_level_dn: float, expected_dn: float) -> tuple[Finding, ...]:
    """Judge a covered camera: light, black level against the rig file's, noise against the data sheet's, hot pixels.

    ``expected_dn`` is the standard deviation that a dark grey value should have, rounding included.
    """
    name = f"camera.{side}"
    return _light(name, seen), _black(name, seen, black_level_dn), _noise(name, seen, expected_dn), _hot(name, seen)


def _light(name: str, seen: DarkSeen) -> Finding:
    above_dn = seen.brightest_dn - seen.level_dn
    said = f"the longer exposure is {seen.rise_dn:.1f} grey values brighter than a short one, the brightest part {above_dn:.1f} above the rest"
    remedy = "put the cap on, darken the room, look for light between lens and sensor and for LEDs inside"
    numbers = {"rise_dn": seen.rise_dn, "above_dn": above_dn}
    return judged(f"{name} light", seen.covered, said, f"up to {LIT_DN:g}", remedy, **numbers)


def _black(name: str, seen: DarkSeen, wanted_dn: float) -> Finding:
    limits = f"{wanted_dn:g} ± {BLACK_OFF_DN:g} (black_level_dn), at most {100.0 * CLIPPED_SHARE:g} % at zero"
    numbers = {"level_dn": seen.level_dn, "at_zero_percent": 100.0 * seen.clipped}
    said, remedy = f"black is {seen.level_dn:.2f} grey values; {100.0 * seen.clipped:.0f} % are zero", ""
    if wanted_dn > 0.0 and seen.clipped > CLIPPED_SHARE:
        remedy = f"raise BlackLevel under features of [{name}]: what is cut off at zero bends dark fringes"
    elif abs(seen.level_dn - wanted_dn) > BLACK_OFF_DN:
        remedy = f"set BlackLevel under features of [{name}], or black_level_dn of [{name}] to {seen.level_dn:.1f}"
    return judged(f"{name} black", not remedy, said, limits, remedy, **numbers)


def _noise(name: str, seen: DarkSeen, expected_dn: float) -> Finding:
    most_dn = MOST_NOISE * expected_dn + NOISE_FLOOR_DN
    limits = f"above 0, up to {most_dn:.2f} (of the rig file's read_noise_e and full_well_e: {expected_dn:.2f})"
    said, remedy = f"a pixel's noise is {seen.noise_dn:.2f} grey values", ""
    if seen.noise_dn == 0.0:
        remedy = "the images are all alike: switch the test pattern off, and raise the black level above zero"
    elif seen.noise_dn > most_dn:
        remedy = f"switch gamma, tables and automatic gain off; set gain_db, read_noise_e and full_well_e of [{name}] as in the data sheet"
    return judged(f"{name} noise", not remedy, said, limits, remedy, noise_dn=seen.noise_dn)


def _hot(name: str, seen: DarkSeen) -> Finding:
    percent, most_percent = 100.0 * seen.hot, 100.0 * MOST_HOT
    said = f"{percent:.3f} % of the pixels are more than {HOT_DN:g} grey values above black"
    remedy = "let the camera cool down; switch its defect correction on; exchange it"
    ok = seen.hot <= MOST_HOT
    return judged(f"{name} hot pixels", ok, said, f"up to {most_percent:g} %", remedy, hot_percent=percent)


def judge_link(side: str, link_mbps: int | None, slow: str | None) -> Finding:
    """Judge the speed of a camera's link; ``slow`` is what the driver says against it."""
    said = slow or ("its speed is not known" if link_mbps is None else f"{link_mbps} Mbit/s")
    remedy = "plug the camera into a USB 3 port of its own, with a short cable for SuperSpeed, screwed tight"
    return judged(f"camera.{side} link", slow is None, said, f"{LEAST_MBPS} Mbit/s and more", remedy, mbps=link_mbps)


def judge_settings(side: str, held: Sequence[HeldSetting]) -> tuple[Finding, Finding]:
    """Judge what a camera holds of its settings, and whether its grey values are light."""
    name = f"camera.{side}"
    made = [one for one in held if one.wanted is not None]
    wrong = [one for one in made if not _alike(one.wanted, one.held)]
    missing = [one.feature for one in held if one.held is None]
    told = f"; not offered: {', '.join(missing)}" if missing else ""
    said = ", ".join(f"{one.feature} is {one.held}, not {one.wanted}" for one in wrong)
    said = said or f"all {len(made)} settings read back as they were set{told}"
    remedy = f"set them under [{name}.features] of the rig file, in an order that this camera takes"
    numbers: dict[str, float] = {"settings": len(made), "different": len(wrong)}
    settings = judged(f"{name} settings", not wrong, said, "each as it was set", remedy, **numbers)
    # Whoever asked for it is told all the same: scans take grey values for light.
    said, remedy = "no gamma and no table is on", ""
    if bent := _bent(held):
        said = f"{' and '.join(bent)} bends grey values"
        remedy = f'set "{bent[0]}" under [{name}.features]: GammaEnable = false, Gamma = 1.0, LUTEnable = false'
    return settings, judged(f"{name} tone", not remedy, said, "gamma 1 or off, tables off", remedy)


def _bent(held: Sequence[HeldSetting]) -> list[str]:
    """Return the names of what bends grey values."""
    values = {one.feature: one.held for one in held}
    found = [name for name in ("GammaEnable", "LUTEnable") if values.get(name) is True]
    gamma = values.get("Gamma")
    # Where it can be switched off and is, its number says nothing.
    if isinstance(gamma, float) and abs(gamma - 1.0) > ROUNDED and values.get("GammaEnable") is not False:
        found.append("Gamma")
    return found


def _alike(wanted: FeatureValue | None, held: FeatureValue | None) -> bool:
    if wanted is None or held is None or isinstance(wanted, bool | str) or isinstance(held, bool | str):
        return wanted == held
    return abs(held - wanted) <= ROUNDED * abs(wanted)
