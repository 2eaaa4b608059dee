"""Study of turbid water: the waters, the artefacts, and the row of each scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from bench.metrology.judge import look_at
from bench.metrology.poses import unseen
from bench.spread import spread
from bench.turbidity.scan import MOST_GAIN_DB, JudgedScan, Shutter, rig_in, set_water, take
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Imaging, Scene
from hw_sim.water.medium import Water

ATTENUATIONS_PER_M = (0.05, 0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
BACKSCATTER_M, BLUR_PX = 0.025, 0.75
"""Backscatter as a fraction of an object's light, and blur in px of 1600 px per metre, for an attenuation of 1 /m, in
the proportion of the default water."""
MILKY = 4.0
"""Factor to the veil of default water: fine sediment."""
SALINITY_PSU = 35.0
TRUTH = "modelled"
"""Set of rigs within the product's model: with their true calibration, only errors of the images remain."""
SMALL_PX, ARTEFACT_PX = 400, 800
PLANE = (0.0, 0.0, 522.5, 10.0, -12.0, 0.0)
ARTEFACT_ATTENUATIONS_PER_M = (0.05, 0.5, 1.0, 2.0, 3.0)
BARS, PLANES = 2, 1
STRAIGHT = Imaging(response="linear")
"""Linear response, so that phase errors come from the water only."""
UM = 1000.0

Step = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Series:
    """Effects of the water beyond absorption, and the allowed exposures of the cameras."""

    name: str
    veil: float = 0.0
    """Times ``BACKSCATTER_M``."""
    blur: float = 0.0
    """Times ``BLUR_PX``."""
    salinity_psu: float = 0.0
    longer: bool = False
    """The exposure is chosen within the frame period; else it is 12 ms."""
    most_gain_db: float = 0.0

    def water(self, attenuation_per_m: float) -> Water:
        """Return the series' water of that attenuation."""
        return Water(
            salinity_psu=self.salinity_psu,
            attenuation_per_m=attenuation_per_m,
            backscatter=self.veil * BACKSCATTER_M * attenuation_per_m,
            blur_px_per_m=self.blur * BLUR_PX * attenuation_per_m,
        )


SERIES = (
    Series("attenuation alone"),
    Series("and forward scatter", blur=1.0),
    Series("and veil", veil=1.0),
    Series("all three", veil=1.0, blur=1.0),
    Series("all three, milky", veil=MILKY, blur=1.0),
    Series("all three, exposure", veil=1.0, blur=1.0, longer=True),
    Series("all three, exposure and gain", veil=1.0, blur=1.0, longer=True, most_gain_db=MOST_GAIN_DB),
    Series("milky, exposure and gain", veil=MILKY, blur=1.0, longer=True, most_gain_db=MOST_GAIN_DB),
    Series("salt, exposure and gain", 1.0, 1.0, SALINITY_PSU, longer=True, most_gain_db=MOST_GAIN_DB),
)
ARTEFACT_SERIES = (SERIES[6], SERIES[8])


@dataclass(frozen=True, slots=True)
class Row:
    """Results of one scan of a plane."""

    series: str
    attenuation_per_m: float
    seed: int
    completeness_percent: float
    rms_um: float | None
    """RMS error along the rays, without wrong points."""
    sigma_um: float | None
    """Median of the expected errors."""
    sigma_ratio: float | None
    """RMS of error over expected error, without wrong points."""
    wrong_ppm: float | None
    modulation_dn: float | None
    exposure_ms: float
    gain_db: float
    veil_percent: float | None
    said_per_m: float | None
    said_sigma_per_m: float | None
    said_dirty: bool


@dataclass(frozen=True, slots=True)
class ArtefactRow:
    """One scan of an artefact; errors in percent."""

    series: str
    attenuation_per_m: float
    seed: int
    artefact: str
    e_l_percent: float | None
    e_f_percent: float | None
    e_f_sys_percent: float | None
    noise_um: float | None
    missing: str | None


