"""The verdict ``water``: attenuation, backscatter, specks, and whether they make the scan poor.

Only the left camera's images are used. ``backscatter.py`` measures the backscatter in cells of the image; ``beam.py``
computes the path of each ray through the projector's beam. From these follow:

- Attenuation. A ray that enters the beam farther out collects light that has travelled farther, so that backscatter
  changes over the image. Least squares over the cells give the attenuation and its standard error.
- Forward scatter (*halo*): light of the object that is scattered by small angles into dark stripes. It follows the
  object's image, not the ray's path, and is subtracted from the backscatter.
- Backscatter relative to the light of a surface. The albedo of the object is unknown; ``ALBEDO`` is assumed. For the
  same reason the object's light says nothing about attenuation.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.model import StereoRig
from appliance.measure.light.water import sight_m
from appliance.measure.points.table import Cloud
from appliance.measure.scan_images import PixelGrid, ScanImages
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.water.backscatter import (
    CELLS,
    BackscatterSample,
    Cells,
    cell_of,
    measure_backscatter,
    water_grid,
)
from appliance.measure.verdicts.water.beam import GatheredLight, ProjectorBeam, beam_of, gather

Array = NDArray[np.float64]

NAME = "water"
MIN_ENTRY_MM = 195.0
"""Least distance from the projector's port at which rays of the standard housing enter the beam; nearer, the
backscatter depends on the edge of the beam."""
MIN_CELLS = 12
MODEL_SHARE, MODEL_DN = 0.02, 0.05
"""Standard deviation of the model of single scattering, relative and absolute, besides the noise of the cells."""
LEAK = 0.001
"""Prior standard deviation of light of the object from beyond a stripe's border, as a share of it."""
STEADY_DN, FLICKERS = 0.02, 2.0
"""Prior standard deviation of the difference of ambient light between the references: in steady light, and as a
multiple of the flicker in the sines."""
HALO, HALO_SIGMAS = 0.05, 5.0
"""Least share of the object's light, and least multiple of its standard error, from which on forward scatter is
distinguished from backscatter."""
HALO_CANDIDATES_PER_M = np.arange(0.0, 8.01, 0.25)
MAX_ATTENUATION_PER_M = 12.0
MOST_SIGHT_M = 10.0
"""Largest visibility that is reported: more makes no scan poor, and so small an attenuation is uncertain."""
MAX_SIGMA_PER_M = 1.0
"""Largest standard error of an attenuation that is stated."""
ROUNDS = 12
ALBEDO = 0.6
"""Assumed albedo of the object, for stating backscatter as a fraction of its light."""
POINTS = 4_000
"""Number of the cloud's points by which the beam and the ends of the rays are determined."""
MIN_POINTS = 3
"""Least number of points in a cell for its depth to be known."""

DIRTY_MASKED, DIRTY_BACKSCATTER, DIRTY_SPECKS = 0.25, 0.25, 0.02
"""Limits of a scan that is poor by the water: shares of the object without coordinates together with backscatter in its
light, or the share disturbed by specks."""
MOST_BACKSCATTER = 0.30
"""Share of backscatter from which on the scan is poor with any number of coordinates: in places the backscatter is
brighter than the object, and the Gray code has to be decoded through it (``appliance.measure.decode.backscatter``)."""
HIDDEN = 0.25
"""Largest share of the object that may be lost where the backscatter is brighter."""


@dataclass(frozen=True, slots=True)
class WaterJudgement:
    """Judgement and numbers of the water; ``None``: not measured."""

    judgement: Judgement
    attenuation_per_m: float | None
    attenuation_sigma_per_m: float | None
    """Standard error of the attenuation."""
    veil_percent: float | None
    """Percent of backscatter in the projected light on the object's pixels, without forward scatter."""
    halo_percent: float | None
    """Percent of forward scatter in it: light of the object in the dark stripes beside bright ones."""
    backscatter_percent: float | None
    """Backscatter of a white pattern before the middle of the volume without attenuation, in percent of the light of a
    surface there; the brighter parts of the object are assumed to have an albedo of 0.6."""
    expected_noise_mm: float | None
    """Median sigma of the points."""
    object_percent: float | None
    """Percent of the image's pixels that show an object and are not saturated."""
    masked_percent: float | None
    """Percent of the object's pixels without coordinates."""
    hidden_percent: float | None
    """Percent of the object's pixels without coordinates in which the backscatter is brighter than the object."""
    speck_percent: float | None
    """Percent of the pixels with coordinates that specks disturbed."""
    fringe_contrast_percent: float | None
    """Modulation in percent of half of the object's light: low for blurred fringes, independent of backscatter."""


