"""Owns the step ``plane``: one scan of a plane, recorded, stored and worked through as any scan is.

Its fringes must be sines, its light neither cut off nor missing, its cloud flat. A plane's coordinate is a smooth
function of the pixel; fringes are not smooth. So what is left of a polynomial and goes with the fringe's phase θ = 2π
(p + ½)/P is the fringes' own error:

    k = 1   light that is added to some of the four images: ambient light that flickers, images of a lamp that dims
    k = 2   images of unequal brightness or phase: a picture that is seen in the next one's exposure, unequal exposures
    k = 4   a light that is no sine, by its third and fifth harmonic: a curved response, clipping, cut bit planes

(Zuo et al., Opt. Lasers Eng. 109, 2018, section 3: errors of four steps.) Symbols: r are the residuals, c_k, s_k the
regressors cos kθ and sin kθ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

import appliance
from appliance.base import draw_curves, png
from appliance.desk import work_through
from appliance.instrument import CaptureReport, Devices, DrawnPatterns, FrameStore, ScanRecorder, ScanSettings, opened
from appliance.measure import (
    SIDES,
    CameraDecoder,
    Direction,
    Exposure,
    Flatness,
    NotFound,
    PatternSequence,
    fit_plane,
    flatness,
)
from appliance.store import Instrument, Library, ScanError, ScanRecord, SequenceInfo
from appliance.workshop.bench import Image
from appliance.workshop.finding import BringupError, Finding, judged
from appliance.workshop.response import ResponseShape, Shape, judge_response
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered, wall
from drivers.output.gl import open_gl

TRIES = 3
"""Recordings of the scan: a late flip happens, the same fault thrice is one."""
LIT_DN = 20
"""Grey values of a bright image over its dark one from which a pixel is lit."""
LEAST_LIT = 0.2
"""Share of a bright image that must be lit; else the plane is asked for again."""
Frames = dict[str, NDArray[np.uint8]]
LIMITS_PER_PERIOD = (1.0 / 800.0, 1.0 / 800.0, 1.0 / 128.0)
"""Largest amplitudes at one, two and four cycles a period, in periods.

The last is larger, as each scan straightens it.
"""
MOST_SATURATED = 0.01
SATURATED_DN = 254
LEAST_FILLED = 0.3
"""Least share of the image that must see the plane: the rest is not known."""
MOST_FLATNESS = 0.02
"""Largest flatness error of a plane, as a share of the reference length: a calibration that is of this instrument is
better by far."""
CODES = 64
"""Parts of the codes for which the light is averaged."""
FEWEST_IN_CODE = 8
_RIPPLES = {
    1: "light is added to some images: daylight and lamps off; black level and ambient light steady; dynamic contrast off",
    2: "images are unequally bright, or show a part of the picture before: step latency and step light again; "
    "shorter exposures; both cameras' overlap; dynamic contrast off",
}
"""Remedies of a ripple at one and two cycles; four have the causes of a light that is no sine."""
_CURVED = {
    Shape.GAMMA: "gamma: switch it off in the projector and in the graphics driver, or measure it with `kingfisher calibration measure response {scan} --install`",
    Shape.BIT_PLANES: "cut bit planes: take only exposures that step light found, and do step light again after any change of the projector's mode",
    Shape.RESTLESS: "light that differs from place to place or image to image: dynamic contrast and dither off, no other light, a still plane",
}
CYCLES = (1, 2, 4)
DEGREE = 5
"""Degree of the polynomial in column and row: a plane through a lens and a window is smooth to some thousandths of a px
with it."""
MOST_PIXELS = 40_000
FEWEST_PIXELS = 400
ROUNDS, BELONGS = 4, 5.0
"""Rounds in which pixels are left out that lie beyond so many robust standard deviations: edges, dust, what is no
plane."""
FURTHEST = 1.0 / 16.0
"""Largest residual that a ripple makes, in periods: beyond is another surface, or a pixel with a wrong period."""


@dataclass(frozen=True, slots=True)
class CoordinateRipple:
    """Ripple of one coordinate of one camera."""

    amplitude_px: tuple[float, float, float]
    """Amplitudes at one, two and four cycles a period, in pattern px."""
    noise_px: float
    """Standard deviation of a coordinate without them."""
    uncertainty_px: float
    """Standard deviation of an amplitude."""
    pixels: int
    """Pixels that were asked."""


@dataclass(frozen=True, slots=True, eq=False)
class SmoothPlane:
    """The smooth coordinate of a plane, at the pixels that lie on it."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    smooth_px: NDArray[np.float64]
    """(n,) coordinate that the polynomial has there."""
    residual_px: NDArray[np.float64]
    """(n,) measured minus smooth."""


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


