"""Accuracy of the check of frame identity: random good scans, and every wrong order of their frames.

A wrong order is *visible* to a camera if the true patterns at a frame's position and in the frame differ on at least
``VISIBLE`` of the projector's light that the camera sees. The difference comes from the truth, not from the judge. The
witnesses that the ledger compares are not used.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.measure.fault import FaultCode
from appliance.measure.light.noise import TYPICAL_PAIR, CameraNoise, StereoNoise
from appliance.measure.light.patterns import Kind, PatternSequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.verdict import Judgement
from appliance.measure.verdicts.identity.evidence import Witness
from appliance.measure.verdicts.identity.judge import judge_identity
from appliance.measure.verdicts.identity.lines import take_lines
from bench.result import Measurement
from bench.verdict.binomial import rate, tally
from bench.verdict.outside import noise_of, recorded_scan
from bench.verdict.worlds import ORDINARY
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.objects.shapes import DEFAULT_POSE
from hw_sim.rendering.sensor import E_PER_DN, READ_NOISE_E
from hw_sim.scene import Scene
from hw_sim.water.drift import Drift
from hw_sim.water.medium import Water
from tests.support.rendered import pictures, render_scan

Say = Callable[[str, float], None]
Frames = Mapping[str, NDArray[np.uint8]]

VISIBLE = 0.05
SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.001)
"""Bins of the curve."""
FILLING = 0.2
"""Share of the image that an object fills that is not small: there every visible wrong order should be found."""
NAMED_PERCENT = 97.0
"""Of the wrong orders that are found should be rightly named."""
NAMED_OF_EACH = 4
"""Number of wrong orders of each kind and scan whose name is checked too; detection is checked for all."""
WIDTH_PX = 400
FASTEST_MM_S = 30.0
MILKY = 0.25
"""Share of the scans in water whose veil is as bright as the object, or several times as bright."""
MILK_EXPOSURE_S = 0.012


@dataclass(frozen=True, slots=True)
class Wrong:
    """One way in which frames are wrong: frame k shows the pattern ``order[k]``."""

    kind: str
    frame: int
    order: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class RandomScan:
    """A random scan with its classes."""

    scene: Scene
    period_px: int
    exposure_s: float
    classes: tuple[str, ...]


def measure(
    scans: int, seed: int, say: Say, keep: Path | None = None, world: str = ORDINARY
) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure false alarms on ``scans`` good scans, and the detected and rightly named wrong orders of their frames."""
    rows: list[dict[str, Any]] = []
    for number in range(scans):
        drawn = draw(seed, number)
        say(f"scan {number + 1} of {scans}: {drawn.scene.object}", number / scans)
        rows.append(_of_scan(drawn, 1000 * seed + number, world))
    return _figures(rows), {"visible_share": VISIBLE, "shares": list(SHARES), "scans": rows}


def draw(seed: int, number: int) -> RandomScan:
    """Draw object, pose, colour, water, light and hands of scan ``number``; half of the scans move."""
    rng = np.random.default_rng([seed, number, 22])
    name = str(rng.choice(["plane", "ballbar", "frustum", "pipe", "shell", "stones"]))
    pose = np.array(DEFAULT_POSE[name]) + np.concatenate(
        [rng.uniform(-40, 40, 2), rng.uniform(-50, 50, 1), rng.uniform(-25, 25, 2), rng.uniform(-40, 40, 1)]
    )
    texture = str(rng.choice(["none", "slight", "strong", "checker"]))
    water = Water(
        attenuation_per_m=float(rng.uniform(0.1, 1.5)),
        backscatter=float(10 ** rng.uniform(-2.5, -0.8)),
        blur_px_per_m=float(10 ** rng.uniform(-1.0, 0.8)),
    )
    moves, flickers = rng.random() < 0.5, rng.random() < 0.3
    motion = Motion()
    if moves:
        velocity = rng.normal(size=3)
        velocity *= rng.uniform(2.0, FASTEST_MM_S) / float(np.linalg.norm(velocity))
        motion = Motion(
            _three(velocity), tremor_mm=_three(rng.uniform(0, 0.3, 3)), rotation_deg_s=_three(rng.normal(size=3))
        )
    daylight = (
        Daylight(flicker_depth=float(rng.uniform(0.1, 0.6)), caustics=0.3 * float(rng.random()))
        if flickers
        else Daylight()
    )
    drifts = rng.random() < 0.3
    drift = (
        Drift(float(rng.uniform(5, 200)), int(rng.integers(0, 40)), int(rng.integers(0, 3)), seed=number)
        if drifts
        else Drift()
    )
    exposure_s = float(10 ** rng.uniform(-3.2, -1.92))
    ambient = float(rng.choice([0.0, 0.02, 0.2]))
    milky, milk = rng.random() < MILKY, Water(float(rng.uniform(1.0, 3.0)), float(rng.uniform(0.2, 0.8)))
    if milky:
        water, exposure_s = milk, MILK_EXPOSURE_S
    classes = [
        "moving" if moves else "still",
        f"texture {texture}",
        *(["dark"] if exposure_s < 0.003 else []),
        *(["milk"] if milky else []),
        *(["turbid"] if not milky and (water.blur_px_per_m > 2.0 or water.backscatter > 0.08) else []),
        *(["flicker"] if flickers else []),
        *(["specks and fish"] if drifts else []),
        *(["small"] if name == "ballbar" else []),
    ]
    scene = Scene(name, _six(pose), texture, water, ambient, motion=motion, daylight=daylight, drift=drift)
    return RandomScan(scene, int(rng.choice([16, 32, 64])), exposure_s, tuple(classes))


