"""Which constants of the judges still decide anything: each is halved and doubled, and the scans are counted that are judged otherwise.

A decision is what a verdict says (passed or not, and its fault), the grade, and the first reason. Scans are the scenes of
the parts ``motion`` (each at rest and moving) and ``causes``. A constant whose change changes nothing on scenes that carry
its own fault is a candidate to go.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import multiprocessing
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, islice
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np
from numba.core.caching import NullCache
from numba.core.registry import CPUDispatcher
from numpy.typing import NDArray

import appliance
from appliance.measure.calibration.file import Calibration
from appliance.measure.cloud import CloudSummary
from appliance.measure.judges import JUDGES, JudgeInput, gather
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdict import Judgement, grade
from appliance.measure.verdicts.causes import with_causes
from appliance.measure.verdicts.holes import grid_step_px, judge_distance, judge_holes
from appliance.measure.verdicts.identity.judge import judge_identity
from bench.progress import Progress
from bench.result import Measured
from bench.verdict.causes_scenes import PERIOD_PX, STEPS, draw_base, grid_of
from bench.verdict.causes_truth import Truth
from bench.verdict.kept_scans import Frames, Take
from bench.verdict.motion import case_of
from bench.verdict.motion_cases import FRAME_S
from bench.verdict.worlds import ORDINARY, WORLDS, scans_of
from tests.support.truth import complete_calibration

VERDICTS = Path(appliance.__file__).parent / "measure" / "verdicts"
FACTORS = (0.5, 2.0)
ENOUGH_S = 900.0
Decisions = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Scene:
    """A scan as it is given to the judges, decoded once."""

    images: ScanImages
    coarse: Cloud
    calibration: Calibration
    water: Water
    pipeline: Pipeline
    summary: CloudSummary
    """Of the full cloud."""
    there: NDArray[np.bool_]
    """(h, w): left pixels with a point in it."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A constant of the judges; ``in_kernel``: compiled code holds it."""

    module: str
    name: str
    value: Any
    in_kernel: bool

    def times(self, factor: float) -> Any:
        """Return the value so many times as large, of the same type."""
        if isinstance(self.value, tuple):
            return tuple(type(one)(one * factor) for one in self.value)
        return type(self.value)(
            max(1, round(self.value * factor)) if isinstance(self.value, int) else self.value * factor
        )


def measure() -> Iterator[Measured]:
    """How many constants the judges have. What each decides takes hours: see ``main``."""
    yield Measured("constants of the judges", float(len(list(rules()))), "")