@dataclass(frozen=True, slots=True)
class Attenuation:
    """Attenuation by the change of the backscatter over the image."""

    per_m: float
    sigma_per_m: float
    strength_dn: float
    """Backscatter per mm of water in the beam at ``SCALE_MM``, without attenuation."""


def judge_water(
    images: ScanImages, cloud: Cloud, rig: StereoRig, water_index: float, grid: PixelGrid | None = None
) -> WaterJudgement:
    """Judge the water by the left camera's frames and the points of ``cloud`` (the coarse one is enough).

    ``grid``: that of the left camera, if it was filled while the frames arrived.
    """
    decoded = images.decoded["left"]
    grid = grid or water_grid(images.sequence).take_all(images.frames["left"])
    sample = measure_backscatter(images.sequence, grid, decoded, images.noise.left)
    numbers: dict[str, float | None] = {
        "attenuation_per_m": None,
        "attenuation_sigma_per_m": None,
        "veil_percent": _percent(sample.backscatter_share),
        "halo_percent": None,
        "backscatter_percent": None,
        "expected_noise_mm": cloud.summary.noise_mm,
        "object_percent": _percent(sample.object_share),
        "masked_percent": _percent(sample.masked_share),
        "hidden_percent": _percent(sample.hidden_share),
        "speck_percent": _percent(sample.speck_share),
        "fringe_contrast_percent": _percent(sample.fringe_contrast),
    }
    rays = _rays(images, sample.cells, cloud, rig, water_index)
    if rays is not None:
        cells, gathered, clear = rays
        halo = halo_share(cells, gathered)
        if halo > 0.0 and sample.backscatter_share is not None:
            sample = replace(sample, backscatter_share=max(sample.backscatter_share - halo, 0.0))
            numbers["veil_percent"], numbers["halo_percent"] = _percent(sample.backscatter_share), 100.0 * halo
        attenuation = fit_attenuation(
            cells, gathered, images.noise.left.black_dn, sample.flicker_dn, rig.volume.scaled(MIN_ENTRY_MM)
        )
        if attenuation is not None:
            numbers["attenuation_per_m"] = attenuation.per_m
            numbers["attenuation_sigma_per_m"] = attenuation.sigma_per_m
            numbers["backscatter_percent"] = _backscatter_percent(attenuation, cells, gathered, clear)
    fault = _fault(sample)
    verdict = Verdict(NAME, None if sample.object_pixels == 0 else fault is None, numbers, text_of(numbers))
    return WaterJudgement(judgement=Judgement(verdict, fault), **numbers)


def fit_attenuation(
    cells: Cells, gathered: GatheredLight, black_dn: float, flicker_dn: float, min_entry_mm: float = MIN_ENTRY_MM
) -> Attenuation | None:
    """Return attenuation and strength of the backscatter by its change over the cells.

    ``None``: too uncertain.
    """
    use = gathered.enters_mm >= min_entry_mm
    if np.count_nonzero(use) < MIN_CELLS:
        return None
    sigma = np.sqrt(cells.sigma_dn**2 + (MODEL_SHARE * cells.backscatter_dn) ** 2 + MODEL_DN**2)[use]
    ambient = np.maximum(cells.dark_dn - black_dn, 0.0) + 1e-3
    further_terms = np.stack([ambient / ambient.mean(), cells.signal_dn], -1)[use]
    rays = GatheredLight(
        gathered.weights[use], gathered.path_m[use], gathered.enters_mm[use], gathered.falls[use], gathered.ends_m[use]
    )
    backscatter = cells.backscatter_dn[use]
    prior = np.diag([0.0, 1e-6, (STEADY_DN + FLICKERS * flicker_dn) ** -2, LEAK**-2])
    # x = (strength, attenuation, share of ambient light, leak): Gauss and Newton on the cells' backscatter.
    x = np.array([0.0, 1.0, 0.0, 0.0])
    x[0] = _strength(rays.backscatter(x[1]), backscatter, sigma)
    for _ in range(ROUNDS):
        J = np.column_stack([rays.backscatter(x[1]), x[0] * rays.slope(x[1]), further_terms]) / sigma[:, None]
        residual = (backscatter - x[0] * rays.backscatter(x[1]) - further_terms @ x[2:]) / sigma
        # Normal equations with the prior as further observations of the last two parameters at 0.
        normal = J.T @ J + prior
        try:
            step = np.linalg.solve(normal, J.T @ residual - prior @ np.array([0.0, 0.0, x[2], x[3]]))
        except np.linalg.LinAlgError:
            return None
        step[1] = np.clip(step[1], -1.0, 1.0)
        x += step
        x[1] = np.clip(x[1], 0.0, MAX_ATTENUATION_PER_M)
        x[0] = max(x[0], 1e-12)
    # If the residuals exceed their errors, so does the error of the attenuation.
    excess = max(1.0, float(residual @ residual) / (len(backscatter) - 2))
    sigma_per_m = float(np.sqrt(np.linalg.inv(normal)[1, 1] * excess))
    if not sigma_per_m <= MAX_SIGMA_PER_M:
        return None
    return Attenuation(float(x[1]), sigma_per_m, float(x[0]))


