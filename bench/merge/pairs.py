"""Random scan pairs: which are accepted, their errors, and rejected ones that could be solved."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from appliance.desk.objects import light_of
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.overlap.fine import correspond
from appliance.measure.overlap.pair import ReadyScan, ready, register
from appliance.measure.overlap.rigid import Rigid
from bench.merge.views import Array, PlacedView, ViewRequest, view_of
from bench.progress import Progress
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.binomial import out_of
from hw_sim.objects.motion import pose_matrix

SHAPES = ("plane", "pipe", "frustum", "shell", "stones", "ballbar", "board")
PAINTS = ("none", "slight", "strong", "checker")
DEPTHS_MM = {
    "plane": 522.5,
    "ballbar": 522.5,
    "frustum": 545.0,
    "pipe": 560.0,
    "shell": 545.0,
    "stones": 535.0,
    "board": 540.0,
}
UNEVEN = ("shell", "stones")
"""Shapes that hold every direction by themselves, seen from anywhere. A frustum is the same turned a quarter or half about, unless it is painted."""
LEAST_OVERLAP = 0.4
SIGMAS, MORE_MM = 3.0, 0.05
"""A pose is wrong if its error exceeds ``SIGMAS`` standard deviations by ``MORE_MM``."""
SIZE_PX = (800, 600)
SEEDS_A_RIG = 7


def measure(count: int, seed: int, keep: Path | None) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """Return figures of ``count`` drawn pairs, and the pairs."""
    progress = Progress(count)
    rows: list[dict[str, Any]] = []
    for row in spread(partial(_row, seed=seed, keep=keep), range(count)):
        progress.step(f"pair {len(rows) + 1} of {count}")
        rows.append(row)
    return figures(rows), rows


def figures(rows: list[dict[str, Any]]) -> list[Measurement]:
    """Return the figures of the pairs. An accepted pair without any overlap is wrong, whatever its sigma."""
    accepted = [row for row in rows if row["accepted"]]
    wrong = [row for row in accepted if row["error_mm"] > SIGMAS * row["sigma_mm"] + MORE_MM]
    solvable = [row for row in rows if row["solvable"]]
    solved = [row for row in solvable if row["accepted"]]
    sliding = [row for row in rows if not row["tells"] and row["overlap"] >= LEAST_OVERLAP]
    share = 100.0 * len(solved) / max(len(solvable), 1)
    return [
        Measurement(
            "accepted pairs that are wrong", len(wrong), out_of(len(accepted), len(wrong)), at_most=0.0,
            key="merge_wrong_pairs",
        ),
        Measurement(
            "solvable pairs that are accepted", share, f"% {out_of(len(solvable), len(solved))}", at_least=95.0
        ),
        Measurement(
            "stated sigma of those, median", 1000.0 * _median([r["sigma_mm"] for r in solved]), "um", at_most=100.0
        ),
        Measurement("error of those, median", 1000.0 * _median([r["error_mm"] for r in solved]), "um"),
        Measurement(
            "error of those, largest", 1000.0 * max((r["error_mm"] for r in solved), default=float("nan")), "um"
        ),
        Measurement("error over sigma of those, median", _median([r["error_mm"] / r["sigma_mm"] for r in solved]), ""),
        Measurement("pairs that nothing holds, refused", sum(not r["accepted"] for r in sliding), f"of {len(sliding)}"),
        Measurement("CPU to prepare a view, median", _median([r["ready_s"] for r in rows]), "s"),
        Measurement("CPU a pair, median", _median([r["pair_s"] for r in rows]), "s"),
    ]  # fmt: skip


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def _row(number: int, seed: int, keep: Path | None) -> dict[str, Any]:
    import time

    shape, paint, poses = drawn(number, seed)
    rig_seed = 1000 * seed + number // SEEDS_A_RIG
    views = [
        view_of(ViewRequest(shape, paint, pose, "realistic", rig_seed, 2 * number + k, SIZE_PX), keep)
        for k, pose in enumerate(poses)
    ]
    begun = time.process_time()
    first, second = (ready_of(view) for view in views)
    prepared = time.process_time()
    pair = register(first, second)
    done = time.process_time()
    true = views[1].place.then(views[0].place.inverse)
    judged, overlap = judged_on(first, second, true)
    tells = shape in (*UNEVEN, "board") or (paint in ("slight", "strong") and shape != "ballbar")
    fit = pair.fit
    return {
        "shape": shape,
        "paint": paint,
        "overlap": overlap,
        "tells": tells,
        "solvable": tells and overlap >= LEAST_OVERLAP,
        "accepted": pair.accepted,
        "refusal": None if pair.refusal is None else pair.refusal.value,
        "error_mm": None if fit is None else off_mm(fit.pose, true, judged),
        "sigma_mm": None if fit is None else fit.sigma_mm,
        "ready_s": 0.5 * (prepared - begun),
        "pair_s": done - prepared,
    }


def judged_on(first: ReadyScan, second: ReadyScan, true: Rigid) -> tuple[Array, float]:
    """Return the points (n, 3) of the second view that a pose is judged by, in its frame, and the share of it that truly lies on the first.

    Points of the overlap; where there truly is none, all: a pose that was accepted there is off by that much.
    """
    patches = second.fine.patches
    on = correspond(first.fine, second.fine, true, 1.0).source
    centres = patches.centre_mm.reshape(-1, 3)[on] if len(on) else patches.centre_mm[patches.valid]
    return centres, len(on) / max(int(np.count_nonzero(patches.valid)), 1)


def ready_of(view: PlacedView) -> ReadyScan:
    """Return a view prepared for registration."""
    return ready(view.cloud, view.calibration.rig.left, view.water_index, light_of(view.calibration))


def off_mm(pose: Rigid, true: Rigid, points: Array) -> float:
    """Return the RMS distance between where two poses put ``points`` (n, 3)."""
    return float(np.sqrt(((pose.of(points) - true.of(points)) ** 2).sum(axis=1).mean()))


def drawn(number: int, seed: int) -> tuple[str, str, tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return shape, texture, and both poses of the object: the second after a motion of the instrument."""
    rng = np.random.default_rng([77, seed, number])
    shape = SHAPES[number % len(SHAPES)]
    paint = PAINTS[(number // len(SHAPES)) % len(PAINTS)] if shape != "board" else "slight"
    depth = DEPTHS_MM[shape]
    first = (*rng.uniform(-25, 25, 2), depth + rng.uniform(-15, 25), *rng.uniform(-14, 14, 2), rng.uniform(-180, 180))
    R, t = pose_matrix(first)
    far = rng.random() < 0.2
    shift = rng.uniform(-1, 1, 3) * ((180, 150, 30) if far else (110, 90, 25))
    rotation = rotation_matrix(np.radians(rng.uniform(-1, 1, 3) * (14, 14, 30 if rng.random() < 0.7 else 120)))
    middle = np.array([0.0, 0.0, depth])
    second = (*(rotation @ (t - middle) + middle + shift), *angles_deg(rotation @ R))
    return shape, paint, (tuple(map(float, first)), tuple(map(float, second)))


def angles_deg(rotation: Array) -> Array:
    """Return rx, ry, rz of ``pose_matrix`` for a rotation (3, 3)."""
    best = min(
        (
            least_squares(
                lambda a: (pose_matrix((0, 0, 0, *a))[0] - rotation).ravel(), start, xtol=1e-15, ftol=1e-15, gtol=1e-15
            )
            for start in (np.array([0.0, 0.0, roll]) for roll in (0.0, 90.0, -90.0, 180.0))
        ),
        key=lambda candidate: candidate.cost,
    )
    return np.asarray(best.x)
