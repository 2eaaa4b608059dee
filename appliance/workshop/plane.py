"""The step ``plane``: one scan of a plane, recorded, stored and reconstructed as any scan is.

Its fringes must be sines, its light neither cut off nor missing, its cloud flat. A plane's coordinate is a smooth
function of the pixel; fringes are not smooth. So the residuals of a polynomial that follow the fringe's phase θ = 2π (p
+ ½)/P are the error of the fringes:

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
from appliance.instrument import (
    CaptureReport,
    Devices,
    DrawnPatterns,
    FrameStore,
    ScanRecorder,
    ScanSettings,
    open_devices,
)
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
from appliance.workshop.finding import BringupError, Finding, finding_of
from appliance.workshop.response import ResponseShape, Shape, judge_response
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered_request, wall
from drivers.output.gl import open_gl

TRIES = 3
"""Attempts to record the scan: a single late flip is chance, three faults in a row are not."""
LIT_DN = 20
"""Grey values of a bright image over its dark one from which a pixel is lit."""
LEAST_LIT = 0.2
"""Share of a bright image that must be lit; else the operator is asked again to place the plane."""
Frames = dict[str, NDArray[np.uint8]]
LIMITS_PER_PERIOD = (1.0 / 800.0, 1.0 / 800.0, 1.0 / 128.0)
"""Largest amplitudes at one, two and four cycles a period, in periods.

The last is larger, since the response correction of each scan removes it.
"""
MOST_SATURATED = 0.01
SATURATED_DN = 254
LEAST_FILLED = 0.3
"""Smallest share of the image that must see the plane."""
MOST_FLATNESS = 0.02
"""Largest flatness error of a plane, as a share of the reference length: the instrument's own calibration is better by
far."""
CODES = 64
"""Number of intervals of codes in which the light is averaged."""
FEWEST_IN_CODE = 8
_RIPPLES = {
    1: "light is added to some frames: switch off other light and dynamic contrast; keep black level and "
    "ambient light steady",
    2: "frames differ in brightness, or show a part of the pattern before: repeat steps latency and light; "
    "use shorter exposures and trigger overlap in both cameras; switch off dynamic contrast",
}
"""Remedies of a ripple at one and two cycles; that at four has the causes in ``_CURVED``."""
_CURVED = {
    Shape.GAMMA: "gamma: switch it off in the projector and in the graphics driver, or measure it with `kingfisher calibration measure response {scan} --install`",
    Shape.BIT_PLANES: "exposures cut bit planes: use only those that step light found, and repeat step light "
    "after a change of the projector's mode",
    Shape.RESTLESS: "light changes over the plane or between frames: switch off dynamic contrast, dither and "
    "other light; keep the plane still",
}
CYCLES = (1, 2, 4)
DEGREE = 5
"""Degree of the polynomial in column and row: it fits a plane through lens and port to some thousandths of a px."""
MOST_PIXELS = 40_000
FEWEST_PIXELS = 400
ROUNDS, BELONGS = 4, 5.0
"""Rounds of the fit, and the number of robust standard deviations beyond which a pixel is an outlier: edges, dust,
other surfaces.
"""
FURTHEST = 1.0 / 16.0
"""Largest residual of a ripple, in periods: a larger one is another surface or a wrong fringe."""


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
    """Number of pixels in the fit."""


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
class PlaneFigures:
    """All measurements of the instrument from a scan of a plane."""

    scan: str
    """Number of the stored scan."""
    period_px: int
    ripple: Mapping[str, CoordinateRipple]
    """Ripple by camera and coordinate, ``left x``."""
    filled: Mapping[str, float]
    """Share of each camera's pixels that have both coordinates."""
    exposure: Exposure
    """Exposure of the scan."""
    saturated: Mapping[str, float]
    """Share of the lit pixels of each camera's brightest image that are saturated."""
    response: ResponseShape | None
    """Response of the light by code; ``None``: too few codes were seen."""
    flatness: Flatness | None
    """``None``: there is no calibration, or the cloud has no plane."""
    why_not_flat: str = ""
    """Reason why ``flatness`` is ``None``."""
    faults: tuple[str, ...] = ()
    """Faults by the judges, in words."""