def wrong_orders(n: int) -> Iterator[Wrong]:
    """Yield all swaps of two frames, all repeats with and without a delay of later frames, and both shifts by one."""
    straight = list(range(n))
    for i, j in combinations(straight, 2):
        order = straight.copy()
        order[i], order[j] = j, i
        yield Wrong("swap next" if j == i + 1 else "swap", i, tuple(order))
    for k in range(1, n):
        yield Wrong("repeat", k, (*range(k), k - 1, *range(k + 1, n)))
        yield Wrong("repeat and late", k, (*range(k), *range(k - 1, n - 1)))
    yield Wrong("one late", 0, (1, *range(n - 1)))
    yield Wrong("one early", 0, (*range(1, n), 1))


def _of_scan(drawn: RandomScan, seed: int, world: str) -> dict[str, Any]:
    rng = np.random.default_rng([seed, 21])
    scene = drawn.scene
    if world == ORDINARY:
        noise = TYPICAL_PAIR
        scan = render_scan(
            scene, "realistic", seed, WIDTH_PX, drawn.period_px, drawn.exposure_s,
            frame_s=1.0 / 60.0 if _changes(scene) else 0.0,
        )  # fmt: skip
    else:
        share = drawn.exposure_s / MILK_EXPOSURE_S
        scan = recorded_scan(scene, seed, "realistic", WIDTH_PX, drawn.period_px, share)
        noise = noise_of(scan.renderer.scene, 0.0)
    start = time.process_time()
    judgement = judge_identity(scan.frames, scan.sequence, noise)
    row: dict[str, Any] = {
        "seed": seed,
        "classes": [*drawn.classes, f"period {drawn.period_px}"],
        "good_passed": judgement.verdict.passed,
        "good_doubt": judgement.verdict.numbers["doubt"],
        "good_text": judgement.verdict.text,
        "cpu_s": time.process_time() - start,
    }
    apart, visible_shares = {}, {}
    for side in SIDES:
        view = scan.renderer.view(side, 0.0)
        apart[side], visible_shares[side] = _apart(
            scan.sequence, scan.frames[side], view.projector_px, view.seen_by_all
        )
    row["seen_percent"] = [100.0 * visible_shares[side] for side in SIDES]
    judged = [side for side in SIDES if judgement.verdict.numbers[f"{side}_doubt"] is not None]
    row["judged"] = judged
    row["found"] = [
        [side, wrong.kind, round(share, 4), is_found, _relabels(scan.sequence, wrong)]
        for side in judged
        for wrong, share, is_found in _search(scan.sequence, scan.frames[side], of_side(noise, side), apart[side])
    ]
    row["named"] = list(_names(scan.sequence, scan.frames, apart, judged, rng, noise, visible_shares))
    return row


def _changes(scene: Scene) -> bool:
    return not scene.motion.still or scene.daylight != Daylight() or scene.drift != Drift()


