"""Owns the table of figures in ``docs/performance.md``: it is written from what was measured, never by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- figures: ./dev bench --write-docs -->", "<!-- end of figures -->"
ROWS = (
    ("coarse_cpu_ms", "last frame → coarse cloud", "ms CPU"),
    ("full_cpu_ms", "last frame → full cloud", "ms CPU"),
    ("scan_cpu_ms", "whole scan", "ms CPU"),
    ("machine_factor", "this machine against the target's (OpenCV's vector operations)", "×"),
    ("coarse_target_machine_ms", "coarse, on the target's machine (≤ 15)", "ms CPU"),
    ("full_target_machine_ms", "full, on the target's machine (≤ 50)", "ms CPU"),
    ("scan_target_machine_ms", "whole scan, on the target's machine (≤ 60)", "ms CPU"),
    ("roofline_scan_ms", "whole scan, if memory alone counted", "ms"),
    ("decode_cpu_ms", "decoding one camera", "ms CPU"),
    ("opencv_decode_cpu_ms", "… OpenCV's vector operations", "ms CPU"),
    ("numpy_decode_cpu_ms", "… NumPy float32", "ms CPU"),
    ("fringes_cpu_ms", "… package `fringes`, its eight sine images only", "ms CPU"),
    ("cv2_structured_light_cpu_ms", "OpenCV `GrayCodePattern`, both cameras, whole pixels", "ms CPU"),
    ("numpy_kdtree_cpu_ms", "whole scan, float64 NumPy with a KD-tree", "ms CPU"),
    ("ratio_numpy_kdtree", "… against ours (≥ 40)", "×"),
    ("worker_peak_mb", "peak memory of the worker, shared frames included (≤ 400)", "MB"),
    ("first_scan_s", "start of the worker → its first cloud (≤ 1.2)", "s"),
    ("raw_durable_ms", "raw frames durable, beyond the disk's own time (≤ 100)", "ms"),
    ("completeness_percent", "completeness (≥ 99.5)", "%"),
    ("false_matches_ppm", "false matches (≤ 100)", "ppm"),
    ("bias_px", "bias of the correspondence (≤ 0.001)", "px"),
    ("float32_max_px", "wrapped phase, float32 against float64 (≤ 1e-5)", "px"),
    ("float32_coordinate_max_px", "… the whole coordinate, stored in 32 bits", "px"),
)


def write_figures(latest: Path, document: Path) -> None:
    """Replace what lies between the marks. Raises OSError, and ValueError for a document without marks."""
    said: dict[str, Any] = json.loads(latest.read_text(encoding="utf-8"))
    text = document.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{document} has no marks {BEGIN} and {END}")
    machine = said.get("machine", {})
    lines = [
        f"On {machine.get('processor')}, {machine.get('processors')} processors.",
        "",
        "| what | value | |",
        "|---|---|---|",
    ]
    for key, name, unit in ROWS:
        value = said.get(key)
        shown = f"{value:.3g}" if value is not None else f"— ({said.get('why', {}).get(key, 'not measured')})"
        lines.append(f"| {name} | {shown} | {unit} |")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    document.write_text(before + BEGIN + "\n\n" + "\n".join(lines) + "\n\n" + END + after, encoding="utf-8")
