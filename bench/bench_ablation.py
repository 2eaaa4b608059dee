"""Effect of each constant of the judges: it is halved and doubled, and scans with another decision are counted.

A decision is the verdict (passed or not, and its fault), the grade, and the first cause. Scans are the scenes of the
parts ``motion`` (each at rest and moving) and ``causes``. A constant without effect on scenes that have its own fault
may be removed.
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
from bench.result import Measurement
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
    """A scan as the judges get it, decoded once."""

    images: ScanImages
    coarse: Cloud
    calibration: Calibration
    water: Water
    pipeline: Pipeline
    summary: CloudSummary
    """Summary of the full cloud."""
    has_point: NDArray[np.bool_]
    """(h, w): left pixels with a point in the full cloud."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A constant of the judges; ``in_kernel``: compiled code holds it."""

    module: str
    name: str
    value: Any
    in_kernel: bool

    def times(self, factor: float) -> Any:
        """Return the value times ``factor``, of the same type."""
        if isinstance(self.value, tuple):
            return tuple(type(part)(part * factor) for part in self.value)
        return type(self.value)(
            max(1, round(self.value * factor)) if isinstance(self.value, int) else self.value * factor
        )


def measure() -> Iterator[Measurement]:
    """Yield the number of constants of the judges. Their effects take hours: see ``main``."""
    yield Measurement("constants of the judges", float(len(list(rules()))), "")


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench ablation --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench ablation", description=__doc__)
    parser.add_argument(
        "--scans", type=int, default=100, help="scenes in motion, and of the causes; default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=10, help="of the draws; default: %(default)s")
    parser.add_argument("--keep", type=Path, help="folder of rendered scans, used and added to: 6 MB each")
    parser.add_argument("--rules", default="", help="those whose module or name has this; default: all")
    parser.add_argument("--world", choices=WORLDS, default=ORDINARY)
    parser.add_argument("--out", type=Path, default=Path("bench/out/ablation.md"), help="default: %(default)s")
    options = parser.parse_args(arguments)
    if options.scans < 1:
        parser.error(f"--scans {options.scans}: allowed are 1 and more")
    listed = [rule for rule in rules() if options.rules in f"{rule.module}.{rule.name}"]
    if not listed:
        parser.error(f"--rules {options.rules}: no constant of the judges has that in its name")
    progress = Progress(1)
    decoded = []
    for scene in scenes(options.scans, options.seed, options.keep, options.world):
        decoded.append(scene)
        progress.show(f"{len(decoded)} scans decoded", 0.0)
    before = [decisions(scene) for scene in decoded]
    lines = [
        f"Of {len(decoded)} scans, those that are judged otherwise with half, and with twice the value:",
        "",
        "| module | constant | value | half | twice |",
        "|---|---|---|---|---|",
    ]
    for number, rule in enumerate(listed):
        progress.show(f"{rule.module} {rule.name}", number / len(listed))
        half, twice = (_changed(rule, rule.times(factor), decoded, before) for factor in FACTORS)
        lines.append(
            f"| `{rule.module.partition('verdicts.')[2]}` | `{rule.name}` | {rule.value!r} | {half} | {twice} |"
        )
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    progress.close()
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def scenes(scans: int, seed: int, keep: Path | None, world: str) -> Iterator[Scene]:
    """Yield the scans, those in motion first."""
    scan_source = scans_of(world, keep)
    for number in range(scans):
        case = case_of(seed, number)
        calibration = complete_calibration(scan_source.renderer(case, Take.REST).truth)
        for take in Take:
            recorded = scan_source.recorded(case, take)
            exposure = Exposure(round(1e6 * recorded.exposure_s), case.gain_db)
            settings = AcquisitionSettings(exposure, FRAME_S, scan_source.noise(case), steps=STEPS)
            yield _scene(recorded.noisy, settings, calibration, scan_source.water(case), case.period_px)
    yield from islice(_of_causes(seed, keep, world), scans)


def _of_causes(seed: int, keep: Path | None, world: str) -> Iterator[Scene]:
    for number in count():
        base = draw_base(seed, number)
        truth = Truth(base, keep, world)
        for levels in grid_of(seed, number):
            scan, settings, calibration, water = truth.scan_inputs(levels)
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
    with Pipeline(calibration, water, sequence, noise=settings.noise, helpers=0) as full_pipeline:
        # Its maps are changed for the full cloud.
        for index in range(len(sequence)):
            for side in SIDES:
                full_pipeline.push(side, frames[side], index)
        full_pipeline.find_coarse()
        full = full_pipeline.table.cloud(full_pipeline.find_full())
    has_point = np.zeros(frames["left"].shape[1:], np.bool_)
    has_point.reshape(-1)[full.pixel] = True
    return Scene(images, coarse, calibration, water, pipeline, full.summary, has_point)


def decisions(scene: Scene) -> Decisions:
    """Return the decisions on a scan by the judges with their present constants."""
    images, settings, sequence = scene.images, scene.images.settings, scene.images.sequence
    frames, rig = images.frames, scene.calibration.rig
    gathered = {side: gather(frames[side], sequence, of_side(settings.noise, side)) for side in SIDES}
    lines = {side: samples.lines for side, samples in gathered.items()}
    identity = judge_identity(frames, sequence, settings.noise, settings.exposure, lines)
    inputs = JudgeInput(images, gathered, scene.coarse, rig, scene.water.index, identity, scene.pipeline)
    judgements: dict[str, Judgement | None] = {}
    for judge in sorted(JUDGES, key=lambda judge: len(judge.needs)):
        judgements[judge.name] = judge.judge(inputs, {name: judgements[name] for name in judge.needs})
    step = grid_step_px(frames["left"].shape[2])
    grid = np.s_[::step, ::step]
    made_judgements = [judgement for judge in JUDGES if (judgement := judgements[judge.name]) is not None]
    made_judgements.append(
        judge_holes(images.decoded["left"].mask[grid], frames["left"][sequence.dark][grid], scene.has_point[grid])
    )
    made_judgements.append(judge_distance(scene.summary, rig.volume))
    weighed = (identity, *with_causes(tuple(made_judgements), scene.summary, settings.exposure, settings.steps))
    faults = [weighed_one.fault.code for weighed_one in weighed if weighed_one.fault is not None]
    result: Decisions = {
        judged.verdict.name: (judged.verdict.passed, judged.fault and judged.fault.code)
        for judged in (identity, *made_judgements)
    }
    result["grade"] = grade(scene.summary.coverage_percent, scene.summary.noise_mm, set(faults))
    result["first"] = faults[0] if faults else None
    return result


def rules() -> Iterator[Rule]:
    """Yield every constant of the verdicts' modules that is a number or a tuple of numbers."""
    for path in sorted(VERDICTS.rglob("*.py")):
        module = ".".join(path.relative_to(VERDICTS.parents[2]).with_suffix("").parts)
        tree, values = ast.parse(path.read_text(encoding="utf-8")), vars(importlib.import_module(module))
        kernels = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.decorator_list]
        compiled = {node.id for kernel in kernels for node in ast.walk(kernel) if isinstance(node, ast.Name)}
        for line in tree.body:
            targets = line.targets if isinstance(line, ast.Assign) else []
            for name in (node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)):
                parts = values[name] if isinstance(values[name], tuple) else (values[name],)
                if name.isupper() and all(type(part) in (int, float) for part in parts):
                    yield Rule(module, name, values[name], name in compiled)