def _search(
    sequence: PatternSequence, frames: NDArray[np.uint8], noise: CameraNoise, apart: NDArray[np.float64]
) -> Iterator[tuple[Wrong, float, bool]]:
    """Yield every wrong order with its visible share, and whether the frames alone show it."""
    straight = Witness(take_lines(frames, sequence, noise), sequence, noise)
    every = np.arange(len(sequence), dtype=np.int64)
    for wrong in wrong_orders(len(sequence)):
        order = np.array(wrong.order, np.int64)
        if wrong.kind.startswith("swap"):  # the same frames: their lines need not be taken again
            evidence = straight.evidence(order)
        else:
            evidence = Witness(take_lines(frames[order], sequence, noise), sequence, noise).evidence(every)
        yield wrong, float(apart[every, order].max()), evidence.judged and evidence.contradicted


def _names(
    sequence: PatternSequence,
    frames: Frames,
    apart: Mapping[str, NDArray[np.float64]],
    judged: Sequence[str],
    rng: np.random.Generator,
    noise: StereoNoise,
    visible_shares: Mapping[str, float],
) -> Iterator[list[Any]]:
    """Yield kind, both cameras, found, rightly named, frame named, and visible share, of some wrong orders and still
    images.

    The visible share is the least part of the image that the object fills in the cameras that show the order.
    """
    if not judged:
        return
    n = len(sequence)
    kinds: dict[str, list[Wrong]] = {}
    for wrong in wrong_orders(n):
        kinds.setdefault(wrong.kind, []).append(wrong)
    kinds["still"] = [Wrong("still", k, (*range(k), *[k] * (n - k))) for k in range(n - 2)]
    for kind, all_of_kind in kinds.items():
        for number in rng.permutation(len(all_of_kind))[:NAMED_OF_EACH]:
            wrong = all_of_kind[int(number)]
            on_both = len(judged) == 2 and bool(rng.random() < 0.5)
            sides = list(SIDES) if on_both else [str(rng.choice(judged))]
            order = np.array(wrong.order)
            share = min(float(apart[side][np.arange(n), order].max()) for side in sides)
            if share < VISIBLE or _relabels(sequence, wrong):
                continue
            wronged = {side: _again(mine, order, rng) if side in sides else mine for side, mine in frames.items()}
            judgement = judge_identity(wronged, sequence, noise)
            numbers = {} if judgement.fault is None else judgement.fault.numbers
            named = judgement.verdict.passed is False and _rightly(judgement, wrong, on_both)
            yield [kind, on_both, judgement.verdict.passed is False, named, numbers.get("frame") == wrong.frame,
                   min(visible_shares[side] for side in sides)]  # fmt: skip


def _rightly(judgement: Judgement, wrong: Wrong, is_on_both: bool) -> bool:
    code = None if judgement.fault is None else judgement.fault.code
    if wrong.kind == "still":
        # Both cameras at once: the projector stays on a pattern, or dark; noise is each frame's own.
        on_both = (FaultCode.PATTERN_WRONG, FaultCode.PROJECTOR_DARK)
        return code in on_both if is_on_both else code is FaultCode.CAMERA_STUCK
    if wrong.kind in ("one late", "one early") and is_on_both:
        shift = None if judgement.fault is None else judgement.fault.numbers.get("shift_frames")
        return code is FaultCode.PROJECTOR_TIMING and shift == (1 if wrong.kind == "one late" else -1)
    return code is FaultCode.PATTERN_WRONG


