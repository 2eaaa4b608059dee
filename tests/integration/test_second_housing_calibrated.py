"""A second housing is calibrated by its rig file alone: boards in air, five recordings in water, and lengths at poses that nobody recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.air.adjustment import AirCalibration, BoardView, calibrate_air
from appliance.calibration.air.board import BoardDesign, NoBoard, find_board
from appliance.calibration.file import Calibration, encode
from appliance.calibration.guide import USED, RecordingCheck, Refusal, Session, Step
from appliance.calibration.water.start import start_from_air
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.cli.simtruth import bring_calibration
from appliance.config import Rig, load_rig
from appliance.evaluation.ball_bar import BallBar, find_ball_bar
from appliance.instrument import design_of, origin_of, volume_of
from appliance.patterns.sequence import PatternSequence, build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.quality import QualityLimits
from appliance.service.app import run
from appliance.service.calibrator import Solution, examine, solve
from appliance.storage.calibrations import Calibrations
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.record import ScanRecord, SequenceInfo
from hw_sim.options import options_from
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, in_air
from hw_sim.water.medium import AIR
from hw_sim.world import true_rig
from tests.support.board_pictures import picture, poses_in_air
from tests.support.rendered import pictures

pytestmark = [pytest.mark.devices, pytest.mark.timeout(300)]

COMPACT = default_sim_rig().with_name("compact.toml")
NEARER = 0.6
"""Of the standard housing's distances."""
SEED, SIZE, BOARDS = 2, "640x400", 10
Pose = tuple[float, float, float, float, float, float]
HELD: Mapping[Step, tuple[str, Pose]] = {
    Step.M1: ("ballbar", (-9.0, -12.0, 303.0, 0.0, 35.0, 20.0)),
    Step.M2: ("ballbar", (9.0, 12.0, 315.0, 0.0, -35.0, 70.0)),
    Step.M3: ("plane", (0.0, 0.0, 287.0, 8.0, -10.0, 0.0)),
    Step.M4: ("plane", (0.0, 0.0, 342.0, -10.0, 8.0, 0.0)),
    Step.VERIFY: ("ballbar", (0.0, 0.0, 312.0, 0.0, 5.0, -40.0)),
}
"""As in the guide, at six tenths of the standard distances."""
UNSEEN: tuple[Pose, ...] = ((0.0, 3.0, 300.0, 0.0, 20.0, 0.0), (-6.0, 0.0, 327.0, 0.0, -15.0, 85.0))

GUIDED = """
wait state AIM 90
press scan
wait state REVIEW 90
pause 2
press scan                  # keep
wait state AIM 60
press up                    # the menu
press down
press down
press down
press scan
wait step M1 10
press scan                  # a plane: no ball bar
wait result NOT_FOUND 60
press down
press down
wait step M3 10
press scan
wait result FITS 60
wait step M1 10             # the first that is not done
press down
press down
press down
wait step M4 10
press scan                  # where the plane of before was
wait result TOO_NEAR 60
press back
wait state AIM 10
pause 0.5
end
"""


@dataclass(frozen=True)
class Calibrated:
    """An instrument built a little wrong, and what two calibrations say of it."""

    rig: Rig
    truth: TrueRig
    air: AirCalibration
    checks: Mapping[Step, RecordingCheck]
    solution: Solution


def scanned(rig: Rig, truth: TrueRig, what: str, pose: Pose) -> tuple[PatternSequence, dict[str, NDArray[np.uint8]]]:
    """Return the sequence and both cameras' frames of an artefact at rest."""
    scene = replace(options_from(rig.rig.wires_options).scene(), object=what, pose=pose, texture="none")
    renderer = Renderer(truth, scene)
    sequence = build_sequence(rig.scan.period_px, rig.projector.width_px, rig.projector.height_px)
    time_s = 1e-3 * rig.camera.left.exposure_ms
    return sequence, {
        side: np.stack(
            [
                renderer.expose(side, [LightSlice(shown, time_s)], 0.0, time_s, 0.0, (False, False), 2 * k + n, k / 60)
                for k, shown in enumerate(pictures(sequence))
            ]
        )
        for n, side in enumerate(("left", "right"))
    }


