"""A second housing works by its rig file alone: baseline 120 mm, at 300 mm, with a projector of 1280 × 720; it scans, and is calibrated in air and in water."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.base import silent
from appliance.calibrate.air.calibrate import AirCalibration, calibrate_air
from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import USED, RecordingCheck, Refusal, Session, Step
from appliance.calibrate.water.start import start_from_air
from appliance.calibrate.water_steps import Solution, examine_recording, solve_calibration
from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.cli.simtruth import bring_calibration, true_calibration
from appliance.instrument.service.app import run
from appliance.instrument.service.settings import live_light_of, machine_settings
from appliance.measure.calibration.file import Calibration, encode_calibration
from appliance.measure.fault import FaultCode
from appliance.measure.light.patterns import DARK_CODE, PatternSequence, build_sequence
from appliance.measure.light.volume import STANDARD
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library, LibraryFolder
from appliance.store.manifest import ScanRecord, SequenceInfo
from hw_sim.options import options_from
from hw_sim.rendering.render import Renderer
from hw_sim.truth import TrueRig, in_air
from hw_sim.world import true_rig
from tests.integration.dived import ball_bar_mm, instrument, off_surface_mm
from tests.support.board_pictures import views_of_boards
from tests.support.rendered import exposed, pictures
from tests.support.truth import WATER

pytestmark = [pytest.mark.devices, pytest.mark.timeout(300)]

COMPACT = default_sim_rig().with_name("compact.toml")
NEARER = 0.6
"""Of the standard housing's distances."""
SEED, SIZE, BOARDS = 2, "640x400", 8
Pose = tuple[float, float, float, float, float, float]
Frames = Mapping[str, NDArray[np.uint8]]
PIPE: Pose = (0.0, 0.0, 336.0, 0.0, 6.0, 20.0)
HELD: Mapping[Step, tuple[str, Pose]] = {
    Step.M1: ("ballbar", (-9.0, -12.0, 303.0, 0.0, 35.0, 20.0)),
    Step.M2: ("ballbar", (9.0, 12.0, 315.0, 0.0, -35.0, 70.0)),
    Step.M3: ("plane", (0.0, 0.0, 287.0, 8.0, -10.0, 0.0)),
    Step.M4: ("plane", (0.0, 0.0, 342.0, -10.0, 8.0, 0.0)),
    Step.VERIFY: ("ballbar", (0.0, 0.0, 312.0, 0.0, 5.0, -40.0)),
}
"""As in the guide, at six tenths of the standard distances."""
UNSEEN: Pose = (-6.0, 0.0, 327.0, 0.0, -15.0, 85.0)
DIVE = f"""
wait state AIM 90
wait distance 287 6 30      # by the laser dots
object pipe {" ".join(f"{v:g}" for v in PIPE)}
press scan
wait state REVIEW 90
pause 2
press scan                  # keep
wait state AIM 60
object plane {" ".join(f"{v:g}" for v in HELD[Step.M3][1])}
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


def test_it_scans_and_its_guide_wants_planes_where_it_measures(tmp_path: Path) -> None:
    """A plane at 287 mm is the near one here, and too near for the far one; before the standard housing it would be neither."""
    nominal = {"texture": "none", "truth": "nominal", "seed": 3}
    rig = instrument(tmp_path, DIVE, COMPACT, "480x300", object_name="plane", **nominal)
    wires = {**rig.rig.wires_options, "object_pose": list(HELD[Step.M3][1])}
    rig = replace(rig, rig=replace(rig.rig, wires_options=wires))
    bring_calibration(rig)
    assert run(rig) == 0

    library = Library(rig.storage.root)
    scan, recorded = (entry.manifest for entry in library.entries())
    assert scan is not None
    assert recorded is not None
    patterns = len(scan.record.sequence.patterns)
    assert patterns == machine_settings(rig).frames[16] == 25, "8 + 7 Gray, 8 sines, two references"
    verdicts = {verdict.name: verdict.passed for verdict in scan.record.verdicts}
    assert (verdicts["identity"], verdicts["sides"]) == (True, True)
    off_mm = off_surface_mm(rig, scan.scan_id, object="pipe", object_pose=PIPE)
    assert len(off_mm) > 50_000
    assert float(np.sqrt(np.mean(off_mm**2))) < 0.03

    (trial,) = Calibrations(rig.storage.root, rig.rig.serial).session().trials
    assert (trial.step, trial.scan_id, trial.detail[:19]) == (Step.M3, recorded.scan_id, "plane 287 mm away, ")
    refused = [entry.manifest.reason for entry in library.entries(LibraryFolder.REJECTED) if entry.manifest is not None]
    assert [reason.split(": ")[1] for reason in refused] == [Refusal.NOT_FOUND.value, Refusal.TOO_NEAR.value]


def scanned(rig: Rig, truth: TrueRig, what: str, pose: Pose) -> tuple[PatternSequence, Frames]:
    """Return the sequence and both cameras' frames of an artefact at rest."""
    scene = replace(options_from(rig.rig.wires_options).scene(), object=what, pose=pose, texture="none")
    sequence = build_sequence(rig.scan.period_px, rig.projector.width_px, rig.projector.height_px)
    return sequence, exposed(Renderer(truth, scene), pictures(sequence), 1e-3 * rig.camera.left.exposure_ms)


