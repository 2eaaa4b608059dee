"""Generator of the tables in ``docs/performance.md`` from measured values."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FELT_BEGIN, FELT_END = (
    "<!-- felt: ./dev bench felt, ./dev bench --write-docs -->",
    "<!-- end of felt -->",
)
BEGIN, END = "<!-- figures: ./dev bench --write-docs -->", "<!-- end of figures -->"
WHOLE_BEGIN, WHOLE_END = (
    "<!-- whole scan: ./dev bench whole_scan, ./dev bench --write-docs -->",
    "<!-- end of whole scan -->",
)
COMPILE_BEGIN, COMPILE_END = (
    "<!-- compiling: ./dev bench compile, ./dev bench --write-docs -->",
    "<!-- end of compiling -->",
)
AGAINST, COMPILING = "whole_scan_against.md", "compile.md"
"""Tables that their benches write beside ``latest.json``; the first one is no part of the page."""
TIMELINE = "timeline.png"
WHOLE_SCAN: dict[str, tuple[tuple[str, str, str], ...]] = {
    "By the clock of the reference machine": (
        ("coarse_reference_ms", "disc: last frame to coarse cloud", "ms"),
        ("verdict_reference_ms", "disc: last frame to verdict", "ms"),
        ("complete_reference_ms", "disc: last frame to full cloud, with gaps and expected errors", "ms"),
        ("compensation_reference_ms", "moving: compensation", "ms"),
        ("complete_machine_factor", "this machine's times against that one's", "×"),
    ),
    "Memory of the worker": (
        ("complete_peak_mb", "disc: peak, shared frames and points included", "MB"),
        ("moving_complete_own_peak_mb", "moving: its own peak, against what the product lets it take", "MB"),
    ),
}
"""Tables of a whole scan: title, then key, words and unit of each row."""
SCENES = (("", "disc"), ("pipe_", "pipe"), ("turbid_", "shell in turbid water"), ("moving_", "moving, compensated"))
"""Prefix of keys in ``latest.json``, and head of the column."""
BY_SCENE: dict[str, tuple[tuple[str, str], ...]] = {
    "Here": (
        ("complete_points", "points"),
        ("coarse_path_cpu_ms", "last frame to coarse cloud, ms CPU"),
        ("verdict_cpu_ms", "last frame to verdict, ms CPU"),
        ("complete_cpu_ms", "last frame to full cloud, ms CPU"),
        ("complete_scan_cpu_ms", "whole scan, ms CPU"),
        ("coarse_wall_ms", "last frame to coarse cloud, ms by the clock"),
        ("verdict_wall_ms", "last frame to verdict, ms by the clock"),
        ("complete_wall_ms", "last frame to full cloud, ms by the clock"),
        ("durable_wall_ms", "last frame to raw frames durable, ms by the clock"),
    ),
    "Part by part, ms CPU": (
        ("part_recording_cpu_ms", "while recording: 23 pairs"),
        ("part_last_pair_cpu_ms", "last pair"),
        ("part_identity_cpu_ms", "identity"),
        ("part_coarse_cloud_cpu_ms", "coarse cloud"),
        ("part_light_cpu_ms", "light"),
        ("part_water_cpu_ms", "water"),
        ("part_sight_cpu_ms", "sight"),
        ("part_motion_cpu_ms", "motion"),
        ("part_sides_cpu_ms", "left and right"),
        ("part_medium_cpu_ms", "medium"),
        ("part_windows_cpu_ms", "windows"),
        ("part_grey_cpu_ms", "grey of both cameras"),
        ("part_compensation_cpu_ms", "compensation"),
        ("part_full_cloud_cpu_ms", "full cloud"),
    ),
}
"""Tables with a column for each scene."""
ENDURANCE = "A hundred scans in real time, `./dev bench endurance`"
TABLES: dict[str, tuple[tuple[str, str, str], ...]] = {
    "A scan, here": (
        ("recording_cpu_ms", "while recording: 23 pairs of frames", "ms CPU"),
        ("pair_max_cpu_ms", "the dearest pair", "ms CPU"),
        ("last_frame_cpu_ms", "last pair", "ms CPU"),
        ("coarse_step_cpu_ms", "prepare and coarse cloud", "ms CPU"),
        ("full_step_cpu_ms", "full cloud", "ms CPU"),
        ("coarse_cpu_ms", "last frame to coarse cloud", "ms CPU"),
        ("full_cpu_ms", "last frame to full cloud", "ms CPU"),
        ("scan_cpu_ms", "whole scan", "ms CPU"),
        ("ratio_roofline", "whole scan against memory traffic alone", "×"),
        ("ratio_full_roofline", "full cloud against memory traffic alone", "×"),
        ("memory_read_gb_s", "memory reads, one thread", "GB/s"),
        ("memory_write_gb_s", "memory writes, one thread", "GB/s"),
    ),
    "Other ways: their time over ours": (
        ("ratio_opencv_decode", "one camera, OpenCV's vector operations", "×"),
        ("ratio_numpy_decode", "one camera, NumPy in float32", "×"),
        ("ratio_fringes", "one camera, `fringes`", "×"),
        ("ratio_cv2_structured_light", "whole scan, `cv2.structured_light`", "×"),
        ("ratio_numpy_kdtree", "whole scan, float64 NumPy and KD-tree", "×"),
    ),
    "The worker process, and the disk": (
        ("worker_scan_cpu_ms", "CPU time of the worker for a scan at 60 Hz", "ms CPU"),
        ("worker_coarse_wall_ms", "last frame to coarse cloud, by the clock", "ms"),
        ("worker_full_wall_ms", "last frame to full cloud, by the clock", "ms"),
        ("worker_ready_s", "start until warm", "s"),
        ("first_scan_s", "start until the first cloud, with compiled kernels", "s"),
        ("first_scan_cpu_s", "the worker's CPU time for that", "s CPU"),
        ("worker_peak_mb", "peak memory, shared frames included", "MB"),
        ("raw_durable_ms", "raw frames durable, beyond the disk's own time", "ms"),
        ("disk_ms", "the disk's own time for these bytes", "ms"),
        ("publish_ms", "cloud and manifest durable, scan published", "ms"),
    ),
    ENDURANCE: (
        ("endurance_scans", "scans saved: 24 pairs of 1600 × 1200 at 60 Hz each", "scans"),
        ("endurance_lost_frames", "frames lost in them", "frames"),
        ("endurance_refused", "scans refused meanwhile, none of them silently", "scans"),
        ("endurance_answer_ms", "blank to the next flip (the next blank comes after 16.7)", "ms"),
        ("endurance_answer_p99_ms", "the same, 99 %", "ms"),
        ("endurance_late_flips", "blanks of sequences that found no flip, refused scans included", "blanks"),
        ("endurance_world_late_p99_ms", "lateness of the simulated blanks themselves, 99 %", "ms"),
        ("endurance_screen_hz", "new pictures on the display between sequences", "Hz"),
        ("coarse_latency_ms", "last frame to coarse cloud", "ms"),
        ("full_latency_ms", "last frame to full cloud", "ms"),
        ("full_latency_p95_ms", "the same, 95 %", "ms"),
        ("saved_latency_ms", "last frame to raw frames durable", "ms"),
        ("service_memory_mb", "service and simulated world at the last scan", "MB"),
        ("service_growth_mb", "its growth since the tenth scan", "MB"),
        ("worker_memory_mb", "worker at the last scan", "MB"),
        ("worker_growth_mb", "its growth since the tenth scan", "MB"),
    ),
    "Against the truth": (
        ("completeness_percent", "completeness, smooth surface", "%"),
        ("false_matches_ppm", "false matches, smooth surface", "ppm"),
        ("step_completeness_percent", "completeness with a bar in front, its edges counted", "%"),
        ("step_false_matches_ppm", "false matches with a bar in front", "ppm"),
        ("bias_px", "bias of the correspondence", "px"),
        ("noise_mm", "noise of the depth", "mm"),
        ("float32_max_px", "wrapped phase, float32 against float64, worst pixel", "px"),
        ("float32_coordinate_max_px", "coordinate as stored in 32 bits, worst pixel", "px"),
    ),
}

FELT: dict[str, tuple[tuple[str, str, str, str, str], ...]] = {
    "A diver waits": (
        ("felt_verdict_ms", "key to verdict", "ms", "recording", "felt_recording_ms"),
        ("felt_coarse_ms", "key to coarse cloud", "ms", "recording", "felt_recording_ms"),
        ("felt_full_ms", "key to full cloud, 1.4 million points", "ms", "recording", "felt_recording_ms"),
        ("felt_compensated_ms", "key to full cloud, motion compensated", "ms", "recording", "felt_recording_ms"),
        ("felt_aim_s", "power to AIM, on simulated devices", "s", "worker until warm", "felt_ready_s"),
    ),
    "A desk waits": (
        ("felt_version_s", "`kingfisher --version`", "s", "bare Python", "felt_python_s"),
        ("felt_version_cpu_s", "the same", "s CPU", "bare Python", "felt_python_cpu_s"),
        ("felt_list_s", "`kingfisher scans list`, no scans", "s", "bare Python", "felt_python_s"),
        ("felt_list_cpu_s", "the same", "s CPU", "bare Python", "felt_python_cpu_s"),
        ("felt_cloud_s", "`kingfisher cloud`, a stored scan", "s", "bare Python", "felt_python_s"),
        ("felt_cloud_cpu_s", "the same", "s CPU", "bare Python", "felt_python_cpu_s"),
        ("felt_object_s", "`kingfisher object solve`, three small scans", "s", "bare Python", "felt_python_s"),
        ("felt_object_cpu_s", "the same", "s CPU", "bare Python", "felt_python_cpu_s"),
    ),
    "The limit": (
        ("felt_recording_ms", "recording: 24 frames at 60 Hz", "ms", "", ""),
        ("roofline_scan_ms", "a scan's memory traffic alone", "ms", "our clouds", "scan_cpu_ms"),
        ("roofline_full_ms", "of it the full cloud's", "ms", "ours", "full_step_cpu_ms"),
        ("felt_shared_mb", "frames and points that worker and service share", "MB", "worker's peak", "felt_peak_mb"),
    ),
    "The peers": (
        ("opencv_decode_cpu_ms", "one camera decoded, OpenCV's vector operations", "ms CPU", "ours", "decode_cpu_ms"),
        ("numpy_decode_cpu_ms", "the same, NumPy in float32", "ms CPU", "ours", "decode_cpu_ms"),
        ("fringes_cpu_ms", "the same without Gray code, `fringes`", "ms CPU", "ours", "decode_cpu_ms"),
        (
            "cv2_structured_light_cpu_ms", "both cameras, whole pixels, `cv2.structured_light`",
            "ms CPU", "our clouds", "scan_cpu_ms",
        ),
        ("numpy_kdtree_cpu_ms", "a cloud, float64 NumPy and KD-tree", "ms CPU", "our clouds", "scan_cpu_ms"),
    ),
}  # fmt: skip
"""The groups of the page's first table: key, words and unit of each row, then words and key of the figure beside it."""