def halo_share(cells: Cells, gathered: GatheredLight) -> float:
    """Return the share of forward scatter in the projected light; 0 if it is not significant.

    Forward scatter follows the image of the object, backscatter the path of the ray through the beam. Both are fitted
    to the light in the middle of the stripes, with the attenuation that fits best.
    """
    sigma = np.sqrt(cells.sigma_dn**2 + (MODEL_SHARE * cells.backscatter_dn) ** 2 + MODEL_DN**2)
    observed, best, leak, leak_sigma = cells.backscatter_dn / sigma, np.inf, 0.0, np.inf
    models = np.empty((len(HALO_CANDIDATES_PER_M), len(observed), 2))
    models[:, :, 1] = cells.signal_dn / sigma
    for model, per_m in zip(models, HALO_CANDIDATES_PER_M, strict=True):
        model[:, 0] = gathered.backscatter(float(per_m)) / sigma
    for model, inverse in zip(models, _inverses(np.stack([model.T @ model for model in models])), strict=True):
        strength, share = inverse @ (model.T @ observed)
        residual = observed - model @ np.array([strength, share])
        misfit = float(residual @ residual)
        if strength >= 0.0 and misfit < best:
            excess = max(1.0, misfit / max(len(observed) - 3, 1))
            best, leak, leak_sigma = misfit, float(share), float(np.sqrt(inverse[1, 1] * excess))
    if leak < HALO or leak < HALO_SIGMAS * leak_sigma:
        return 0.0
    of_light = float(cells.pixels @ (cells.signal_dn + cells.backscatter_dn))
    return leak * float(cells.pixels @ cells.signal_dn) / of_light


def _inverses(normal: Array) -> Array:
    """Return the inverses (n, 2, 2) of matrices, all at once; NaN for a singular one."""
    try:
        return np.asarray(np.linalg.inv(normal))
    except np.linalg.LinAlgError:
        # The error does not say which one is singular.
        inverses = np.full(normal.shape, np.nan)
        for matrix, inverse in zip(normal, inverses, strict=True):
            with suppress(np.linalg.LinAlgError):
                inverse[:] = np.linalg.inv(matrix)
        return inverses


def text_of(numbers: dict[str, float | None]) -> str:
    """Return the text of the verdict."""
    parts = []
    attenuation, sigma = numbers["attenuation_per_m"], numbers["attenuation_sigma_per_m"]
    if attenuation is not None and sigma is not None:
        parts.append(f"attenuation {attenuation:.1f} ± {sigma:.1f} /m")
        visibility_m = sight_m(attenuation)
        if visibility_m is not None and visibility_m <= MOST_SIGHT_M:
            parts[0] += f" (sight {visibility_m:.1f} m)"
    for key, name in (("veil_percent", "veil"), ("masked_percent", "masked"), ("speck_percent", "specks")):
        value = numbers[key]
        if value is not None:
            parts.append(f"{name} {value:.0f} %")
    noise_mm = numbers["expected_noise_mm"]
    if noise_mm is not None:
        parts.append(f"noise {1000.0 * noise_mm:.0f} µm")
    return ", ".join(parts) or "no data to judge the water"


def hides_object(masked: float, backscatter: float, hidden: float) -> bool:
    """Return True if a scan is poor by backscatter; shares of 0 to 1.

    ``masked``: share of the object's pixels without coordinates; ``backscatter``: that of backscatter in the light;
    ``hidden``: share of the pixels in which backscatter is brighter than the object.
    """
    much = backscatter > MOST_BACKSCATTER or (backscatter > DIRTY_BACKSCATTER and masked > DIRTY_MASKED)
    return much or hidden > HIDDEN