def _changed(rule: Rule, value: Any, decoded: list[Scene], before: list[Decisions]) -> int:
    """Return how many of the scans have another decision with ``value``, computed in another process."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_count, args=(rule, value, decoded, before, theirs))
    child.start()
    theirs.close()
    try:
        if not wait([ours], ENOUGH_S):
            raise TimeoutError(f"{rule.module} {rule.name} = {value!r}: not judged within {ENOUGH_S:g} s")
        return int(ours.recv())
    except EOFError:
        # If the judges fail with it, the decision on every scan changes.
        return len(decoded)
    finally:
        child.kill()
        child.join()


def _count(rule: Rule, value: Any, decoded: list[Scene], before: list[Decisions], answer: Connection) -> None:
    where = [
        module for name, module in sys.modules.items() if name.startswith("appliance.") and _holds(vars(module), rule)
    ]
    for module in where:
        setattr(module, rule.name, value)
    if rule.in_kernel:
        _compile_again([vars(module) for module in where])
    answer.send(sum(decisions(scene) != old_decisions for scene, old_decisions in zip(decoded, before, strict=True)))


def _holds(names: Mapping[str, Any], rule: Rule) -> bool:
    return rule.name in names and names[rule.name] is vars(sys.modules[rule.module])[rule.name]


def _compile_again(modules: list[dict[str, Any]]) -> None:
    """Compile the kernels of these modules again, without changing the cache on the disk."""
    for kernel in {
        id(kernel_object): kernel_object
        for names in modules
        for kernel_object in names.values()
        if isinstance(kernel_object, CPUDispatcher)
    }.values():
        vars(kernel)["_cache"] = NullCache()
        kernel.recompile()
