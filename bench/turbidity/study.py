"""Owns what is measured about turbid water: which waters, which artefacts, and the row that each scan leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from bench.metrology.judge import look_at
from bench.metrology.poses import unseen
from bench.spread import spread
from bench.turbidity.scan import MOST_GAIN_DB, Shutter, Taken, rig_in, set_water, take
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Imaging, Scene
from hw_sim.water.medium import Water

ATTENUATIONS_PER_M = (0.05, 0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
BACKSCATTER_M, BLUR_PX = 0.025, 0.75
"""Veil as a fraction of an object's light, and blur in px of 1600 per metre, of an attenuation of 1 /m: what the default
water has of both, in proportion to its attenuation."""
MILKY = 4.0
"""Times the veil of such water: fine sediment."""
SALINITY_PSU = 35.0
TRUTH = "modelled"
"""Rigs that the product's model can express: their true calibration leaves only what images add."""
SMALL_PX, ARTEFACT_PX = 400, 800
PLANE = (0.0, 0.0, 522.5, 10.0, -12.0, 0.0)
ARTEFACT_ATTENUATIONS_PER_M = (0.05, 0.5, 1.0, 2.0, 3.0)
BARS, PLANES = 2, 1
STRAIGHT = Imaging(response="linear")
"""As if patterns were drawn for the projector's response, exactly: what the water does, and no other bias of the phase."""
UM = 1000.0

Step = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Series:
    """What water does besides absorbing, and what the cameras may do about it."""

    name: str
    veil: float = 0.0
    """Times ``BACKSCATTER_M``."""
    blur: float = 0.0
    """Times ``BLUR_PX``."""
    salinity_psu: float = 0.0
    longer: bool = False
    """The exposure is chosen, up to what a frame has room for; else it is 12 ms."""
    most_gain_db: float = 0.0

    def water(self, attenuation_per_m: float) -> Water:
        """Of that attenuation."""
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
    """One scan of a plane."""

    series: str
    attenuation_per_m: float
    seed: int
    completeness_percent: float
    rms_um: float | None
    """Of the errors along the rays, without what counts as wrong."""
    sigma_um: float | None
    """Median of the expected errors."""
    sigma_ratio: float | None
    """RMS of errors in expected errors, without what counts as wrong."""
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
    """A plane in waters of every kind, before one rig."""
    kinds = [(one, attenuation) for one in series for attenuation in ATTENUATIONS_PER_M]
    work = partial(_plane, seed=seed, width_px=width_px)
    for (one, attenuation), row in zip(kinds, spread(work, kinds), strict=True):
        step(f"{one.name}, {attenuation:g} /m")
        yield row


def _plane(kind: tuple[Series, float], seed: int, width_px: int) -> Row:
    return plane(*kind, seed, width_px)


def plane(series: Series, attenuation_per_m: float, seed: int, width_px: int) -> Row:
    """One scan of it."""
    scene = Scene(object="plane", pose=PLANE, water=series.water(attenuation_per_m), imaging=STRAIGHT)
    taken = _take(series, scene, seed, width_px)
    said = taken.said
    good = taken.errors.seen & ~taken.wrong
    error, sigma = taken.errors.along_ray_mm[good], taken.cloud.sigma_mm[good]
    some = error.size > 0
    return Row(
        series.name,
        attenuation_per_m,
        seed,
        100.0 * taken.completeness,
        UM * _rms(error) if some else None,
        UM * float(np.median(sigma)) if some else None,
        _rms(error / sigma) if some else None,
        1e6 * float(np.mean(taken.wrong)) if taken.wrong.size else None,
        float(np.median(taken.cloud.modulation_dn)) if taken.wrong.size else None,
        1e3 * taken.shutter.exposure_s,
        taken.shutter.gain_db,
        said.veil_percent,
        said.attenuation_per_m,
        said.attenuation_sigma_per_m,
        said.judgement.fault is not None,
    )


def artefacts(seed: int, step: Step, width_px: int = ARTEFACT_PX) -> Iterator[ArtefactRow]:
    """Ball bars and planes at poses of their own, in fresh and salt water, the index set as it is."""
    kinds = [(series, attenuation) for series in ARTEFACT_SERIES for attenuation in ARTEFACT_ATTENUATIONS_PER_M]
    for rows in spread(partial(_artefacts, seed=seed, width_px=width_px), kinds):
        for row in rows:
            step(f"{row.artefact}, {row.series}, {row.attenuation_per_m:g} /m")
            yield row


def _artefacts(kind: tuple[Series, float], seed: int, width_px: int) -> list[ArtefactRow]:
    """All of them in one water."""
    series, attenuation = kind
    water = series.water(attenuation)
    truth = rig_in(set_water(Scene(water=water)), TRUTH, seed, width_px)
    rows: list[ArtefactRow] = []
    for name, pose in unseen(truth, BARS, PLANES, 0):
        scene = Scene(object=name, pose=pose, water=water, imaging=STRAIGHT)
        seen = look_at(_take(series, scene, seed, width_px).cloud, name, truth)
        rows.append(
            ArtefactRow(
                series.name,
                attenuation,
                seed,
                name,
                _percent(seen.e_l[0] if seen.e_l else None),
                _percent(seen.e_f),
                _percent(seen.e_f_sys),
                None if seen.noise_mm is None else UM * seen.noise_mm,
                seen.missing,
            )
        )
    return rows


def steps(rigs: int, artefact_rigs: int) -> int:
    """How many scans that is."""
    each = len(ARTEFACT_SERIES) * len(ARTEFACT_ATTENUATIONS_PER_M) * (BARS + PLANES)
    return rigs * len(SERIES) * len(ATTENUATIONS_PER_M) + artefact_rigs * each


def as_json(row: Row | ArtefactRow) -> dict[str, Any]:
    """One row of the file."""
    return asdict(row)


def _take(series: Series, scene: Scene, seed: int, width_px: int) -> Taken:
    renderer = Renderer(rig_in(set_water(scene), TRUTH, seed, width_px), scene)
    return take(renderer, None if series.longer else Shutter(), series.most_gain_db)


def _rms(values: np.ndarray[Any, np.dtype[np.floating[Any]]]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