def boards(truth: TrueRig) -> list[BoardView]:
    """Return what the product finds in pictures of boards in air, nearer than before the standard housing."""
    renderer, found = Renderer(in_air(truth), Scene(object="board")), []
    for k, (x, y, z, *turns) in enumerate(poses_in_air(BOARDS, SEED)):
        pose = (NEARER * x, NEARER * y, NEARER * z, turns[0], turns[1], turns[2])
        seen = picture(renderer, pose, AIR, k)
        view = find_board(f"board {k}", seen.left, seen.right, BoardDesign())
        assert not isinstance(view, NoBoard), view
        found.append(view)
    return found


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    """The whole calibration, from stored scans as the instrument stores them."""
    root = tmp_path_factory.mktemp("calibrated")
    options = SimOptions(root=root, texture="none", truth="realistic", seed=SEED, size=SIZE)
    rig = simulated(load_rig(COMPACT), options)
    truth = true_rig(rig.rig.wires_options)
    air = calibrate_air(boards(truth), truth.left.width_px, truth.left.height_px)
    store, library, session = Calibrations(root, rig.rig.serial), Library(root), Session()
    library.prepare()
    store.folder.mkdir(exist_ok=True)
    store.air.write_bytes(encode(start_from_air(air, design_of(rig))))
    checks = {}
    for step, (what, pose) in HELD.items():
        sequence, frames = scanned(rig, truth, what, pose)
        info = ScanRecord(SequenceInfo.of(sequence), rig.rig_hash, None, "0", None, False, 0)
        pending = library.begin(frames, info, origin_of(rig, design_of(rig)))
        pending.publish(info)
        trial = RecordingCheck(step, None, None, scan_id=pending.scan_id)
        session = replace(session, trials=(*session.trials, trial))
        if step in USED:
            checks[step] = examine(rig, step, library.entry(pending.scan_id).folder, lambda _: None).check
    store.write(session)
    return Calibrated(rig, truth, air, checks, solve(rig, "2026-11-24T10:00:00+00:00", lambda _: None))


def test_boards_in_air_find_lenses_and_baseline(calibrated: Calibrated) -> None:
    dry = in_air(calibrated.truth)
    for found, true in ((calibrated.air.rig.left, dry.left), (calibrated.air.rig.right, dry.right)):
        assert found.lens.f_px[0] == pytest.approx(true.f_px[0], rel=1e-3)
    base_mm = float(np.linalg.norm(np.subtract(dry.right.t_mm, dry.left.t_mm)))
    assert np.linalg.norm(calibrated.air.rig.right.translation_mm) == pytest.approx(base_mm, abs=0.03)


def test_recordings_at_six_tenths_of_the_standard_distances_will_do(calibrated: Calibrated) -> None:
    assert {step: check.refusal for step, check in calibrated.checks.items()} == dict.fromkeys(USED)


def test_lengths_at_poses_that_nobody_recorded_are_right_afterwards(calibrated: Calibrated) -> None:
    """Within the limits of the standard housing (``test_calibrate``), against the truth, which no certificate states."""
    solution, rig, truth = calibrated.solution, calibrated.rig, calibrated.truth
    assert solution.calibration.rig.volume == volume_of(rig)
    assert solution.solved.warnings == ()
    assert solution.verified is not None
    assert solution.verified.before is not None
    assert solution.verified.after is not None
    assert abs(solution.verified.after) < 0.0005
    assert abs(solution.verified.after) < abs(solution.verified.before) / 3.0
    in_air_only = start_from_air(calibrated.air, design_of(rig))
    errors: dict[str, list[float]] = {"before": [], "after": []}
    for pose in UNSEEN:
        sequence, frames = scanned(rig, truth, "ballbar", pose)
        for name, calibration in (("before", in_air_only), ("after", solution.calibration)):
            length = length_mm(calibration, sequence, frames)
            errors[name].append(abs(length / truth.artefacts.ball_distance_mm - 1.0))
    print(f"{solution.verified}, residual {solution.solved.residual_px:.3f} px, E_L at unseen poses {errors}")
    assert max(errors["after"]) < 0.0006
    assert max(errors["after"]) < max(errors["before"]) / 3.0


def length_mm(calibration: Calibration, sequence: PatternSequence, frames: Mapping[str, NDArray[np.uint8]]) -> float:
    """Return the length of the ball bar in a scan."""
    with Pipeline(calibration, calibration.water, sequence, QualityLimits(max_gap_mm=20.0)) as pipeline:
        for k in range(len(sequence)):
            for side, taken in frames.items():
                pipeline.push(side, taken, k)
        pipeline.coarse()
        bar = find_ball_bar(pipeline.full())
    assert isinstance(bar, BallBar)
    return bar.length_mm


def test_the_guide_wants_planes_where_this_housing_measures(tmp_path: Path) -> None:
    """A plane at 287 mm is the near one here, and too near for the far one; before the standard housing it would be neither."""
    script = tmp_path / "dive.script"
    script.write_text(GUIDED)
    options = SimOptions(
        root=tmp_path / "root",
        object_name="plane",
        texture="none",
        truth="nominal",
        seed=3,
        size="480x300",
        script=script,
    )
    rig = simulated(load_rig(COMPACT), options)
    wires = {**rig.rig.wires_options, "object_pose": list(HELD[Step.M3][1])}
    rig = replace(rig, rig=replace(rig.rig, wires_options=wires))
    bring_calibration(rig)
    assert run(rig) == 0
    (trial,) = Calibrations(rig.storage.root, rig.rig.serial).session().trials
    assert (trial.step, trial.detail[:19]) == (Step.M3, "plane 287 mm away, ")
    refused = Library(rig.storage.root).entries(LibraryFolder.REJECTED)
    reasons = [entry.manifest.reason for entry in refused if entry.manifest is not None]
    assert [reason.split(": ")[1] for reason in reasons] == [Refusal.NOT_FOUND.value, Refusal.TOO_NEAR.value]