@dataclass(frozen=True, slots=True, eq=False)
class _SideDecoded:
    """One camera's part in the scan, decoded."""

    planes: dict[Direction, SmoothPlane]
    filled: float
    saturated: float


def do(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError, GivenUp, StorageError."""
    with open_gl() as gl:
        # The response, if it was measured, is drawn for: what is left of the ripple is what scans have.
        response = Instrument(at.rig).response()
        patterns = DrawnPatterns(gl, at.rig, at.rig.scan.period_px, response)
        sequence = patterns.sequence
        exposure = Instrument(at.rig).exposure
        for turn in range(MOST_ASKED):
            at.person.ask(numbered(wall(at), turn))
            report, frames, exposure = _exposed(
                partial(_recorded, at, patterns), sequence, Instrument(at.rig).exposures, exposure
            )
            if all(_lit(one, sequence).mean() >= LEAST_LIT for one in frames.values()):
                break
    scan_id = _stored(at, report, frames, sequence, exposure, None if response is None else response.hash)
    at.say("decoding")
    sides = {side: _decoded(sequence, frames[side]) for side in SIDES}
    shape, curve = (None, None) if response is not None else _seen_response(sequence, frames, sides)
    flat, why_not, faults = _worked_through(at, scan_id)
    seen = PlaneSeen(
        scan=scan_id,
        period_px=sequence.period_px,
        ripple=_rippled(sides, sequence.period_px),
        exposure=exposure,
        filled={side: one.filled for side, one in sides.items()},
        saturated={side: one.saturated for side, one in sides.items()},
        response=shape,
        flatness=flat,
        why_not_flat=why_not,
        faults=faults,
    )
    pictures = {
        f"plane_{side}.png": (f"The plane in white light ({side} camera)", png(frames[side][sequence.bright]))
        for side in SIDES
    }
    if curve is not None:
        pictures["plane_light.png"] = "Light of the plane by code, as the fringes show it", curve
    return StepOutcome(judge_plane(seen), {}, pictures)


def _exposed(
    record: Callable[[Exposure], tuple[CaptureReport, Frames]],
    sequence: PatternSequence,
    allowed: Sequence[Exposure],
    exposure: Exposure,
) -> tuple[CaptureReport, Frames, Exposure]:
    """Record the plane with the longest of the allowed exposures that does not saturate it, and return which that was."""
    report, frames = record(exposure)
    # The rig file's exposure is that of the dive; a white plane in air is brighter than most of what lies under water.
    for _ in allowed:
        saturated = max(_saturated(one, sequence) for one in frames.values())
        darker = next_exposure(allowed, exposure, saturated)
        if darker is None:
            break
        exposure = darker
        report, frames = record(exposure)
    return report, frames, exposure


def _recorded(at: Workplace, patterns: DrawnPatterns, exposure: Exposure) -> tuple[CaptureReport, Frames]:
    """Record one sequence whose witnesses all agree. Raises DeviceError, BringupError."""
    rig, sequence = at.rig, patterns.sequence
    settings = ScanSettings(
        rig.projector.refresh_hz, exposure.time_us, rig.board.trigger_delay_us, rig.projector.latency_blanks
    )
    left = rig.camera.left
    with (
        FrameStore(len(sequence), left.height_px, left.width_px) as store,
        Devices(rig, at.wires, patterns.load) as devices,
    ):
        grabbers, board, projector = opened(devices, at.wires.clock)
        devices.expose(exposure)
        recorder = ScanRecorder(grabbers, board, projector, at.wires.clock, settings)
        fault = None
        for _ in range(TRIES):
            at.say("scanning")
            report = recorder.record(sequence, store, lambda _side, _index: None, lambda: None)
            fault = report.fault
            if fault is None:
                return report, {side: store.frames(side)[: len(sequence)].copy() for side in SIDES}
    assert fault is not None
    raise BringupError(
        f"{TRIES} scans failed one after the other: {fault.code.value}: {fault.detail}; do step trigger again"
    )


def _lit(frames: NDArray[np.uint8], sequence: PatternSequence) -> NDArray[np.bool_]:
    """Return the pixels (h, w) that the projector lights."""
    bright, dark = (frames[k].astype(np.int16) for k in (sequence.bright, sequence.dark))
    return np.asarray(bright - dark >= LIT_DN)


def _saturated(frames: NDArray[np.uint8], sequence: PatternSequence) -> float:
    """Return the share of what the projector lights that is saturated in its white light."""
    lit = _lit(frames, sequence)
    return float(((frames[sequence.bright] >= SATURATED_DN) & lit).sum() / max(1, int(lit.sum())))


def _stored(
    at: Workplace,
    report: CaptureReport,
    frames: Frames,
    sequence: PatternSequence,
    exposure: Exposure,
    response_hash: str | None,
) -> str:
    """Store the scan among the instrument's others, and return its number. Raises StorageError."""
    library = Library(at.rig.storage.root)
    library.prepare()
    calibration, _ = Instrument(at.rig).calibration()
    date, water = at.wires.calendar.today(), at.rig.water
    record = ScanRecord(
        sequence=SequenceInfo.of(sequence),
        rig_hash=at.rig.rig_hash,
        calibration_hash=calibration.hash,
        software_version=appliance.__version__,
        wall_time=date.utc.isoformat(timespec="seconds"),
        clock_trusted=date.kept,
        recorded_ns=at.wires.clock.now_ns(),
        response_hash=response_hash,
        exposure=exposure,
        water={
            "temperature_c": water.temperature_c,
            "salinity_psu": water.salinity_psu,
            "wavelength_nm": water.wavelength_nm,
        },
        ledger=report.ledger.as_dict(),
    )
    pending = library.begin(frames, record, Instrument(at.rig).origin(calibration))
    pending.publish(record)
    return pending.scan_id


def _decoded(sequence: PatternSequence, frames: NDArray[np.uint8]) -> _SideDecoded:
    decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
    for index in range(len(sequence)):
        decoder.push(frames, index)
    decoder.finish()
    found = {
        Direction.X: smooth_plane(decoder.p_px, sequence.period_px),
        Direction.Y: smooth_plane(decoder.q_px, sequence.period_px),
    }
    return _SideDecoded(
        {direction: plane for direction, plane in found.items() if plane is not None},
        float(np.isfinite(decoder.p_px).mean()),
        _saturated(frames, sequence),
    )


def _rippled(sides: dict[str, _SideDecoded], period_px: int) -> dict[str, CoordinateRipple]:
    return {
        f"{side} {direction.value}": ripple_of(plane, period_px)
        for side, one in sides.items()
        for direction, plane in one.planes.items()
    }


def _seen_response(
    sequence: PatternSequence, frames: Frames, sides: dict[str, _SideDecoded]
) -> tuple[ResponseShape | None, bytes | None]:
    """Return the response that the camera that sees more codes shows, and its picture."""
    curves = {side: curve_of(sequence, frames[side], one.planes) for side, one in sides.items() if one.planes}
    if not curves:
        return None, None
    codes, even, odd = max(curves.values(), key=lambda one: len(one[0]))
    # A curve that cannot be judged is not drawn either: it would look like one.
    shape = judge_curve(codes, even, odd)
    if shape is None:
        return None, None
    return shape, draw_curves(
        {"even rows": (codes, even), "odd rows": (codes, odd)}, "code", "share of bright over dark"
    )


def _worked_through(at: Workplace, scan_id: str) -> tuple[Flatness | None, str, tuple[str, ...]]:
    """Return how flat the stored scan's cloud is, else why that is not known, and what the judges hold against it."""
    rig = Instrument(at.rig).with_measured_noise()
    calibration, conditions = Instrument(rig).calibration()
    # The drawing's geometry would make a cloud, too, whose flatness says nothing about the instrument.
    if conditions:
        return None, "there is no calibration yet; calibrate next (docs/calibration.md)", ()
    scan = Library(rig.storage.root).load(scan_id)
    try:
        worked = work_through(scan, rig, calibration, at.say)
    except ScanError as error:
        return None, str(error), (str(error),)
    faults = tuple(f"{fault.code.value}: {fault.detail}" for fault in worked.faults)
    # Faults of the judges are told beside it: a scan that they refuse may still be flat.
    fit = fit_plane(worked.cloud)
    if isinstance(fit, NotFound):
        return None, fit.reason, faults
    return flatness(fit), "", faults


def smooth_plane(coordinate_px: NDArray[np.float32], period_px: int) -> SmoothPlane | None:
    """Fit a coordinate (h, w), NaN where there is none, by a polynomial; ``None`` where too few pixels lie on anything
    smooth."""
    rows, columns = np.nonzero(np.isfinite(coordinate_px))
    # Every so many: normal equations of some ten thousand pixels leave nothing to be wished for.
    step = max(1, len(rows) // MOST_PIXELS)
    rows, columns = rows[::step], columns[::step]
    if len(rows) < FEWEST_PIXELS:
        return None
    # From -1 to 1: powers of hundreds of pixels would leave the fit no digits.
    height, width = coordinate_px.shape
    x, y = 2.0 * columns / width - 1.0, 2.0 * rows / height - 1.0
    terms = np.column_stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
    wanted = coordinate_px[rows, columns].astype(np.float64)
    keep = np.ones(len(rows), np.bool_)
    residual = np.zeros(len(rows))
    smooth = wanted
    for _ in range(ROUNDS):
        if keep.sum() < FEWEST_PIXELS:
            return None
        solved, *_ = np.linalg.lstsq(terms[keep], wanted[keep], rcond=None)
        smooth = terms @ solved
        residual = wanted - smooth
        # Robust: a pixel that was decoded in the wrong period is a whole one away.
        spread = 1.4826 * float(np.median(np.abs(residual[keep])))
        keep = np.abs(residual) <= min(max(BELONGS * spread, 1e-3), FURTHEST * period_px)
    if keep.sum() < FEWEST_PIXELS:
        return None
    return SmoothPlane(rows[keep], columns[keep], smooth[keep], residual[keep])


def ripple_of(plane: SmoothPlane, period_px: int) -> CoordinateRipple:
    """Return the amplitudes of what in a plane's residuals goes with its fringes: r = Σ_k (a_k c_k + b_k s_k), by least
    squares."""
    theta = 2.0 * np.pi * (plane.smooth_px + 0.5) / period_px
    regressors = np.column_stack([f(k * theta) for k in CYCLES for f in (np.cos, np.sin)])
    solved, *_ = np.linalg.lstsq(regressors, plane.residual_px, rcond=None)
    rest = plane.residual_px - regressors @ solved
    noise_px = float(np.sqrt((rest**2).sum() / max(1, len(rest) - regressors.shape[1])))
    # Of a cosine and a sine the length: where in the fringe a ripple begins is of no interest.
    one, two, four = (float(np.hypot(*solved[2 * k : 2 * k + 2])) for k in range(len(CYCLES)))
    # Both of a pair have the variance 2 σ²/n.
    return CoordinateRipple((one, two, four), noise_px, noise_px * (2.0 / len(rest)) ** 0.5, len(rest))


def next_exposure(exposures: Sequence[Exposure], now: Exposure, saturated: float) -> Exposure | None:
    """Return the exposure to try after one that saturated so much of the lit image; ``None``: none is needed, or none
    is left.

    ``exposures`` are those that the rig file allows. Half of the light at most: how far beyond saturation it was,
    nobody knows.
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
    """Return codes (n,) and the light that was seen of them, as shares of bright over dark, (n,), by even and by odd
    rows.

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
    """Judge light (n,) by codes (n,), rising, that two halves of an image saw; ``None`` where codes are too few to
    tell."""
    if len(codes) < CODES // 2:
        return None
    # Fringes use the codes between their ends, and blur makes the range smaller: of those they make 0 and 255.
    spread = 255.0 * (codes - codes[0]) / (codes[-1] - codes[0])
    return judge_response(spread, 255.0 * even, 255.0 * odd)


def judge_plane(seen: PlaneSeen) -> tuple[Finding, ...]:
    """Judge a scan of a plane: light, response, ripple, flatness, and what the instrument's own judges say."""
    return (
        _filled(seen),
        _clipping(seen),
        _response(seen),
        *(_ripple(seen, k) for k in range(len(CYCLES))),
        _flat(seen),
        _judges(seen),
    )


def _filled(seen: PlaneSeen) -> Finding:
    side, least = min(seen.filled.items(), key=lambda one: one[1])
    said = " and ".join(f"{100.0 * share:.0f} % of the {one} image" for one, share in seen.filled.items())
    said, limits = f"fringes were read in {said}", f"{100.0 * LEAST_FILLED:g} % and more"
    remedy = f"the {side} camera sees too little: bring the plane to the working distance and upright, light it more, see step raster"
    numbers = {f"{one}_percent": 100.0 * share for one, share in seen.filled.items()}
    return judged("plane", least >= LEAST_FILLED, said, limits, remedy, **numbers)


def _clipping(seen: PlaneSeen) -> Finding:
    side, most = max(seen.saturated.items(), key=lambda one: one[1])
    said = f"{100.0 * most:.1f} % of what is lit in the {side} image is saturated at {seen.exposure.label}"
    limits, ok = f"up to {100.0 * MOST_SATURATED:g} %", most <= MOST_SATURATED
    remedy = "clipping: every allowed exposure is too long for this plane: less gain_db, shorter exposures_ms, a duller plane, no lamp on it"
    return judged("clipping", ok, said, limits, remedy, saturated_percent=100.0 * most)


def _response(seen: PlaneSeen) -> Finding:
    limits = "straight, or one smooth curve that scans straighten"
    # Fringes that blur away leave next to no codes but the middle ones.
    if seen.response is None:
        said = "too little was seen of it to tell: fringes are too fine for these cameras"
        return Finding("response", True, said, limits)
    shape, percent = seen.response, 100.0 * seen.response.line_rms
    said = (
        f"light by code is {shape.shape.value}: {percent:.1f} % off a straight line, like a power of {shape.power:.2f}"
    )
    return judged("response", shape.usable, said, limits, _cause(seen), line_percent=percent, power=shape.power)


def _ripple(seen: PlaneSeen, k: int) -> Finding:
    """Judge the ripple at the ``k``-th number of cycles by the worst coordinate."""
    cycles, limit_px = CYCLES[k], LIMITS_PER_PERIOD[k] * seen.period_px
    name, limits = f"ripple {cycles}x", f"up to {limit_px:.3f} px"
    if not seen.ripple:
        said, remedy = "no plane was found in either image", "let nothing but the plane be in the picture"
        return Finding(name, False, said, limits, remedy)
    where, worst = max(seen.ripple.items(), key=lambda one: one[1].amplitude_px[k])
    amplitude_px = worst.amplitude_px[k]
    # What noise alone makes of an amplitude is no ripple.
    ok = amplitude_px <= limit_px + 3.0 * worst.uncertainty_px
    said = f"{amplitude_px:.4f} px at {cycles} cycle{'s' if cycles > 1 else ''} a fringe ({where} is the worst)"
    numbers = {f"{place.replace(' ', '_')}_px": one.amplitude_px[k] for place, one in seen.ripple.items()}
    return judged(name, ok, said, limits, _RIPPLES.get(cycles) or _cause(seen), **numbers)


def _cause(seen: PlaneSeen) -> str:
    """Name what makes fringes no sines, most telling first."""
    if max(seen.saturated.values(), default=0.0) > MOST_SATURATED:
        return "clipping: a shorter exposure, less gain, a duller plane"
    if seen.response is not None and seen.response.shape in _CURVED:
        return _CURVED[seen.response.shape].format(scan=seen.scan)
    return f"the light is no sine: measure its response (`kingfisher calibration measure response {seen.scan} --install`), and see gamma, exposures and focus"


def _flat(seen: PlaneSeen) -> Finding:
    limits, flat = f"flatness error up to {100.0 * MOST_FLATNESS:g} % of the reference length", seen.flatness
    if flat is None:
        return Finding("flatness", True, f"not measured: {seen.why_not_flat}", limits)
    said = f"the cloud's systematic flatness error is {flat.sys_range_mm:.2f} mm ({100.0 * flat.e_f_sys:.2f} %)"
    said += "" if flat.noise_mm is None else f", its noise {flat.noise_mm:.3f} mm"
    numbers = {"e_f_percent": 100.0 * flat.e_f, "e_f_sys_percent": 100.0 * flat.e_f_sys, "noise_mm": flat.noise_mm}
    ok = flat.e_f_sys <= MOST_FLATNESS
    return judged("flatness", ok, said, limits, "calibrate: docs/calibration.md", **numbers)


def _judges(seen: PlaneSeen) -> Finding:
    said = "; ".join(seen.faults) or f"scan {seen.scan} is stored; nothing speaks against it"
    remedy = "the page docs/faults.md has each with its remedy"
    return judged("judges", not seen.faults, said, "nothing that refuses the scan", remedy)
