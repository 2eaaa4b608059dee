"""The report of an evaluation: JSON, and one HTML page that needs no other file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from appliance.base import ColourScale, Page, histogram, png
from appliance.measure.accept.acceptance import Symbol, overall
from appliance.measure.accept.points import OUTLIER_SHARE, FitPoints, NotFound
from appliance.measure.accept.result import Artefact, Result

SCHEMA = 1
TITLE = "Evaluation after VDI/VDE 2634"
WIDEST_PX = 640
_EMPTY = 32


@dataclass(frozen=True, slots=True)
class Item:
    """One scan of the evaluation, with its source."""

    scan: str
    result: Result
    provenance: Mapping[str, Any]
    """Provenance of the cloud: time, water, temperatures, hashes; JSON-ready."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All scans and their common data."""

    header: Mapping[str, Any]
    """Person, serials, calibration, version: JSON-ready."""
    reference_mm: float
    left_width_px: int
    items: Sequence[Item]

    @property
    def complete(self) -> bool:
        """True if every artefact was found."""
        return not any(isinstance(item.result.fit, NotFound) for item in self.items)

    def as_json(self) -> dict[str, Any]:
        """Return the evaluation JSON-ready; errors in percent, lengths in mm, unknown values null."""
        return {
            "schema": SCHEMA,
            "title": TITLE,
            "about": dict(self.header),
            "reference_mm": self.reference_mm,
            "outliers_allowed_percent": 100.0 * OUTLIER_SHARE,
            "complete": self.complete,
            "limits_kept": overall(q for item in self.items for q in item.result.quantities).value,
            "summary": summary(self),
            "scans": [_item(item) for item in self.items],
        }

    def as_html(self) -> str:
        """Return the page; images are embedded as PNG, and it loads no other file."""
        content = self.as_json()
        page = Page(TITLE, facts=content["about"])
        page.heading("Largest errors, mean noise")
        page.facts(content["summary"])
        page.note(
            "E_L = (measured − calibrated)/calibrated. E_F = range of the distances to the best-fit plane / d_r, "
            f"d_r = {self.reference_mm:g} mm; E_F,sys is that of a bivariate cubic through them. At most "
            f"{100 * OUTLIER_SHARE:g} % of a surface's points are removed as outliers."
        )
        page.note(
            "PF = range of the radial distances of a ball's points from their best-fit sphere, its radius free. PS = its "
            "diameter − the calibrated one. SD = measured − calibrated distance of the centres. F = range of the distances "
            "from the best-fit plane. Uncertainties are expanded (k = 2), of noise and certificate; a limit is kept when "
            f"it is for every value within them. Limits: {content['limits_kept']}."
        )
        for item, written in zip(self.items, content["scans"], strict=True):
            page.heading(f"Scan {item.scan}: {item.result.artefact.value}")
            # As in the JSON, an artefact that was not found must not look like one without errors.
            if written["reason"] is not None:
                page.problem(f"Not evaluated: {written['reason']}.")
            page.facts({key: written[key] for key in ("e_f_percent", "e_f_sys_percent", "noise_mm")})
            for key in ("lengths", "quantities", "surfaces"):
                if written[key]:
                    page.rows(written[key])
            for name, used in item.result.surfaces.items():
                _add_pictures(page, name, used, self.left_width_px)
            page.facts(written["provenance"])
        return page.as_html()


def summary(evaluation: Evaluation) -> dict[str, float | None]:
    """Return the paper's Table 2: largest errors in percent, mean noise in mm, and PF, PS, SD and F."""
    results = [item.result for item in evaluation.items]

    def worst(values: list[float | None]) -> float | None:
        return max((100.0 * v for v in values if v is not None), default=None)

    noises = [r.noise_mm for r in results if r.noise_mm is not None]
    return {
        "e_l_ball_bar_percent": worst([r.worst_e_l for r in results if r.artefact is Artefact.BALL_BAR]),
        "e_l_frustum_percent": worst([r.worst_e_l for r in results if r.artefact is Artefact.FRUSTUM]),
        "e_f_percent": worst([r.e_f for r in results]),
        "e_f_sys_percent": worst([r.e_f_sys for r in results]),
        "noise_mm": sum(noises) / len(noises) if noises else None,
        **{f"{symbol.value.lower()}_mm": _largest(results, symbol) for symbol in Symbol},
    }


