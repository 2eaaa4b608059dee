"""Owns what an evaluation says to people and programs: one JSON-ready table, and one HTML page that needs no other file."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from appliance.evaluation.pictures import deviation_map, histogram, scale_mm
from appliance.evaluation.points import OUTLIER_SHARE, NotFound, Used
from appliance.evaluation.result import Artefact, Result

SCHEMA = 1
TITLE = "Evaluation after VDI/VDE 2634"
_STYLE = (
    "body{font:15px/1.45 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:.6em 0}td,th{border:1px solid #bbb;padding:.2em .6em;text-align:left}"
    "img{max-width:100%;border:1px solid #bbb}figure{display:inline-block;margin:.4em}figcaption{font-size:.85em}"
    ".no{color:#a00;font-weight:bold}"
)


@dataclass(frozen=True, slots=True)
class Item:
    """One scan of the evaluation, with where it came from."""

    scan: str
    result: Result
    provenance: Mapping[str, Any]
    """When, water, temperatures, hashes: JSON-ready."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All scans and what they have in common."""

    about: Mapping[str, Any]
    """Who, serials, calibration, version: JSON-ready."""
    reference_mm: float
    left_width_px: int
    items: Sequence[Item]

    @property
    def complete(self) -> bool:
        """Whether every artefact was found."""
        return not any(isinstance(item.result.fit, NotFound) for item in self.items)


def as_json(evaluation: Evaluation) -> dict[str, Any]:
    """JSON-ready; errors in percent, lengths in mm, unknown values null."""
    return {
        "schema": SCHEMA,
        "title": TITLE,
        "about": dict(evaluation.about),
        "reference_mm": evaluation.reference_mm,
        "outliers_allowed_percent": 100.0 * OUTLIER_SHARE,
        "complete": evaluation.complete,
        "summary": summary(evaluation),
        "scans": [_item(item) for item in evaluation.items],
    }


def summary(evaluation: Evaluation) -> dict[str, float | None]:
    """The paper's Table 2 for this evaluation: the largest error of each kind in percent, the mean noise in mm."""
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
    }


def as_html(evaluation: Evaluation) -> str:
    """The page; pictures are in it as PNG, and nothing is loaded from elsewhere."""
    content = as_json(evaluation)
    parts = [
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{TITLE}</title><style>{_STYLE}</style>',
        f"<h1>{TITLE}</h1>",
        _table(content["about"]),
        "<h2>Largest errors, mean noise</h2>",
        _table(content["summary"]),
        (
            f"<p>E_L = (measured − calibrated)/calibrated. E_F = range of the distances to the best-fit plane / d_r, "
            f"d_r = {evaluation.reference_mm:g} mm; E_F,sys is that of a bivariate cubic through them. At most "
            f"{100 * OUTLIER_SHARE:g} % of a surface's points are removed as outliers.</p>"
        ),
    ]
    for item, written in zip(evaluation.items, content["scans"], strict=True):
        parts.append(f"<h2>Scan {html.escape(item.scan)}: {item.result.artefact.value}</h2>")
        if written["reason"] is not None:
            parts.append(f'<p class="no">Not evaluated: {html.escape(written["reason"])}.</p>')
        parts.append(_table({key: written[key] for key in ("e_f_percent", "e_f_sys_percent", "noise_mm")}))
        if written["lengths"]:
            parts.append(_rows(written["lengths"]))
        if written["surfaces"]:
            parts.append(_rows(written["surfaces"]))
        parts += [_pictures(n, u, evaluation.left_width_px) for n, u in item.result.surfaces.items()]
        parts.append(_table(written["provenance"]))
    return "\n".join([*parts, "</html>", ""])


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
                "sigma_mm": length.sigma_mm,
                "e_l_percent": 100.0 * length.e_l,
            }
            for length in result.lengths
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


def _pictures(name: str, used: Used, width_px: int) -> str:
    limit_um = 1000.0 * scale_mm(used)
    figures = []
    for what, data in (("deviation", deviation_map(used, width_px)), ("histogram", histogram(used))):
        text = html.escape(f"{name}: {what}, ±{limit_um:.0f} µm")
        source = base64.b64encode(data).decode()
        figures.append(
            f'<figure><img alt="{text}" src="data:image/png;base64,{source}"><figcaption>{text}</figcaption></figure>'
        )
    return "".join(figures)


def _table(values: Mapping[str, Any]) -> str:
    rows = "".join(f"<tr><th>{html.escape(str(k))}</th><td>{_cell(v)}</td></tr>" for k, v in values.items())
    return f"<table>{rows}</table>"


def _rows(rows: Sequence[Mapping[str, Any]]) -> str:
    head = "".join(f"<th>{html.escape(key)}</th>" for key in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{_cell(v)}</td>" for v in row.values()) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 10 else f"{value:.4f}"
    if isinstance(value, Mapping):
        return "; ".join(f"{html.escape(str(k))} {_cell(v)}" for k, v in value.items()) or "–"
    return html.escape(str(value))