def planes(seed: int, step: Step, series: tuple[Series, ...] = SERIES, width_px: int = SMALL_PX) -> Iterator[Row]:
    """Yield the rows of a plane in all waters, for one rig."""
    kinds = [(kind, attenuation) for kind in series for attenuation in ATTENUATIONS_PER_M]
    work = partial(_plane, seed=seed, width_px=width_px)
    for (kind, attenuation), row in zip(kinds, spread(work, kinds), strict=True):
        step(f"{kind.name}, {attenuation:g} /m")
        yield row


def _plane(kind: tuple[Series, float], seed: int, width_px: int) -> Row:
    return plane(*kind, seed, width_px)


def plane(series: Series, attenuation_per_m: float, seed: int, width_px: int) -> Row:
    """Scan a plane once and return its row."""
    scene = Scene(object="plane", pose=PLANE, water=series.water(attenuation_per_m), imaging=STRAIGHT)
    scan = _take(series, scene, seed, width_px)
    judgement = scan.judgement
    good = scan.errors.seen & ~scan.wrong
    error, sigma = scan.errors.along_ray_mm[good], scan.cloud.sigma_mm[good]
    some = error.size > 0
    return Row(
        series.name,
        attenuation_per_m,
        seed,
        100.0 * scan.completeness,
        UM * _rms(error) if some else None,
        UM * float(np.median(sigma)) if some else None,
        _rms(error / sigma) if some else None,
        1e6 * float(np.mean(scan.wrong)) if scan.wrong.size else None,
        float(np.median(scan.cloud.modulation_dn)) if scan.wrong.size else None,
        1e3 * scan.shutter.exposure_s,
        scan.shutter.gain_db,
        judgement.veil_percent,
        judgement.attenuation_per_m,
        judgement.attenuation_sigma_per_m,
        judgement.judgement.fault is not None,
    )


def artefacts(seed: int, step: Step, width_px: int = ARTEFACT_PX) -> Iterator[ArtefactRow]:
    """Yield rows of ball bars and planes at different poses, in fresh and salt water of the set index."""
    kinds = [(series, attenuation) for series in ARTEFACT_SERIES for attenuation in ARTEFACT_ATTENUATIONS_PER_M]
    for rows in spread(partial(_artefacts, seed=seed, width_px=width_px), kinds):
        for row in rows:
            step(f"{row.artefact}, {row.series}, {row.attenuation_per_m:g} /m")
            yield row


def _artefacts(kind: tuple[Series, float], seed: int, width_px: int) -> list[ArtefactRow]:
    """Return the rows of all artefacts in one water."""
    series, attenuation = kind
    water = series.water(attenuation)
    truth = rig_in(set_water(Scene(water=water)), TRUTH, seed, width_px)
    rows: list[ArtefactRow] = []
    for name, pose in unseen(truth, BARS, PLANES, 0):
        scene = Scene(object=name, pose=pose, water=water, imaging=STRAIGHT)
        measured = look_at(_take(series, scene, seed, width_px).cloud, name, truth)
        rows.append(
            ArtefactRow(
                series.name,
                attenuation,
                seed,
                name,
                _percent(measured.e_l[0] if measured.e_l else None),
                _percent(measured.e_f),
                _percent(measured.e_f_sys),
                None if measured.noise_mm is None else UM * measured.noise_mm,
                measured.missing,
            )
        )
    return rows


def steps(rigs: int, artefact_rigs: int) -> int:
    """Return the number of scans."""
    each = len(ARTEFACT_SERIES) * len(ARTEFACT_ATTENUATIONS_PER_M) * (BARS + PLANES)
    return rigs * len(SERIES) * len(ATTENUATIONS_PER_M) + artefact_rigs * each


def as_json(row: Row | ArtefactRow) -> dict[str, Any]:
    """Return a row JSON-ready."""
    return asdict(row)


def _take(series: Series, scene: Scene, seed: int, width_px: int) -> JudgedScan:
    renderer = Renderer(rig_in(set_water(scene), TRUTH, seed, width_px), scene)
    return take(renderer, None if series.longer else Shutter(), series.most_gain_db)


def _rms(values: np.ndarray[Any, np.dtype[np.floating[Any]]]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