def _largest(results: Sequence[Result], symbol: Symbol) -> float | None:
    """Return the value of a quantity with the largest absolute value, with its sign."""
    values = [q.value_mm for result in results for q in result.quantities if q.symbol is symbol]
    # PS and SD have signs, which say whether a ball or the bar came out too large or too small.
    return max(values, key=abs, default=None)


def _item(item: Item) -> dict[str, Any]:
    result = item.result
    return {
        "scan": item.scan,
        "artefact": result.artefact.value,
        "reason": result.fit.reason if isinstance(result.fit, NotFound) else None,
        "e_f_percent": None if result.e_f is None else 100.0 * result.e_f,
        "e_f_sys_percent": None if result.e_f_sys is None else 100.0 * result.e_f_sys,
        "noise_mm": result.noise_mm,
        "lengths": [
            {
                "name": length.name,
                "measured_mm": length.measured_mm,
                "calibrated_mm": length.calibrated_mm,
                "error_mm": length.measured_mm - length.calibrated_mm,
                "sigma_mm": length.sigma_mm,
                "certificate_sd_mm": length.certificate_sd_mm,
                "expanded_uncertainty_mm": length.uncertainty_mm,
                "e_l_percent": 100.0 * length.e_l,
            }
            for length in result.lengths
        ],
        "quantities": [
            {
                "quantity": quantity.symbol.value,
                "of": quantity.part,
                "value_mm": quantity.value_mm,
                "expanded_uncertainty_mm": quantity.uncertainty_mm,
                "limit_mm": quantity.limit_mm,
                "kept": quantity.compliance.value,
                "points": quantity.points,
                "rejected": quantity.rejected,
            }
            for quantity in result.quantities
        ],
        "surfaces": [
            {
                "name": name,
                "points": used.count,
                "rejected": used.rejected_count,
                "rms_mm": used.rms_mm,
                "range_mm": used.range_mm,
            }
            for name, used in result.surfaces.items()
        ],
        "provenance": dict(item.provenance),
    }


def _add_pictures(page: Page, name: str, used: FitPoints, width_px: int) -> None:
    limit_mm = 3.0 * max(used.rms_mm, 1e-6)
    page.figure(f"{name}: deviation, ±{1000.0 * limit_mm:.0f} µm", deviation_map(used, width_px, limit_mm))
    micrometres = 1000.0 * used.residual_mm, -1000.0 * limit_mm, 1000.0 * limit_mm
    page.figure(f"{name}: histogram", histogram(*micrometres, "deviation in µm"))


def deviation_map(used: FitPoints, width_px: int, limit_mm: float) -> bytes:
    """Return the residuals in the left image, cut to the surface, as PNG; ``limit_mm`` has full colour.

    Red is positive, blue negative, dark without a point.
    """
    v, u = np.divmod(used.pixel.astype(np.int64), width_px)
    v, u = v - v.min(), u - u.min()
    # A cell is a whole number of pixels, so that all cells average equally many points.
    step = int(max(1, np.ceil((u.max() + 1) / WIDEST_PX), np.ceil((v.max() + 1) / WIDEST_PX)))
    height, width = int(v.max() // step) + 1, int(u.max() // step) + 1
    cell = (v // step) * width + u // step
    count = np.bincount(cell, minlength=height * width)
    mean = np.bincount(cell, used.residual_mm, minlength=height * width) / np.maximum(count, 1)
    image = np.where(count[:, None] > 0, ColourScale.DIVERGING.of(mean, -limit_mm, limit_mm), _EMPTY)
    return png(image.reshape(height, width, 3)[:, :, ::-1].astype(np.uint8))