def _again(frames: NDArray[np.uint8], order: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the frames in ``order``; a repeated image gets additional noise."""
    out = frames[order]
    for k in range(len(order)):
        if order[k] in order[:k]:
            image = out[k].astype(np.float64)
            sigma = np.sqrt((READ_NOISE_E / E_PER_DN) ** 2 + image / E_PER_DN)
            out[k] = np.clip(np.rint(image + 0.5 * sigma * rng.standard_normal(image.shape)), 0, 255)
    return out


def _apart(
    sequence: PatternSequence, frames: NDArray[np.uint8], projector_px: NDArray[np.float64], by_all: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Return the differences (n, n) of patterns, and the share of the image that is illuminated.

    A difference is the share of the illuminated pixels at which two true patterns differ by a third of white.
    """
    swing = frames.max(axis=0).astype(np.int64) - frames.min(axis=0)
    inside = by_all & np.isfinite(projector_px).all(axis=-1) & (swing >= 8)
    p, q = (np.rint(projector_px[inside][:, axis]).astype(int) for axis in (0, 1))
    inside_field = (p >= 0) & (p < sequence.width_px) & (q >= 0) & (q < sequence.height_px)
    p, q = p[inside_field], q[inside_field]
    shown = np.stack([picture[q, p] for picture in pictures(sequence)]).astype(np.int16)
    n = len(sequence)
    apart = np.zeros((n, n))
    for i, j in combinations(range(n), 2):
        apart[i, j] = apart[j, i] = float(np.mean(abs(shown[i] - shown[j]) > 85)) if p.size else 0.0
    return apart, p.size / swing.size


def _relabels(sequence: PatternSequence, wrong: Wrong) -> bool:
    """Return True if the order only renumbers stripes: two Gray images of one direction keep the parity of the code."""
    changed = [sequence.patterns[k] for k in range(len(wrong.order)) if wrong.order[k] != k]
    gray = all(pattern.kind is Kind.GRAY for pattern in changed)
    return wrong.kind.startswith("swap") and gray and len({pattern.direction for pattern in changed}) == 1


def _figures(rows: Sequence[Mapping[str, Any]]) -> list[Measurement]:
    good = [row for row in rows if row["good_passed"] is not None]
    alarms = [row for row in good if row["good_passed"] is False]
    orders = [order for row in rows for order in row["found"]]
    visible = [order for order in orders if order[2] >= VISIBLE]
    named = [order for row in rows for order in row["named"]]
    filling = [
        order
        for row in rows
        for order in row["found"]
        if order[2] >= VISIBLE and row["seen_percent"][SIDES.index(order[0])] >= 100.0 * FILLING
    ]
    relabelled = [order for order in visible if order[4]]
    cpu_ms = 1e3 * _median([row["cpu_s"] for row in rows])
    out = [
        tally(
            "identity: false alarms on good scans", len(alarms), len(good), at_most=0.0, key="identity_false_alarms"
        ),
        rate("identity: good scans with enough to judge", len(good), len(rows)),
        Measurement("identity: CPU of a good scan, 2 x 400x300", cpu_ms, "ms", at_most=20.0),
        *(
            _found(f"where visible, {name}", mine, 100.0, f"identity_found_{name}_percent")
            for name in ("still", "moving")
            if (mine := _visible(rows, name))
        ),
        _found("where the object fills a fifth of the image", filling, 100.0),
        _found("Gray images of one direction swapped", relabelled),
        _named("seen and rightly named", named, NAMED_PERCENT),
        _named(
            "rightly named where the object fills a fifth", [order for order in named if order[5] >= FILLING],
            NAMED_PERCENT,
        ),
    ]  # fmt: skip
    for name in sorted({name for row in rows for name in row["classes"]} - {"still", "moving"}):
        out.append(_found(f"where visible, {name}", _visible(rows, name)))
    for kind in sorted({order[0] for order in named}):
        out.append(_named(f"rightly named, {kind}", [order for order in named if order[0] == kind]))
    for low, high in pairwise(SHARES):
        mine = [order for order in orders if low <= order[2] < high]
        out.append(_found(f"shown on {100 * low:g} to {100 * min(high, 1.0):g} %", mine))
    return out


def _found(what: str, orders: Sequence[Any], at_least: float | None = None, key: str | None = None) -> Measurement:
    """Return the rate of these wrong orders that the frames alone show."""
    return rate(f"identity: found, {what}", sum(order[3] for order in orders), len(orders), at_least=at_least, key=key)


def _named(what: str, orders: Sequence[Any], at_least: float | None = None) -> Measurement:
    """Return the rate of these wrong orders that are rightly named."""
    return rate(f"identity: {what}", sum(order[3] for order in orders), len(orders), at_least=at_least)


def _visible(rows: Sequence[Mapping[str, Any]], name: str) -> list[Any]:
    """Return the visible orders in scans of a class."""
    return [order for row in rows if name in row["classes"] for order in row["found"] if order[2] >= VISIBLE]


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _six(values: NDArray[np.float64]) -> tuple[float, float, float, float, float, float]:
    x, y, z, rx, ry, rz = (float(value) for value in values)
    return x, y, z, rx, ry, rz
