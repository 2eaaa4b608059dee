"""Owns what a camera must hold of its settings, and what it must see of no light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from appliance.bringup.bench import Image
from appliance.bringup.finding import Finding
from drivers.api import FeatureValue, HeldSetting

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


def see_dark(frames: Image, short: Image) -> DarkSeen:
    """Return the figures of images (n, h, w) uint8 of one camera, n >= 2; ``short`` (m, h, w) were exposed for a fraction of the time."""
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
    """Judge a covered camera: its black level against that of the rig file, its noise against the data sheet's, its pixels.

    ``expected_dn`` is the standard deviation that a dark grey value should have, rounding included.
    """
    name = f"camera.{side}"
    most_dn = MOST_NOISE * expected_dn + NOISE_FLOOR_DN
    return (
        _light(name, seen),
        _black(name, seen, black_level_dn),
        _noise(name, seen, expected_dn, most_dn),
        Finding(
            f"{name} hot pixels",
            seen.hot <= MOST_HOT,
            f"{100.0 * seen.hot:.3f} % of the pixels are more than {HOT_DN:g} grey values above black",
            f"up to {100.0 * MOST_HOT:g} %",
            "" if seen.hot <= MOST_HOT else "let the camera cool down; switch its defect correction on; exchange it",
            {"hot_percent": 100.0 * seen.hot},
        ),
    )


def _light(name: str, seen: DarkSeen) -> Finding:
    above_dn, ok = seen.brightest_dn - seen.level_dn, seen.covered
    said = f"the longer exposure is {seen.rise_dn:.1f} grey values brighter than a short one, the brightest part {above_dn:.1f} above the rest"
    remedy = "" if ok else "put the cap on, darken the room, look for light between lens and sensor and for LEDs inside"
    numbers: dict[str, float | None] = {"rise_dn": seen.rise_dn, "above_dn": above_dn}
    return Finding(f"{name} light", ok, said, f"up to {LIT_DN:g}", remedy, numbers)


def _black(name: str, seen: DarkSeen, wanted_dn: float) -> Finding:
    limits = f"{wanted_dn:g} ± {BLACK_OFF_DN:g} (black_level_dn), at most {100.0 * CLIPPED_SHARE:g} % at zero"
    numbers: dict[str, float | None] = {"level_dn": seen.level_dn, "at_zero_percent": 100.0 * seen.clipped}
    said = f"black is {seen.level_dn:.2f} grey values; {100.0 * seen.clipped:.0f} % are zero"
    if wanted_dn > 0.0 and seen.clipped > CLIPPED_SHARE:
        remedy = f"raise BlackLevel under features of [{name}]: what is cut off at zero bends dark fringes"
        return Finding(f"{name} black", False, said, limits, remedy, numbers)
    if abs(seen.level_dn - wanted_dn) > BLACK_OFF_DN:
        remedy = f"set BlackLevel under features of [{name}], or black_level_dn of [{name}] to {seen.level_dn:.1f}"
        return Finding(f"{name} black", False, said, limits, remedy, numbers)
    return Finding(f"{name} black", True, said, limits, "", numbers)


def _noise(name: str, seen: DarkSeen, expected_dn: float, most_dn: float) -> Finding:
    limits = f"above 0, up to {most_dn:.2f} (of the rig file's read_noise_e and full_well_e: {expected_dn:.2f})"
    numbers: dict[str, float | None] = {"noise_dn": seen.noise_dn}
    said = f"a pixel's noise is {seen.noise_dn:.2f} grey values"
    if seen.noise_dn == 0.0:
        remedy = "the images are all alike: switch the test pattern off, and raise the black level above zero"
        return Finding(f"{name} noise", False, said, limits, remedy, numbers)
    ok = seen.noise_dn <= most_dn
    remedy = (
        ""
        if ok
        else f"switch gamma, tables and automatic gain off; set gain_db, read_noise_e and full_well_e of [{name}] as in the data sheet"
    )
    return Finding(f"{name} noise", ok, said, limits, remedy, numbers)


def judge_link(side: str, link_mbps: int | None, slow: str | None) -> Finding:
    """Judge the speed of a camera's link; ``slow`` is what the driver says against it."""
    name, limits = f"camera.{side} link", f"{LEAST_MBPS} Mbit/s and more"
    if slow is not None:
        remedy = "plug the camera into a USB 3 port of its own, with a short cable for SuperSpeed, screwed tight"
        return Finding(name, False, slow, limits, remedy, {"mbps": _number(link_mbps)})
    said = "its speed is not known" if link_mbps is None else f"{link_mbps} Mbit/s"
    return Finding(name, True, said, limits, "", {"mbps": _number(link_mbps)})


def judge_settings(side: str, held: Sequence[HeldSetting]) -> tuple[Finding, Finding]:
    """Judge what a camera holds of its settings, and whether its grey values are light."""
    name = f"camera.{side}"
    made = [one for one in held if one.wanted is not None]
    wrong = [one for one in made if not _alike(one.wanted, one.held)]
    shown = ", ".join(f"{one.feature} is {one.held}, not {one.wanted}" for one in wrong)
    missing = [one.feature for one in held if one.held is None]
    told = f"; not offered: {', '.join(missing)}" if missing else ""
    settings = Finding(
        f"{name} settings",
        not wrong,
        shown or f"all {len(made)} settings read back as they were set{told}",
        "each as it was set",
        f"set them under [{name}.features] of the rig file, in an order that this camera takes" if wrong else "",
        {"settings": float(len(made)), "different": float(len(wrong))},
    )
    # Whoever asked for it is told all the same: scans take grey values for light.
    bent = _bent(held)
    remedy = (
        f'set "{bent[0]}" under [{name}.features]: GammaEnable = false, Gamma = 1.0, LUTEnable = false' if bent else ""
    )
    said = f"{' and '.join(bent)} bends grey values" if bent else "no gamma and no table is on"
    return settings, Finding(f"{name} tone", not bent, said, "gamma 1 or off, tables off", remedy)


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


def _number(value: int | None) -> float | None:
    return None if value is None else float(value)