def test_without_its_own_volume_it_has_no_point_and_exchanged_cameras_are_named_by_its_drawing_alone() -> None:
    """Drawing and world state the same twice: where they differ, lengths would be wrong."""
    rig = apply_options(load_rig(COMPACT), SimOptions(texture="none", truth="nominal", size="480x300"))
    drawn, exact = Instrument(rig).design(), true_calibration(rig)
    for mine, its in ((drawn.rig.left, exact.rig.left), (drawn.rig.right, exact.rig.right)):
        assert mine.lens.f_px == pytest.approx(its.lens.f_px)
        assert (mine.lens.c_px, mine.port) == (its.lens.c_px, its.port)
        np.testing.assert_allclose(mine.translation_mm, its.translation_mm, atol=1e-9)
        np.testing.assert_allclose(mine.rotation, its.rotation, atol=1e-9)
    light = live_light_of(rig)
    assert light.shape == (720, 1280)
    assert 0.01 < float(np.mean(light == DARK_CODE)) < 0.25

    sequence, frames = scanned(rig, true_rig(rig.rig.wires_options), *HELD[Step.M3])

    def faults(calibration: Calibration, left: str, right: str) -> tuple[int, list[FaultCode]]:
        with Pipeline(calibration, WATER, sequence) as pipeline:
            processor = SequenceProcessor(pipeline, calibration, WATER)
            processor.begin(Instrument(rig).settings(Instrument(rig).exposure))
            list(processor.push_all({"left": frames[left], "right": frames[right]}))
            full = processor.run()
            assert full is not None
            named = [one.fault.code for one in full.judgements if one.fault is not None]
            return len(pipeline.table.cloud(full.cloud).points_mm), named

    assert faults(drawn, "right", "left")[1] == [FaultCode.SIDES_EXCHANGED]
    assert exact.rig.volume == Instrument(rig).volume != STANDARD
    points, named = faults(replace(exact, rig=replace(exact.rig, volume=STANDARD)), "left", "right")
    assert (points, FaultCode.SCAN_NEAR in named) == (0, True)


@dataclass(frozen=True)
class Calibrated:
    """An instrument built a little wrong, and what two calibrations say of it."""

    rig: Rig
    truth: TrueRig
    air: AirCalibration
    checks: Mapping[Step, RecordingCheck]
    solution: Solution


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    """The whole calibration, from stored scans as the instrument stores them."""
    root = tmp_path_factory.mktemp("calibrated")
    options = SimOptions(root=root, texture="none", truth="realistic", seed=SEED, size=SIZE)
    rig = apply_options(load_rig(COMPACT), options)
    truth = true_rig(rig.rig.wires_options)
    air = calibrate_air(views_of_boards(truth, BOARDS, SEED, NEARER), truth.left.width_px, truth.left.height_px)
    store, library, session = Calibrations(root, rig.rig.serial), Library(root), Session()
    library.prepare()
    store.folder.mkdir(exist_ok=True)
    store.air.write_bytes(encode_calibration(start_from_air(air, Instrument(rig).design())))
    checks = {}
    for step, (what, pose) in HELD.items():
        sequence, frames = scanned(rig, truth, what, pose)
        info = ScanRecord(SequenceInfo.of(sequence), rig.rig_hash, None, "0", None, False, 0)
        pending = library.begin(frames, info, Instrument(rig).origin(Instrument(rig).design()))
        pending.publish(info)
        trial = RecordingCheck(step, None, None, scan_id=pending.scan_id)
        session = replace(session, trials=(*session.trials, trial))
        if step in USED:
            checks[step] = examine_recording(rig, step, library.entry(pending.scan_id).folder, silent).check
    store.write(session)
    return Calibrated(rig, truth, air, checks, solve_calibration(rig, "2026-11-24T10:00:00+00:00", silent))


def test_boards_in_air_find_lenses_and_baseline_and_recordings_at_its_distances_will_do(calibrated: Calibrated) -> None:
    dry = in_air(calibrated.truth)
    for found, true in ((calibrated.air.rig.left, dry.left), (calibrated.air.rig.right, dry.right)):
        assert found.lens.f_px[0] == pytest.approx(true.f_px[0], rel=1e-3)
    base_mm = float(np.linalg.norm(np.subtract(dry.right.t_mm, dry.left.t_mm)))
    assert np.linalg.norm(calibrated.air.rig.right.translation_mm) == pytest.approx(base_mm, abs=0.03)
    assert {step: check.refusal for step, check in calibrated.checks.items()} == dict.fromkeys(USED)


def test_lengths_at_a_pose_that_nobody_recorded_are_right_afterwards(calibrated: Calibrated) -> None:
    """Within the limits of the standard housing (``test_calibrate``), against the truth, which no certificate states."""
    solution, rig, truth = calibrated.solution, calibrated.rig, calibrated.truth
    assert (solution.calibration.rig.volume, solution.solved.warnings) == (Instrument(rig).volume, ())
    verified = solution.verified
    assert verified is not None
    assert abs(verified.after or 1.0) < min(0.0005, abs(verified.before or 0.0) / 3.0)
    sequence, frames = scanned(rig, truth, "ballbar", UNSEEN)
    before, after = (
        abs(ball_bar_mm(calibration, sequence, frames) / truth.artefacts.ball_distance_mm - 1.0)
        for calibration in (start_from_air(calibrated.air, Instrument(rig).design()), solution.calibration)
    )
    assert after < min(0.0006, before / 3.0)
