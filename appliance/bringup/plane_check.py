"""Owns what the first scan of a plane must be like: fringes that are sines, light that is neither cut off nor missing, a flat cloud."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.bringup.bench import Image
from appliance.bringup.finding import Finding
from appliance.bringup.plane_ripple import CYCLES, CoordinateRipple, SmoothPlane
from appliance.bringup.response_check import ResponseShape, Shape, judge_response
from appliance.evaluation.flatness import Flatness
from appliance.patterns.sequence import Direction, PatternSequence
from appliance.scan.exposure import Exposure

LIMITS_PER_PERIOD = (1.0 / 800.0, 1.0 / 800.0, 1.0 / 128.0)
"""Largest amplitudes at one, two and four cycles a period, in periods. The last is larger, as each scan straightens it."""
MOST_SATURATED = 0.01
SATURATED_DN = 254
LEAST_FILLED = 0.3
"""Least share of the image that must see the plane: the rest is not known."""
MOST_FLATNESS = 0.02
"""Largest flatness error of a plane, as a share of the reference length: a calibration that is of this instrument is better by far."""
CODES = 64
"""Parts of the codes for which the light is averaged."""
FEWEST_IN_CODE = 8
_CURVED = {
    Shape.GAMMA: "gamma: switch it off in the projector and in the graphics driver, or measure it with `kingfisher measure response {scan}`",
    Shape.BIT_PLANES: "cut bit planes: take only exposures that step light found, and do step light again after any change of the projector's mode",
    Shape.RESTLESS: "light that differs from place to place or image to image: dynamic contrast and dither off, no other light, a still plane",
}


@dataclass(frozen=True, slots=True)
class PlaneSeen:
    """Everything that a scan of a plane says about the instrument."""

    scan: str
    """Number under which it is stored."""
    period_px: int
    ripple: Mapping[str, CoordinateRipple]
    """Ripple by camera and coordinate, ``left x``."""
    filled: Mapping[str, float]
    """Share of each camera's pixels that have both coordinates."""
    exposure: Exposure
    """Exposure that it was taken with."""
    saturated: Mapping[str, float]
    """Share of the lit pixels of each camera's brightest image that are saturated."""
    response: ResponseShape | None
    """Response of the light by code; ``None``: too little was seen of it."""
    flatness: Flatness | None
    """``None``: there is no calibration, or no plane was found with it."""
    why_not_flat: str = ""
    """Reason for that."""
    faults: tuple[str, ...] = ()
    """Words of the judges that refuse the scan."""


def judge_plane(seen: PlaneSeen) -> tuple[Finding, ...]:
    """Judge a scan of a plane: light, response, ripple, flatness, and what the instrument's own judges say."""
    return (_filled(seen), _clipping(seen), _response(seen), *_ripples(seen), _flat(seen), _judges(seen))


def next_exposure(exposures: Sequence[Exposure], now: Exposure, saturated: float) -> Exposure | None:
    """Return the exposure to try after one that saturated so much of the lit image; ``None``: none is needed, or none is left.

    ``exposures`` are those that the rig file allows. Half of the light at most: how far beyond saturation it was, nobody knows.
    """
    if saturated <= MOST_SATURATED:
        return None
    darker = sorted((one for one in exposures if one.light < now.light), key=lambda one: one.light)
    halves = [one for one in darker if one.light <= 0.5 * now.light]
    if halves:
        return halves[-1]
    return darker[0] if darker else None