@dataclass(frozen=True, slots=True, eq=False)
class _SideResult:
    """One camera's part in the scan, decoded."""

    planes: dict[Direction, SmoothPlane]
    filled: float
    saturated: float


def do(workplace: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError, GivenUp, StorageError."""
    with open_gl() as gl:
        # Patterns are drawn for a measured response, so that the ripple is that of scans.
        response = Instrument(workplace.rig).response()
        patterns = DrawnPatterns(gl, workplace.rig, workplace.rig.scan.period_px, response)
        sequence = patterns.sequence
        exposure = Instrument(workplace.rig).exposure
        for attempt in range(MOST_ASKED):
            workplace.person.ask(numbered_request(wall(workplace), attempt))
            report, frames, exposure = _record_unsaturated(
                partial(_record, workplace, patterns), sequence, Instrument(workplace.rig).exposures, exposure
            )
            if all(_lit(images, sequence).mean() >= LEAST_LIT for images in frames.values()):
                break
    scan_id = _store(workplace, report, frames, sequence, exposure, None if response is None else response.hash)
    workplace.say("decoding")
    sides = {side: _decode(sequence, frames[side]) for side in SIDES}
    shape, curve = (None, None) if response is not None else _response_shape(sequence, frames, sides)
    flatness_of_cloud, reason, faults = _reprocess(workplace, scan_id)
    figures = PlaneFigures(
        scan=scan_id,
        period_px=sequence.period_px,
        ripple=_ripples(sides, sequence.period_px),
        exposure=exposure,
        filled={side: images.filled for side, images in sides.items()},
        saturated={side: images.saturated for side, images in sides.items()},
        response=shape,
        flatness=flatness_of_cloud,
        why_not_flat=reason,
        faults=faults,
    )
    pictures = {
        f"plane_{side}.png": (f"The plane in white light ({side} camera)", png(frames[side][sequence.bright]))
        for side in SIDES
    }
    if curve is not None:
        pictures["plane_light.png"] = "Light of the plane by code, as the fringes show it", curve
    return StepOutcome(judge_plane(figures), {}, pictures)


def _record_unsaturated(
    record: Callable[[Exposure], tuple[CaptureReport, Frames]],
    sequence: PatternSequence,
    allowed: Sequence[Exposure],
    exposure: Exposure,
) -> tuple[CaptureReport, Frames, Exposure]:
    """Record the plane with the longest allowed exposure that does not saturate it."""
    report, frames = record(exposure)
    # The rig file's exposure is that of the dive; a white plane in air is brighter than most objects under water.
    for _ in allowed:
        saturated = max(_saturated(images, sequence) for images in frames.values())
        darker = next_exposure(allowed, exposure, saturated)
        if darker is None:
            break
        exposure = darker
        report, frames = record(exposure)
    return report, frames, exposure


def _record(workplace: Workplace, patterns: DrawnPatterns, exposure: Exposure) -> tuple[CaptureReport, Frames]:
    """Record one sequence whose witnesses all agree. Raises DeviceError, BringupError."""
    rig, sequence = workplace.rig, patterns.sequence
    settings = ScanSettings(
        rig.projector.refresh_hz, exposure.time_us, rig.board.trigger_delay_us, rig.projector.latency_blanks
    )
    left = rig.camera.left
    with (
        FrameStore(len(sequence), left.height_px, left.width_px) as store,
        Devices(rig, workplace.wires, patterns.load) as devices,
    ):
        grabbers, board, projector = open_devices(devices, workplace.wires.clock)
        devices.expose(exposure)
        recorder = ScanRecorder(grabbers, board, projector, workplace.wires.clock, settings)
        fault = None
        for _ in range(TRIES):
            workplace.say("scanning")
            report = recorder.record(sequence, store, lambda _side, _index: None, lambda: None)
            fault = report.fault
            if fault is None:
                return report, {side: store.frames(side)[: len(sequence)].copy() for side in SIDES}
    assert fault is not None
    raise BringupError(f"{TRIES} scans in a row failed: {fault.code.value}: {fault.detail}; repeat step trigger")


def _lit(frames: NDArray[np.uint8], sequence: PatternSequence) -> NDArray[np.bool_]:
    """Return the pixels (h, w) that the projector lights."""
    bright, dark = (frames[k].astype(np.int16) for k in (sequence.bright, sequence.dark))
    return np.asarray(bright - dark >= LIT_DN)


def _saturated(frames: NDArray[np.uint8], sequence: PatternSequence) -> float:
    """Return the saturated share of the lit pixels in white light."""
    is_lit = _lit(frames, sequence)
    return float(((frames[sequence.bright] >= SATURATED_DN) & is_lit).sum() / max(1, int(is_lit.sum())))


def _store(
    workplace: Workplace,
    report: CaptureReport,
    frames: Frames,
    sequence: PatternSequence,
    exposure: Exposure,
    response_hash: str | None,
) -> str:
    """Store the scan among the instrument's others, and return its number. Raises StorageError."""
    library = Library(workplace.rig.storage.root)
    library.prepare()
    calibration, _ = Instrument(workplace.rig).calibration()
    date, water = workplace.wires.calendar.today(), workplace.rig.water
    record = ScanRecord(
        sequence=SequenceInfo.of(sequence),
        rig_hash=workplace.rig.rig_hash,
        calibration_hash=calibration.hash,
        software_version=appliance.__version__,
        wall_time=date.utc.isoformat(timespec="seconds"),
        clock_trusted=date.kept,
        recorded_ns=workplace.wires.clock.now_ns(),
        response_hash=response_hash,
        exposure=exposure,
        water={
            "temperature_c": water.temperature_c,
            "salinity_psu": water.salinity_psu,
            "wavelength_nm": water.wavelength_nm,
        },
        ledger=report.ledger.as_dict(),
    )
    pending = library.begin(frames, record, Instrument(workplace.rig).origin(calibration))
    pending.publish(record)
    return pending.scan_id


def _decode(sequence: PatternSequence, frames: NDArray[np.uint8]) -> _SideResult:
    decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
    for index in range(len(sequence)):
        decoder.push(frames, index)
    decoder.finish()
    planes = {
        Direction.X: smooth_plane(decoder.p_px, sequence.period_px),
        Direction.Y: smooth_plane(decoder.q_px, sequence.period_px),
    }
    return _SideResult(
        {direction: plane for direction, plane in planes.items() if plane is not None},
        float(np.isfinite(decoder.p_px).mean()),
        _saturated(frames, sequence),
    )


def _ripples(sides: dict[str, _SideResult], period_px: int) -> dict[str, CoordinateRipple]:
    return {
        f"{side} {direction.value}": ripple_of(plane, period_px)
        for side, result in sides.items()
        for direction, plane in result.planes.items()
    }


def _response_shape(
    sequence: PatternSequence, frames: Frames, sides: dict[str, _SideResult]
) -> tuple[ResponseShape | None, bytes | None]:
    """Return the response by the camera that sees more codes, and its figure."""
    curves = {side: curve_of(sequence, frames[side], result.planes) for side, result in sides.items() if result.planes}
    if not curves:
        return None, None
    codes, even, odd = max(curves.values(), key=lambda result: len(result[0]))
    # A curve that cannot be judged is not drawn: it would look like a good one.
    shape = judge_curve(codes, even, odd)
    if shape is None:
        return None, None
    return shape, draw_curves(
        {"even rows": (codes, even), "odd rows": (codes, odd)}, "code", "share of bright over dark"
    )


def _reprocess(workplace: Workplace, scan_id: str) -> tuple[Flatness | None, str, tuple[str, ...]]:
    """Return the flatness of the stored scan or the reason why it is unknown, and the judges' faults."""
    rig = Instrument(workplace.rig).with_measured_noise()
    calibration, conditions = Instrument(rig).calibration()
    # The nominal calibration would make a cloud, too, but its flatness is no property of the instrument.
    if conditions:
        return None, "there is no calibration yet; calibrate next (docs/calibration.md)", ()
    scan = Library(rig.storage.root).load(scan_id)
    try:
        reprocessed = work_through(scan, rig, calibration, workplace.say)
    except ScanError as error:
        return None, str(error), (str(error),)
    faults = tuple(f"{fault.code.value}: {fault.detail}" for fault in reprocessed.faults)
    # Faults of the judges are reported beside it: such a scan may still be flat.
    fit = fit_plane(reprocessed.cloud)
    if isinstance(fit, NotFound):
        return None, fit.reason, faults
    return flatness(fit), "", faults


def smooth_plane(coordinate_px: NDArray[np.float32], period_px: int) -> SmoothPlane | None:
    """Fit a polynomial to a coordinate (h, w) with NaN; ``None`` where too few pixels are smooth."""
    rows, columns = np.nonzero(np.isfinite(coordinate_px))
    # A subset: some ten thousand pixels are enough for the fit.
    step = max(1, len(rows) // MOST_PIXELS)
    rows, columns = rows[::step], columns[::step]
    if len(rows) < FEWEST_PIXELS:
        return None
    # Coordinates from -1 to 1: powers of pixel numbers would make the fit ill-conditioned.
    height, width = coordinate_px.shape
    x, y = 2.0 * columns / width - 1.0, 2.0 * rows / height - 1.0
    terms = np.column_stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
    measured = coordinate_px[rows, columns].astype(np.float64)
    is_inlier = np.ones(len(rows), np.bool_)
    residual = np.zeros(len(rows))
    smooth = measured
    for _ in range(ROUNDS):
        if is_inlier.sum() < FEWEST_PIXELS:
            return None
        coefficients, *_ = np.linalg.lstsq(terms[is_inlier], measured[is_inlier], rcond=None)
        smooth = terms @ coefficients
        residual = measured - smooth
        # Robust: a wrong fringe is a whole period away.
        spread = 1.4826 * float(np.median(np.abs(residual[is_inlier])))
        is_inlier = np.abs(residual) <= min(max(BELONGS * spread, 1e-3), FURTHEST * period_px)
    if is_inlier.sum() < FEWEST_PIXELS:
        return None
    return SmoothPlane(rows[is_inlier], columns[is_inlier], smooth[is_inlier], residual[is_inlier])


def ripple_of(plane: SmoothPlane, period_px: int) -> CoordinateRipple:
    """Return the amplitudes of the part of a plane's residuals that follows its fringes.

    r = Σ_k (a_k c_k + b_k s_k), by least squares.
    """
    theta = 2.0 * np.pi * (plane.smooth_px + 0.5) / period_px
    regressors = np.column_stack([f(k * theta) for k in CYCLES for f in (np.cos, np.sin)])
    coefficients, *_ = np.linalg.lstsq(regressors, plane.residual_px, rcond=None)
    noise = plane.residual_px - regressors @ coefficients
    noise_px = float(np.sqrt((noise**2).sum() / max(1, len(noise) - regressors.shape[1])))
    # The amplitude of cosine and sine together: the phase of the ripple does not matter.
    single, double, quadruple = (float(np.hypot(*coefficients[2 * k : 2 * k + 2])) for k in range(len(CYCLES)))
    # The coefficients of cosine and sine have the variance 2 σ²/n each.
    return CoordinateRipple((single, double, quadruple), noise_px, noise_px * (2.0 / len(noise)) ** 0.5, len(noise))


def next_exposure(exposures: Sequence[Exposure], current: Exposure, saturated: float) -> Exposure | None:
    """Return the exposure to try after one that saturated this share of the lit pixels, or ``None``.

    ``None``: no other one is needed, or none is left. ``exposures`` are those that the rig file allows. The next one
    has at most half of the light, since it is unknown how far beyond saturation the current one is.
    """
    if saturated <= MOST_SATURATED:
        return None
    darker = sorted(
        (candidate for candidate in exposures if candidate.light < current.light), key=lambda candidate: candidate.light
    )
    halves = [candidate for candidate in darker if candidate.light <= 0.5 * current.light]
    if halves:
        return halves[-1]
    return darker[0] if darker else None


def curve_of(
    sequence: PatternSequence, frames: Image, planes: Mapping[Direction, SmoothPlane]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return codes (n,) and their light as shares of bright over dark, (n,), by even and by odd rows.

    ``frames`` (count, h, w) are one camera's of a sequence drawn without a response. n is 0 where too few codes were
    seen.
    """
    # By code, not by phase: the light of a code is the same wherever it is drawn.
    edges = np.linspace(0.0, 256.0, CODES + 1)
    counts, sums = np.zeros((2, CODES)), np.zeros((2, CODES))
    codes = np.zeros(CODES)
    for direction, plane in planes.items():
        pixels = plane.rows, plane.columns
        dark = frames[sequence.dark][pixels].astype(np.float64)
        span = frames[sequence.bright][pixels] - dark
        is_usable = (span > 40.0) & (frames[sequence.bright][pixels] < SATURATED_DN)
        axis = sequence.axis(direction)
        for number in axis.sine:
            table = sequence.patterns[number].codes().astype(np.float64)
            code = np.interp(plane.smooth_px[is_usable], np.arange(len(table)), table)
            share = (frames[number][pixels][is_usable] - dark[is_usable]) / span[is_usable]
            part = np.clip(np.digitize(code, edges) - 1, 0, CODES - 1)
            # Two halves of one image stand for two passes: their difference is noise.
            half = plane.rows[is_usable] % 2
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
    """Judge light (n,) over rising codes (n,), from two halves of an image; ``None`` if codes are too few."""
    if len(codes) < CODES // 2:
        return None
    # Fringes use the codes between their ends, and blur makes that range smaller: it is spread to 0 … 255.
    spread = 255.0 * (codes - codes[0]) / (codes[-1] - codes[0])
    return judge_response(spread, 255.0 * even, 255.0 * odd)


def judge_plane(figures: PlaneFigures) -> tuple[Finding, ...]:
    """Judge a scan of a plane by light, response, ripple, flatness, and the instrument's own judges."""
    return (
        _filled(figures),
        _clipping(figures),
        _response(figures),
        *(_ripple(figures, k) for k in range(len(CYCLES))),
        _flat(figures),
        _judges(figures),
    )


def _filled(figures: PlaneFigures) -> Finding:
    side, smallest = min(figures.filled.items(), key=lambda entry: entry[1])
    statement = " and ".join(
        f"{100.0 * share:.0f} % of the {side_name} image" for side_name, share in figures.filled.items()
    )
    statement, limits = f"fringes are decoded in {statement}", f"{100.0 * LEAST_FILLED:g} % and more"
    remedy = (
        f"the {side} camera sees too little: put the plane upright at the working distance, use more light, see "
        "step raster"
    )
    numbers = {f"{side_name}_percent": 100.0 * share for side_name, share in figures.filled.items()}
    return finding_of("plane", smallest >= LEAST_FILLED, statement, limits, remedy, **numbers)


def _clipping(figures: PlaneFigures) -> Finding:
    side, largest = max(figures.saturated.items(), key=lambda entry: entry[1])
    statement = (
        f"{100.0 * largest:.1f} % of the illuminated pixels of the {side} image are saturated at "
        f"{figures.exposure.label}"
    )
    limits, ok = f"up to {100.0 * MOST_SATURATED:g} %", largest <= MOST_SATURATED
    remedy = (
        "every allowed exposure is too long for this plane: reduce gain_db or exposures_ms, use a duller "
        "plane, switch off other light"
    )
    return finding_of("clipping", ok, statement, limits, remedy, saturated_percent=100.0 * largest)


def _response(figures: PlaneFigures) -> Finding:
    limits = "straight, or one smooth curve, which scans correct"
    # Blurred fringes have only the middle codes.
    if figures.response is None:
        statement = "not measurable: the fringes are too fine for these cameras"
        return Finding("response", True, statement, limits)
    shape, percent = figures.response, 100.0 * figures.response.line_rms
    statement = (
        f"light by code is {shape.shape.value}: {percent:.1f} % off a straight line, like a power of {shape.power:.2f}"
    )
    return finding_of(
        "response", shape.usable, statement, limits, _cause(figures), line_percent=percent, power=shape.power
    )


def _ripple(figures: PlaneFigures, k: int) -> Finding:
    """Judge the ripple at the ``k``-th number of cycles by the worst coordinate."""
    cycles, limit_px = CYCLES[k], LIMITS_PER_PERIOD[k] * figures.period_px
    name, limits = f"ripple {cycles}x", f"up to {limit_px:.3f} px"
    if not figures.ripple:
        statement, remedy = "no plane was found in either image", "show nothing but the plane"
        return Finding(name, False, statement, limits, remedy)
    where, worst = max(figures.ripple.items(), key=lambda coordinate: coordinate[1].amplitude_px[k])
    amplitude_px = worst.amplitude_px[k]
    # Noise alone makes an amplitude of up to three standard deviations.
    ok = amplitude_px <= limit_px + 3.0 * worst.uncertainty_px
    statement = f"{amplitude_px:.4f} px at {cycles} cycle{'s' if cycles > 1 else ''} a fringe ({where} is the worst)"
    numbers = {
        f"{place.replace(' ', '_')}_px": coordinate.amplitude_px[k] for place, coordinate in figures.ripple.items()
    }
    return finding_of(name, ok, statement, limits, _RIPPLES.get(cycles) or _cause(figures), **numbers)


def _cause(figures: PlaneFigures) -> str:
    """Return the remedy for the most likely cause of fringes that are no sines."""
    if max(figures.saturated.values(), default=0.0) > MOST_SATURATED:
        return "saturation: use a shorter exposure, less gain or a duller plane"
    if figures.response is not None and figures.response.shape in _CURVED:
        return _CURVED[figures.response.shape].format(scan=figures.scan)
    return (
        "the light is not sinusoidal: measure the response (`kingfisher calibration measure response "
        f"{figures.scan} --install`), and check gamma, exposures and focus"
    )


def _flat(figures: PlaneFigures) -> Finding:
    limits, cloud_flatness = (
        f"flatness error up to {100.0 * MOST_FLATNESS:g} % of the reference length",
        figures.flatness,
    )
    if cloud_flatness is None:
        return Finding("flatness", True, f"not measured: {figures.why_not_flat}", limits)
    statement = f"the cloud's systematic flatness error is {cloud_flatness.sys_range_mm:.2f} mm ({100.0 * cloud_flatness.e_f_sys:.2f} %)"
    statement += "" if cloud_flatness.noise_mm is None else f", its noise {cloud_flatness.noise_mm:.3f} mm"
    numbers = {
        "e_f_percent": 100.0 * cloud_flatness.e_f,
        "e_f_sys_percent": 100.0 * cloud_flatness.e_f_sys,
        "noise_mm": cloud_flatness.noise_mm,
    }
    ok = cloud_flatness.e_f_sys <= MOST_FLATNESS
    return finding_of("flatness", ok, statement, limits, "calibrate: docs/calibration.md", **numbers)


def _judges(figures: PlaneFigures) -> Finding:
    statement = "; ".join(figures.faults) or f"scan {figures.scan} is stored; no judge rejects it"
    remedy = "docs/faults.md has the remedy of each fault"
    return finding_of("judges", not figures.faults, statement, "no fault that rejects the scan", remedy)