HEALTH_BEGIN, HEALTH_END = "<!-- table: ./dev bench health, ./dev bench --write-docs -->", "<!-- end of table -->"


def write_health(out: Path, docs: Path) -> None:
    """Put the table and the picture of ``./dev bench health`` into the documents, if it was run.

    Raises OSError, and ValueError for a document without marks.
    """
    table, picture = out / "health.md", out / "health.png"
    if not table.exists():
        return
    document = docs / "calibration-health.md"
    text = document.read_text(encoding="utf-8")
    if HEALTH_BEGIN not in text or HEALTH_END not in text:
        raise ValueError(f"{document} has no marks {HEALTH_BEGIN} and {HEALTH_END}")
    before, after = text.split(HEALTH_BEGIN)[0], text.split(HEALTH_END)[1]
    table_text = table.read_text(encoding="utf-8")
    document.write_text(f"{before}{HEALTH_BEGIN}\n\n{table_text}\n{HEALTH_END}{after}", encoding="utf-8")
    (docs / "pictures").mkdir(exist_ok=True)
    (docs / "pictures" / "calibration-health.png").write_bytes(picture.read_bytes())


def write_figures(latest: Path, document: Path) -> None:
    """Replace the text between the marks, for each block with a figure in ``latest``.

    The picture of the whole scan is copied from beside ``latest`` to beside ``document``. Raises OSError, and
    ValueError for a document without marks.
    """
    latest_figures: dict[str, Any] = json.loads(latest.read_text(encoding="utf-8"))
    machine = latest_figures.get("machine", {})
    on = f"On {machine.get('processor')}, {machine.get('processors')} processors; medians of one run."
    text = document.read_text(encoding="utf-8")
    if FELT_BEGIN in text and any(key.startswith("felt_") for key in latest_figures):
        text = _replaced(document, text, (FELT_BEGIN, FELT_END), [on, *_felt(latest_figures)])
    if WHOLE_BEGIN in text and any(key in latest_figures for key in ("verdict_cpu_ms", "complete_cpu_ms")):
        lines = [on, *_with_targets(latest_figures, WHOLE_SCAN), *_by_scene(latest_figures)]
        text = _replaced(document, text, (WHOLE_BEGIN, WHOLE_END), lines)
        picture = latest.parent / TIMELINE
        if picture.exists():
            (document.parent / "pictures").mkdir(exist_ok=True)
            (document.parent / "pictures" / TIMELINE).write_bytes(picture.read_bytes())
    if BEGIN not in text or any(key in latest_figures for rows in TABLES.values() for key, _, _ in rows):
        text = _replaced(document, text, (BEGIN, END), [on, *_with_targets(latest_figures, TABLES)])
    compiling = latest.parent / COMPILING
    if compiling.exists():
        text = _replaced(
            document, text, (COMPILE_BEGIN, COMPILE_END), compiling.read_text(encoding="utf-8").splitlines()
        )
    document.write_text(text, encoding="utf-8")


