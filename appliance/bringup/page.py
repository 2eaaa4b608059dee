"""Owns the page about a measured projector, and the pictures beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from appliance.bringup.exposures import Trial
from appliance.bringup.finding import Finding
from appliance.bringup.light import SLICE_US
from appliance.bringup.plots import plot, png
from appliance.bringup.projector import RAMP_CODES, ProjectorMeasured
from appliance.bringup.response_check import ramp_codes
from appliance.bringup.rig_edit import KeyValue
from appliance.evaluation.page import PAGE_END, figure, page_head, rows, table

PAGE = "projector.html"
MOST_CURVES = 5


def pictures_of(measured: ProjectorMeasured, period_us: float) -> dict[str, tuple[str, bytes]]:
    """Return the pictures, caption and PNG, by the name of their file."""
    times_ms = {
        code: np.asarray(SLICE_US * (np.arange(len(p)) + 0.5) / 1000.0, np.float64)
        for code, p in measured.profiles.items()
    }
    shown = list(measured.profiles)[:MOST_CURVES]
    found = {
        "light.png": (
            "Light of a flash over time; red: the lamp's windows",
            plot(
                {f"code {code}": (times_ms[code], measured.profiles[code]) for code in shown},
                "ms after the blank of the flip",
                "grey values per slice",
                _edges_ms(measured, period_us),
            ),
        )
    }
    curves = _curves(measured)
    if curves:
        codes = ramp_codes(RAMP_CODES).astype(np.float64)
        found["grey.png"] = (
            "Light by code, as exposures see it",
            plot({name: (codes, measured.ramps[trial]) for name, trial in curves.items()}, "code", "share of white"),
        )
    for name, image in measured.pictures.items():
        what = (
            "A checker of single pixels: grey, without bars"
            if name.startswith("checker")
            else "An L: upright, not mirrored"
        )
        found[f"{name}.png"] = (f"{what} ({name.rpartition('_')[2]} camera)", png(image))
    return found


def projector_page(
    findings: Sequence[Finding],
    keys: Mapping[KeyValue, object],
    measured: ProjectorMeasured,
    pictures: Mapping[str, tuple[str, bytes]],
) -> str:
    """Return the page as HTML; all pictures are in it."""
    parts = [page_head("Kingfisher: the projector, as its own cameras see it"), findings_table(findings)]
    if keys:
        parts.append(
            "<h2>Keys of the rig file</h2>" + table({f"[{p.table}] {p.key}": value for p, value in keys.items()})
        )
    parts.append("<h2>What was seen</h2>" + "".join(figure(caption, data) for caption, data in pictures.values()))
    # All of them, not only the good: who asks for help is asked for these first.
    trials = trials_of(measured)
    parts.append(
        "<h2>Every exposure that was tried</h2>" + (rows(trials) if trials else "<p>None fits into the light.</p>")
    )
    return "".join(parts) + PAGE_END


def trials_of(measured: ProjectorMeasured) -> list[dict[str, Any]]:
    """Return every delay and exposure that was tried and what it sees, a row each."""
    return [
        {
            "delay, µs": trial.delay_us,
            "exposure, ms": trial.exposure_us / 1000.0,
            "grey is": shape.shape.value,
            "off a line, %": 100.0 * shape.line_rms,
            "largest fall, %": 100.0 * shape.falls,
            "two passes differ, %": 100.0 * shape.repeat_rms,
            "power": shape.power,
        }
        for trial, shape in measured.responses.items()
    ]


def findings_table(findings: Sequence[Finding]) -> str:
    """Return the findings as a table, what is wrong marked."""
    # Columns that would be empty are left out: the page is read on small screens, too.
    limits, remedies = any(one.limits for one in findings), any(one.remedy for one in findings)
    lines = [
        {
            "": "good" if one.ok else "WRONG",
            "check": one.name,
            "seen": one.said,
            **({"limits": one.limits} if limits else {}),
            **({"do": one.remedy or None} if remedies else {}),
        }
        for one in findings
    ]
    # Marked after the cells were escaped: the word is ours.
    return rows(lines).replace("<td>WRONG</td>", '<td class="no">WRONG</td>')


def _edges_ms(measured: ProjectorMeasured, period_us: float) -> list[float]:
    first_us = measured.timing.latency_blanks * period_us
    return [(first_us + edge) / 1000.0 for one in measured.timing.windows for edge in (one.begins_us, one.ends_us)]


def _curves(measured: ProjectorMeasured) -> dict[str, Trial]:
    """Return the trials to be drawn: what is offered, else the straightest."""
    trials = sorted(
        measured.ramps, key=lambda trial: (not measured.responses[trial].usable, measured.responses[trial].line_rms)
    )
    return {f"{t.exposure_us / 1000.0:g} ms from {t.delay_us} us": t for t in trials[:MOST_CURVES]}