def _fault(sample: BackscatterSample) -> Fault | None:
    masked, specks = sample.masked_share, sample.speck_share
    if masked is None:
        return None
    by_backscatter = hides_object(masked, sample.backscatter_share or 0.0, sample.hidden_share or 0.0)
    by_specks = specks is not None and specks > DIRTY_SPECKS
    if not by_backscatter and not by_specks:
        return None
    detail = "specks pass before the object" if by_specks else "backscatter hides the object"
    numbers = {"coverage_percent": 100.0 * (1.0 - masked)}
    return Fault(FaultCode.WATER_DIRTY, detail, numbers)


def _rays(
    images: ScanImages, cells: Cells, cloud: Cloud, rig: StereoRig, water_index: float
) -> tuple[Cells, GatheredLight, float] | None:
    """Return the cells that have points, the light that their rays gather, and that of the central ray.

    The latter ends at the middle of the volume, in water without attenuation.
    """
    n = len(cloud.pixel)
    if n < MIN_CELLS or len(cells.number) < MIN_CELLS:
        return None
    decoded = images.decoded["left"]
    rows, columns = decoded.p_px.shape
    stride = slice(None, None, max(1, n // POINTS))
    pixel = cloud.pixel[stride]
    points = cloud.points_mm[stride].astype(np.float64)
    pattern = np.stack([decoded.p_px.reshape(-1)[pixel], decoded.q_px.reshape(-1)[pixel]], -1).astype(np.float64)
    sequence = images.sequence
    beam = beam_of(rig, water_index, points, pattern, (sequence.width_px, sequence.height_px))
    if beam is None:
        return None
    ends, chosen = _depths(cells, pixel, points[:, 2], (rows, columns))
    cells = _only(cells, chosen)
    if len(cells.number) < MIN_CELLS:
        return None
    origins, directions = rig.left.rays(cells.uv_px, water_index)
    ends_mm = (ends[chosen] - origins[:, 2]) / directions[:, 2]
    return cells, gather(beam, origins, directions, ends_mm), _clear(beam, rig, water_index)


def _depths(
    cells: Cells, pixel: NDArray[np.uint32], depth_mm: Array, shape: tuple[int, int]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean depth of the points in each cell, and whether there are enough of them."""
    v, u = np.divmod(pixel.astype(np.int64), shape[1])
    number = cell_of(u, v, shape)
    count = np.bincount(number, minlength=CELLS[0] * CELLS[1])
    total = np.bincount(number, depth_mm, CELLS[0] * CELLS[1])
    with np.errstate(invalid="ignore"):
        return (total / count)[cells.number], (count >= MIN_POINTS)[cells.number]


def _only(cells: Cells, chosen: NDArray[np.bool_]) -> Cells:
    return Cells(
        cells.number[chosen],
        cells.pixels[chosen],
        cells.uv_px[chosen],
        cells.backscatter_dn[chosen],
        cells.sigma_dn[chosen],
        cells.signal_dn[chosen],
        cells.dark_dn[chosen],
    )


def _clear(beam: ProjectorBeam, rig: StereoRig, water_index: float) -> float:
    left = rig.left
    uv = np.array([[(left.width_px - 1) / 2.0, (left.height_px - 1) / 2.0]])
    origin, direction = left.rays(uv, water_index)
    centre = rig.volume_centre_mm(water_index)
    end = np.linalg.norm(centre - origin, axis=-1)
    return float(gather(beam, origin, direction, end).backscatter(0.0)[0])


def _strength(gathered: Array, backscatter: Array, sigma: Array) -> float:
    return max(float(np.sum(gathered * backscatter / sigma**2) / np.sum(gathered**2 / sigma**2)), 1e-9)


def _backscatter_percent(attenuation: Attenuation, cells: Cells, gathered: GatheredLight, clear: float) -> float | None:
    falls = gathered.falls * np.exp(-attenuation.per_m * gathered.ends_m)
    # Light that a surface of albedo 1 would send back from the brightest place of the beam.
    white_dn = float(np.percentile(cells.signal_dn / falls, 75.0)) / ALBEDO
    if white_dn <= 0.0:
        return None
    return 100.0 * attenuation.strength_dn * clear / (ALBEDO * white_dn)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