def _replaced(document: Path, text: str, marks: tuple[str, str], lines: list[str]) -> str:
    begin, end = marks
    if begin not in text or end not in text:
        raise ValueError(f"{document} has no marks {begin} and {end}")
    before, after = text.split(begin)[0], text.split(end)[1]
    return before + begin + "\n\n" + "\n".join(lines) + "\n\n" + end + after


def _with_targets(latest_figures: dict[str, Any], tables: dict[str, tuple[tuple[str, str, str], ...]]) -> list[str]:
    lines = []
    for title, rows in tables.items():
        lines += ["", f"| {title} | median | tenth to nine tenths | | target |", "|---|---:|---|---|---|"]
        lines += [row(latest_figures, *entry) for entry in rows]
        lines += _version_line(latest_figures, [key for key, _, _ in rows])
    return lines


def _felt(latest_figures: dict[str, Any]) -> list[str]:
    """Return the table of waiting times, limits and peers."""
    lines, keys = ["", "| what | here | unit | beside it |", "|---|---:|---|---|"], []
    for group, rows in FELT.items():
        lines.append(f"| **{group}** | | | |")
        for key, name, unit, beside, beside_key in rows:
            value, beside_value = latest_figures.get(key), latest_figures.get(beside_key)
            figure = "—" if value is None else short(value)
            lines.append(
                f"| {name} | {figure} | {unit} | {'' if beside_value is None else f'{beside} {short(beside_value)} '}|"
            )
            keys += [key, beside_key]
    return lines + _version_line(latest_figures, keys)


