"""A row of scans along the water main, forth and, turned, back: poses, length and bending against the truth.

A common depth error is added to every scan, or not.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from appliance.desk.registration.bow import bow_score, prior_covariance
from appliance.desk.registration.graph import ScanPoses, place
from appliance.desk.registration.solve import ComparedPair, edges_of, middle_of, solve
from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS, along_ray, shapes
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.points.organised import OrganisedCloud
from bench.merge.calibrated import Distortion, distortion
from bench.merge.pairs import angles_deg, ready_of
from bench.merge.views import Array, PlacedView, ViewRequest, view_of
from bench.progress import Progress
from bench.result import Measurement
from bench.spread import spread

FORTH, BACK = 14, 12
END_MM = 400.0
TURNED_DEG = 50.0
DISTANCE_MM = 585.0
SHARED_MM = np.zeros(DEPTH_ERROR_TERMS)
SHARED_MM[:7] = [0.030, 0.0, -0.015, 0.009, 0.0, 0.009, 0.0]
"""A bow of 30 µm across the view, and related shapes."""
LENGTH_MM = 600.0
MOST_PERCENT = 0.02
MOST_SIGMAS = 2.0
"""Largest error of a pose in stated standard deviations, the depth error included: 95 of 100 are below."""


def measure(
    seed: int, rig_set: str, size_px: tuple[int, int], keep: Path | None, calibrated: int = 0
) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """Return figures of one row of scans, and the rows of a table.

    ``calibrated`` rigs of the world ``outside`` are calibrated from four recordings, and the row is taken with each.
    """
    requests = drawn(seed, rig_set, size_px)
    progress = Progress(len(requests))
    views: list[PlacedView] = []
    for view in spread(partial(view_of, keep=keep), requests):
        progress.step(f"view {len(views) + 1} of {len(requests)}")
        views.append(view)
    measured: list[Measurement] = []
    rows: list[dict[str, Any]] = []
    kinds: list[tuple[str, Array, Distortion | None]] = [
        ("as they are", np.zeros(DEPTH_ERROR_TERMS), None),
        ("with a shared bow of 30 um", SHARED_MM, None),
    ]
    kinds += [
        (f"as rig {seed + k} calibrates itself", np.zeros(DEPTH_ERROR_TERMS), distortion(seed + k, 4))
        for k in range(calibrated)
    ]
    for name, shared, rig_distortion in kinds:
        stated = None if rig_distortion is None else rig_distortion.stated_mm2
        scale = 1.0 if rig_distortion is None else rig_distortion.scale
        bent = [
            replace(view, cloud=_bent(view.cloud if rig_distortion is None else rig_distortion.of(view.cloud), shared))
            for view in views
        ]
        begun = time.process_time()
        scans = [ready_of(view) for view in bent]
        prepared = time.process_time()
        solved = solve(scans, lambda *_: None, with_bow=True, stated_mm2=stated)
        done = time.process_time()
        measured.append(Measurement(f"{name}: CPU to prepare {len(scans)} scans", prepared - begun, "s"))
        measured.append(
            Measurement(f"{name}: CPU for {len(solved.compared)} pairs and the graph", done - prepared, "s")
        )
        measured.append(Measurement(f"{name}: scans placed", len(solved.placed.poses), f"of {len(scans)}"))
        middles = {k: middle_of(scan) for k, scan in enumerate(scans)}
        prior = prior_covariance(stated)
        plain = place(len(scans), edges_of(solved.compared), middles, with_bow=False, prior_mm2=prior)
        for how, placed in (("estimated", solved.placed), ("not estimated", plain)):
            row = {"scans": name, "bow": how, **_judged(placed, views, middles, solved.compared, scale)}
            row["score"] = bow_score(placed.bow_mm, prior, placed.bow_covariance) if how == "estimated" else None
            rows.append(row)
            label = f"{name}, bow {how}"
            measured += figures(label, row, default=how == "not estimated")
    return measured, rows


def figures(label: str, row: dict[str, Any], *, default: bool) -> list[Measurement]:
    """Return the figures of one solution. All have the limit of lengths; the ``default`` one also has that of its
    budget."""
    length = f"{label}: length error over {LENGTH_MM:.0f} mm"
    return [
        Measurement(length, row["length_percent"], "%", at_most=MOST_PERCENT),
        Measurement(f"{label}: farthest place off", 1000.0 * row["worst_mm"], "um"),
        Measurement(f"{label}: what may bend it, stated", 1000.0 * row["budget_mm"], "um"),
        Measurement(
            f"{label}: farthest place off, over what is stated of it",
            row["worst_over_sigma"],
            "standard deviations",
            at_most=MOST_SIGMAS if default else None,
        ),
    ]


def _judged(
    placed: ScanPoses,
    views: list[PlacedView],
    middles: dict[int, Array],
    compared: tuple[ComparedPair, ...],
    scale: float,
) -> dict[str, Any]:
    """Return a row of the table; ``scale`` is that of single scans, for which merging is not responsible."""
    first = min(placed.poses)
    placed_mm, true = {}, {}
    for k, pose in placed.poses.items():
        placed_mm[k] = pose.of(middles[k])
        true[k] = views[k].place.then(views[first].place.inverse).of(middles[k])
    off = {k: float(np.linalg.norm(placed_mm[k] - true[k])) for k in placed_mm}
    pairs = [(i, j) for i in placed_mm for j in placed_mm if i < j and np.linalg.norm(true[i] - true[j]) > LENGTH_MM]
    lengths = [
        100.0
        * abs(float(np.linalg.norm(placed_mm[i] - placed_mm[j]) / np.linalg.norm(true[i] - true[j])) / scale - 1.0)
        for i, j in pairs
    ]
    farthest = max(off, key=lambda k: off[k])
    stated_mm = float(np.sqrt(np.trace(placed.covariance[farthest][3:, 3:])))
    return {
        "worst_mm": off[farthest],
        "worst_over_sigma": off[farthest] / stated_mm if stated_mm else 0.0,
        "rms_mm": float(np.sqrt(np.mean(np.square(list(off.values()))))),
        "length_percent": float(np.sqrt(np.mean(np.square(lengths)))) if lengths else float("nan"),
        "sigma_mm": max(float(np.sqrt(np.trace(covariance[3:, 3:]))) for covariance in placed.covariance.values()),
        "budget_mm": max(placed.bending_mm.values()),
        "bow_um": [1000.0 * value for value in placed.bow_mm.tolist()],
        "variance_factor": placed.variance_factor,
        "pairs": len(compared),
        "used": len(placed.used),
    }


def _bent(cloud: OrganisedCloud, shared: Array) -> OrganisedCloud:
    if not shared.any():
        return cloud
    points = cloud.points_mm.astype(np.float64)
    with np.errstate(invalid="ignore"):
        moved = points + along_ray(points) * (shapes(points) @ shared)[..., None]
    return replace(cloud, points_mm=moved.astype(np.float32))


def drawn(seed: int, rig_set: str, size_px: tuple[int, int]) -> list[ViewRequest]:
    """Return the views: forth along the main, then back with the main turned about its axis."""
    return [
        ViewRequest("main", "slight", pose, rig_set, seed, k, size_px)
        for k, pose in enumerate(poses_along(seed, FORTH, BACK))
    ]


def poses_along(seed: int, forth: int, back: int) -> list[tuple[float, ...]]:
    """Return poses [x, y, z, rx_deg, ry_deg, rz_deg] of the main: ``forth`` views along it, and ``back`` turned about
    its axis."""
    rng = np.random.default_rng([5, seed])
    along = [*np.linspace(-END_MM, END_MM, forth), *np.linspace(END_MM, -END_MM, back)]
    turned = [0.0] * forth + [TURNED_DEG] * back
    poses = []
    for x, turn_deg in zip(along, turned, strict=True):
        hand = rotation_matrix(np.radians(rng.normal(size=3) * (5.0, 5.0, 4.0)))
        R = hand @ rotation_matrix(np.array([np.radians(turn_deg), 0.0, 0.0]))
        t = np.array([0.0, 0.0, DISTANCE_MM]) + rng.normal(size=3) * (6.0, 6.0, 8.0) - R @ np.array([x, 0.0, 0.0])
        poses.append(tuple(map(float, (*t, *angles_deg(R)))))
    return poses