def main(arguments: Sequence[str]) -> int:
    """The command line: ``./dev bench ablation --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench ablation", description=__doc__)
    parser.add_argument(
        "--scans", type=int, default=100, help="scenes in motion, and of the causes; default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=10, help="of the draws; default: %(default)s")
    parser.add_argument("--keep", type=Path, help="folder of rendered scans, used and added to: 6 MB each")
    parser.add_argument("--rules", default="", help="those whose module or name has this; default: all")
    parser.add_argument("--world", choices=WORLDS, default=ORDINARY)
    parser.add_argument("--out", type=Path, default=Path("bench/out/ablation.md"), help="default: %(default)s")
    wanted = parser.parse_args(arguments)
    if wanted.scans < 1:
        parser.error(f"--scans {wanted.scans}: allowed are 1 and more")
    listed = [rule for rule in rules() if wanted.rules in f"{rule.module}.{rule.name}"]
    if not listed:
        parser.error(f"--rules {wanted.rules}: no constant of the judges has that in its name")
    progress = Progress(1)
    found = []
    for scene in scenes(wanted.scans, wanted.seed, wanted.keep, wanted.world):
        found.append(scene)
        progress.show(f"{len(found)} scans decoded", 0.0)
    before = [decisions(scene) for scene in found]
    lines = [
        f"Of {len(found)} scans, those that are judged otherwise with half, and with twice the value:",
        "",
        "| module | constant | value | half | twice |",
        "|---|---|---|---|---|",
    ]
    for number, rule in enumerate(listed):
        progress.show(f"{rule.module} {rule.name}", number / len(listed))
        half, twice = (_changed(rule, rule.times(factor), found, before) for factor in FACTORS)
        lines.append(
            f"| `{rule.module.partition('verdicts.')[2]}` | `{rule.name}` | {rule.value!r} | {half} | {twice} |"
        )
        wanted.out.parent.mkdir(parents=True, exist_ok=True)
        wanted.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    progress.close()
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def scenes(scans: int, seed: int, keep: Path | None, world: str) -> Iterator[Scene]:
    """Yield the scans, those in motion first."""
    kept = scans_of(world, keep)
    for number in range(scans):
        case = case_of(seed, number)
        calibration = complete_calibration(kept.renderer(case, Take.REST).truth)
        for take in Take:
            taken = kept.recorded(case, take)
            exposure = Exposure(round(1e6 * taken.exposure_s), case.gain_db)
            settings = AcquisitionSettings(exposure, FRAME_S, kept.noise(case), steps=STEPS)
            yield _scene(taken.noisy, settings, calibration, kept.water(case), case.period_px)
    yield from islice(_of_causes(seed, keep, world), scans)


def _of_causes(seed: int, keep: Path | None, world: str) -> Iterator[Scene]:
    for number in count():
        base = draw_base(seed, number)
        truth = Truth(base, keep, world)
        for spoilt in grid_of(seed, number):
            scan, settings, calibration, water = truth.taken(spoilt)
            yield _scene(scan.frames, settings, calibration, water, PERIOD_PX)


def _scene(
    frames: Frames, settings: AcquisitionSettings, calibration: Calibration, water: Water, period_px: int
) -> Scene:
    sequence = build_sequence(period_px)
    # Without helpers: a process that is forked has none.
    pipeline = Pipeline(calibration, water, sequence, noise=settings.noise, helpers=0)
    for index in range(len(sequence)):
        for side in SIDES:
            pipeline.push(side, frames[side], index)
    coarse = pipeline.table.cloud(pipeline.find_coarse())
    images = ScanImages(sequence, frames, {side: pipeline.decoded(side) for side in SIDES}, settings)
    with Pipeline(calibration, water, sequence, noise=settings.noise, helpers=0) as other:
        # Its maps are changed for the full cloud.
        for index in range(len(sequence)):
            for side in SIDES:
                other.push(side, frames[side], index)
        other.find_coarse()
        full = other.table.cloud(other.find_full())
    there = np.zeros(frames["left"].shape[1:], np.bool_)
    there.reshape(-1)[full.pixel] = True
    return Scene(images, coarse, calibration, water, pipeline, full.summary, there)


def decisions(scene: Scene) -> Decisions:
    """Return what is decided of a scan, by the judges as they are now."""
    images, settings, sequence = scene.images, scene.images.settings, scene.images.sequence
    frames, rig = images.frames, scene.calibration.rig
    gathered = {side: gather(frames[side], sequence, of_side(settings.noise, side)) for side in SIDES}
    lines = {side: one.lines for side, one in gathered.items()}
    identity = judge_identity(frames, sequence, settings.noise, settings.exposure, lines)
    given = JudgeInput(images, gathered, scene.coarse, rig, scene.water.index, identity, scene.pipeline)
    said: dict[str, Judgement | None] = {}
    for judge in sorted(JUDGES, key=lambda judge: len(judge.needs)):
        said[judge.name] = judge.judge(given, {name: said[name] for name in judge.needs})
    step = grid_step_px(frames["left"].shape[2])
    grid = np.s_[::step, ::step]
    known = [one for judge in JUDGES if (one := said[judge.name]) is not None]
    known.append(judge_holes(images.decoded["left"].mask[grid], frames["left"][sequence.dark][grid], scene.there[grid]))
    known.append(judge_distance(scene.summary, rig.volume))
    weighed = (identity, *with_causes(tuple(known), scene.summary, settings.exposure, settings.steps))
    faults = [one.fault.code for one in weighed if one.fault is not None]
    found: Decisions = {
        one.verdict.name: (one.verdict.passed, one.fault and one.fault.code) for one in (identity, *known)
    }
    found["grade"] = grade(scene.summary.coverage_percent, scene.summary.noise_mm, set(faults))
    found["first"] = faults[0] if faults else None
    return found


def rules() -> Iterator[Rule]:
    """Yield every number, or tuple of numbers, that a module of the verdicts names in capitals."""
    for path in sorted(VERDICTS.rglob("*.py")):
        module = ".".join(path.relative_to(VERDICTS.parents[2]).with_suffix("").parts)
        tree, values = ast.parse(path.read_text(encoding="utf-8")), vars(importlib.import_module(module))
        kernels = [one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef) and one.decorator_list]
        compiled = {one.id for kernel in kernels for one in ast.walk(kernel) if isinstance(one, ast.Name)}
        for line in tree.body:
            targets = line.targets if isinstance(line, ast.Assign) else []
            for name in (one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)):
                parts = values[name] if isinstance(values[name], tuple) else (values[name],)
                if name.isupper() and all(type(part) in (int, float) for part in parts):
                    yield Rule(module, name, values[name], name in compiled)


def _changed(rule: Rule, value: Any, found: list[Scene], before: list[Decisions]) -> int:
    """Return how many of the scans are judged otherwise with ``value``, in a process of its own."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_count, args=(rule, value, found, before, theirs))
    child.start()
    theirs.close()
    try:
        if not wait([ours], ENOUGH_S):
            raise TimeoutError(f"{rule.module} {rule.name} = {value!r}: not judged within {ENOUGH_S:g} s")
        return int(ours.recv())
    except EOFError:
        # What cannot even be judged is a decision of every scan.
        return len(found)
    finally:
        child.kill()
        child.join()


def _count(rule: Rule, value: Any, found: list[Scene], before: list[Decisions], answer: Connection) -> None:
    where = [one for name, one in sys.modules.items() if name.startswith("appliance.") and _holds(vars(one), rule)]
    for module in where:
        setattr(module, rule.name, value)
    if rule.in_kernel:
        _compile_again([vars(module) for module in where])
    answer.send(sum(decisions(scene) != known for scene, known in zip(found, before, strict=True)))


def _holds(names: Mapping[str, Any], rule: Rule) -> bool:
    return rule.name in names and names[rule.name] is vars(sys.modules[rule.module])[rule.name]


def _compile_again(modules: list[dict[str, Any]]) -> None:
    """Compile the kernels of these modules again, and leave what is kept on the disk as it is."""
    for kernel in {
        id(one): one for names in modules for one in names.values() if isinstance(one, CPUDispatcher)
    }.values():
        vars(kernel)["_cache"] = NullCache()
        kernel.recompile()