def _version_line(latest_figures: dict[str, Any], keys: Sequence[str]) -> list[str]:
    """Return the line below a table with first and last day and version of its figures; empty without these."""
    version_of = latest_figures.get("versions", {})
    versions = sorted({version_of[key] for key in keys if key in version_of and latest_figures.get(key) is not None})
    if not versions:
        return []
    ends = [version_text.rstrip(")").split(" (") for version_text in (versions[0], versions[-1])]
    days, commits = (" to ".join(dict.fromkeys(end[k] for end in ends)) for k in (0, 1))
    return ["", f"*Figures of {days} ({commits}).*"]


def _by_scene(latest_figures: dict[str, Any]) -> list[str]:
    """Return tables with a column for each scene; missing values are a dash, rows without values are left out."""
    lines = []
    for title, rows in BY_SCENE.items():
        lines += ["", f"| {title} | {' | '.join(head for _, head in SCENES)} |", "|---|" + "---:|" * len(SCENES)]
        for key, name in rows:
            values = [latest_figures.get(scene + key) for scene, _ in SCENES]
            if any(value is not None for value in values):
                lines.append(f"| {name} | {' | '.join('—' if value is None else short(value) for value in values)} |")
        lines += _version_line(latest_figures, [scene + key for key, _ in rows for scene, _ in SCENES])
    return lines


def row(latest_figures: dict[str, Any], key: str, name: str, unit: str) -> str:
    """Return one line: value, spread, unit, target with its verdict, or the reason for a missing value."""
    value = latest_figures.get(key)
    if value is None:
        return f"| {name} | — | | | {latest_figures.get('why', {}).get(key, 'not measured')} |"
    spread = latest_figures.get("spread", {}).get(key)
    between = " " if spread is None else f" {short(spread[0])} … {short(spread[1])} "
    bounds = latest_figures.get("bounds", {}).get(key, {})
    is_kept = bounds.get("at_least", value) <= value <= bounds.get("at_most", value)
    target = " ".join(f"{sign} {short(bounds[name])}" for name, sign in SIGNS.items() if name in bounds)
    verdict = " " if not bounds else f" {target}{'' if is_kept else ' **missed**'} "
    return f"| {name} | {short(value)} |{between}| {unit} |{verdict}|"


SIGNS = {"at_most": "≤", "at_least": "≥"}


def short(value: float) -> str:
    """Return three significant digits; four between 99 and 100."""
    if abs(value) >= 1000.0:
        return f"{value:.0f}"
    return f"{value:.4g}" if 99.0 <= value <= 100.0 else f"{value:.3g}"