def curve_of(
    sequence: PatternSequence, frames: Image, planes: Mapping[Direction, SmoothPlane]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return codes (n,) and the light that was seen of them, as shares of bright over dark, (n,), by even and by odd rows.

    ``frames`` (count, h, w) are one camera's of a sequence drawn without a response. n is 0 where too little was seen.
    """
    # By code, not by phase: what a code makes of light is the same wherever it is drawn.
    edges = np.linspace(0.0, 256.0, CODES + 1)
    counts, sums = np.zeros((2, CODES)), np.zeros((2, CODES))
    codes = np.zeros(CODES)
    for direction, plane in planes.items():
        at = plane.rows, plane.columns
        dark = frames[sequence.dark][at].astype(np.float64)
        span = frames[sequence.bright][at] - dark
        use = (span > 40.0) & (frames[sequence.bright][at] < SATURATED_DN)
        axis = sequence.axis(direction)
        for number in axis.sine:
            table = sequence.patterns[number].codes().astype(np.float64)
            code = np.interp(plane.smooth_px[use], np.arange(len(table)), table)
            share = (frames[number][at][use] - dark[use]) / span[use]
            part = np.clip(np.digitize(code, edges) - 1, 0, CODES - 1)
            # Two halves of one image stand for two passes: what differs between them is no response.
            half = plane.rows[use] % 2
            np.add.at(counts, (half, part), 1.0)
            np.add.at(sums, (half, part), share)
            np.add.at(codes, part, code)
    total = counts.sum(axis=0)
    good = counts.min(axis=0) >= FEWEST_IN_CODE
    mean = sums[:, good] / np.maximum(counts[:, good], 1.0)
    return codes[good] / np.maximum(total[good], 1.0), mean[0], mean[1]


def judge_curve(
    codes: NDArray[np.float64], even: NDArray[np.float64], odd: NDArray[np.float64]
) -> ResponseShape | None:
    """Judge light (n,) by codes (n,), rising, that two halves of an image saw; ``None`` where codes are too few to tell."""
    if len(codes) < CODES // 2:
        return None
    # Fringes use the codes between their ends, and blur makes the range smaller: of those they make 0 and 255.
    spread = 255.0 * (codes - codes[0]) / (codes[-1] - codes[0])
    return judge_response(spread, 255.0 * even, 255.0 * odd)


def _filled(seen: PlaneSeen) -> Finding:
    side, least = min(seen.filled.items(), key=lambda one: one[1])
    said = " and ".join(f"{100.0 * share:.0f} % of the {one} image" for one, share in seen.filled.items())
    ok = least >= LEAST_FILLED
    remedy = (
        ""
        if ok
        else f"the {side} camera sees too little: bring the plane to the working distance and upright, light it more, see step raster"
    )
    numbers: dict[str, float | None] = {f"{one}_percent": 100.0 * share for one, share in seen.filled.items()}
    return Finding("plane", ok, f"fringes were read in {said}", f"{100.0 * LEAST_FILLED:g} % and more", remedy, numbers)


def _clipping(seen: PlaneSeen) -> Finding:
    side, most = max(seen.saturated.items(), key=lambda one: one[1])
    ok = most <= MOST_SATURATED
    said = f"{100.0 * most:.1f} % of what is lit in the {side} image is saturated at {seen.exposure.label}"
    remedy = (
        ""
        if ok
        else "clipping: every allowed exposure is too long for this plane: less gain_db, shorter exposures_ms, a duller plane, no lamp on it"
    )
    return Finding(
        "clipping", ok, said, f"up to {100.0 * MOST_SATURATED:g} %", remedy, {"saturated_percent": 100.0 * most}
    )


def _response(seen: PlaneSeen) -> Finding:
    limits = "straight, or one smooth curve that scans straighten"
    # Fringes that blur away leave next to no codes but the middle ones.
    shape = seen.response
    if shape is None:
        return Finding(
            "response", True, "too little was seen of it to tell: fringes are too fine for these cameras", limits
        )
    numbers: dict[str, float | None] = {"line_percent": 100.0 * shape.line_rms, "power": shape.power}
    said = f"light by code is {shape.shape.value}: {100.0 * shape.line_rms:.1f} % off a straight line, like a power of {shape.power:.2f}"
    return Finding("response", shape.usable, said, limits, "" if shape.usable else _cause(seen), numbers)


def _ripples(seen: PlaneSeen) -> list[Finding]:
    found = []
    for k, (cycles, share) in enumerate(zip(CYCLES, LIMITS_PER_PERIOD, strict=True)):
        limit_px = share * seen.period_px
        numbers: dict[str, float | None] = {
            f"{name.replace(' ', '_')}_px": one.amplitude_px[k] for name, one in seen.ripple.items()
        }
        name, limits = f"ripple {cycles}x", f"up to {limit_px:.3f} px"
        if not seen.ripple:
            said, remedy = "no plane was found in either image", "let nothing but the plane be in the picture"
            found.append(Finding(name, False, said, limits, remedy))
            continue
        where, worst = max(seen.ripple.items(), key=lambda one: one[1].amplitude_px[k])
        amplitude_px = worst.amplitude_px[k]
        # What noise alone makes of an amplitude is no ripple.
        ok = amplitude_px <= limit_px + 3.0 * worst.uncertainty_px
        said = f"{amplitude_px:.4f} px at {cycles} cycle{'s' if cycles > 1 else ''} a fringe ({where} is the worst)"
        found.append(Finding(name, ok, said, limits, "" if ok else _remedy(seen, cycles), numbers))
    return found


def _remedy(seen: PlaneSeen, cycles: int) -> str:
    match cycles:
        case 1:
            return "light is added to some images: daylight and lamps off; black level and ambient light steady; dynamic contrast off"
        case 2:
            return (
                "images are unequally bright, or show a part of the picture before: step latency and step light again; "
                "shorter exposures; both cameras' overlap; dynamic contrast off"
            )
        case _:
            return _cause(seen)


def _cause(seen: PlaneSeen) -> str:
    """Name what makes fringes no sines, most telling first."""
    if max(seen.saturated.values(), default=0.0) > MOST_SATURATED:
        return "clipping: a shorter exposure, less gain, a duller plane"
    if seen.response is not None and seen.response.shape in _CURVED:
        return _CURVED[seen.response.shape].format(scan=seen.scan)
    return f"the light is no sine: measure its response (`kingfisher measure response {seen.scan}`), and see gamma, exposures and focus"


def _flat(seen: PlaneSeen) -> Finding:
    limits = f"flatness error up to {100.0 * MOST_FLATNESS:g} % of the reference length"
    if seen.flatness is None:
        return Finding("flatness", True, f"not measured: {seen.why_not_flat}", limits)
    flat = seen.flatness
    ok = flat.e_f_sys <= MOST_FLATNESS
    said = f"the cloud's systematic flatness error is {flat.sys_range_mm:.2f} mm ({100.0 * flat.e_f_sys:.2f} %)"
    if flat.noise_mm is not None:
        said += f", its noise {flat.noise_mm:.3f} mm"
    numbers: dict[str, float | None] = {
        "e_f_percent": 100.0 * flat.e_f,
        "e_f_sys_percent": 100.0 * flat.e_f_sys,
        "noise_mm": flat.noise_mm,
    }
    return Finding("flatness", ok, said, limits, "" if ok else "calibrate: docs/calibration.md", numbers)


def _judges(seen: PlaneSeen) -> Finding:
    limits = "nothing that refuses the scan"
    if not seen.faults:
        return Finding("judges", True, f"scan {seen.scan} is stored; nothing speaks against it", limits)
    return Finding("judges", False, "; ".join(seen.faults), limits, "the page docs/faults.md has each with its remedy")
