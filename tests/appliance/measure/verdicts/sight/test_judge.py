"""What is seen of an object by itself: fringes fainter than any pixel shows, its light, and how far away it lies."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.cloud import CloudSummary
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.points.quality import QualityLimits
from appliance.measure.points.table import Cloud
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdicts.sight.judge import distance_of, look, see
from tests.support import synthetic

SEQUENCE = build_sequence(16)
SINE = SEQUENCE.axis(Direction.X).sine
CAL = synthetic.calibration()
INDEX = synthetic.WATER.index
READ = CameraNoise(0.5, 0.0, 4.0)
PHOTONS = CameraNoise(1.5, 0.12, 4.0)


def frames_of(fringe_dn: np.ndarray, light_dn: np.ndarray, noise: CameraNoise = READ) -> np.ndarray:
    """Cells (12, 16) of fringes and of light that white adds, over a dark of 10."""
    rng = np.random.default_rng(1)
    v, u = np.mgrid[0:240, 0:320]
    cell = v // 20, u // 20
    frames = np.zeros((len(SEQUENCE), 240, 320), np.uint8)
    images = {SEQUENCE.bright: 10.0 + light_dn[cell], SEQUENCE.dark: np.full(u.shape, 10.0)}
    for step, k in enumerate(SINE):
        phase = 2.0 * np.pi * u / 14.3 + step * np.pi / 2.0
        images[k] = 10.0 + 0.5 * light_dn[cell] + fringe_dn[cell] * np.cos(phase)
    for k, image in images.items():
        variance = noise.variance_dn2(image)
        frames[k] = np.clip(np.rint(image + np.sqrt(variance) * rng.standard_normal(u.shape)), 0, 255)
    return frames


def even(value: float) -> np.ndarray:
    return np.full((12, 16), value)


def test_fringes_half_a_grey_value_high_are_seen_and_noise_is_not() -> None:
    # An object of which all light carries fringes: they are half as high as what white adds.
    found = see(frames_of(even(0.6), even(1.2)), SEQUENCE, READ)
    assert found.cells > 0.95
    assert found.fringe_dn == pytest.approx(0.6, abs=0.08)
    nothing = see(frames_of(even(0.0), even(1.2), PHOTONS), SEQUENCE, PHOTONS)
    assert (nothing.cells, nothing.fringe_dn, nothing.object_share) == (0.0, None, None)
    assert see(frames_of(even(5.0), even(20.0)), SEQUENCE, READ).object_share == pytest.approx(0.5, rel=0.02)
    # Where white adds nothing at all, what carries fringes is of half a grey value.
    assert see(frames_of(even(1.0), even(0.0)), SEQUENCE, READ).object_share == pytest.approx(4.0, rel=0.1)


def test_a_cell_of_forty_clear_pixels_says_something_and_one_of_less_does_not() -> None:
    for many in (40, 39):
        frames = frames_of(even(5.0), even(20.0))
        frames[[SEQUENCE.bright, *SINE]] = np.minimum(frames[[SEQUENCE.bright, *SINE]], 200)
        cell = frames[SEQUENCE.bright, :20, :20]
        cell[:] = np.where(np.arange(400) < many, 30, 255).reshape(20, 20)
        assert np.isfinite(see(frames, SEQUENCE, READ).glow_dn[0]) == (many == 40)


def test_where_all_is_too_bright_nothing_is_seen() -> None:
    found = see(np.full((len(SEQUENCE), 240, 320), 255, np.uint8), SEQUENCE, READ)
    assert (found.cells, found.top_dn, found.fringe_dn) == (0.0, 0.0, None)
    assert np.isnan(found.glow_dn).all()


# ---------------------------------------------------------------------------------------- where it lies


@pytest.mark.parametrize("depth_mm", [330.0, 450.0, 800.0])
def test_a_parallax_of_the_stripes_is_a_distance(depth_mm: float) -> None:
    """The projector stands half way between the cameras; its middle ray moves over the left picture with the depth."""
    origin, along = synthetic.projector(CAL).rays(np.array([511.5, 383.5]), INDEX)
    usual_mm = float(CAL.rig.volume_centre_mm(INDEX)[2])
    points = [origin + along * ((z - origin[2]) / along[2]) for z in (depth_mm, usual_mm)]
    here, there = CAL.rig.left.project(np.array(points), INDEX)
    parallax_percent = 100.0 * (here[0] - there[0]) / CAL.rig.left.width_px
    assert (parallax_percent > 0.0) == (depth_mm < usual_mm)
    assert distance_of(parallax_percent, CAL.rig, INDEX) == pytest.approx(depth_mm, rel=0.04)


def test_stripes_beyond_those_of_infinity_have_no_distance() -> None:
    assert distance_of(-60.0, CAL.rig, INDEX) is None
    assert distance_of(0.0, CAL.rig, INDEX) == pytest.approx(float(CAL.rig.volume_centre_mm(INDEX)[2]))


def cloud(*depths_mm: float) -> Cloud:
    n = len(depths_mm)
    points, ones = np.outer(depths_mm, (0.0, 0.0, 1.0)).astype(np.float32), np.ones(n, np.float32)
    summary = CloudSummary(n, None, None, None, None)
    return Cloud(points, ones.astype(np.uint8), ones, ones, ones, np.arange(n, dtype=np.uint32), summary)


NOISE = StereoNoise(READ, READ)
LIMITS = QualityLimits()
"""Depths from 380 to 680 mm."""
GLOW = frames_of(even(0.0), 2.0 + 3.0 * np.tile(np.linspace(0.0, 1.0, 16), (12, 1)))


def seen(left: np.ndarray, right: np.ndarray, loose: Cloud, parallax: float | None = None) -> dict[str, float | None]:
    frames = {"left": left, "right": right}
    images = ScanImages(SEQUENCE, frames, {}, AcquisitionSettings(noise=NOISE))
    said = look(images, CAL.rig, INDEX, loose, LIMITS, parallax)
    assert (said.name, said.passed) == ("sight", None)
    return dict(said.numbers)


def percent_at(depth_mm: float) -> float:
    """The parallax that ``distance_of`` takes for this depth."""
    middle = float(CAL.rig.volume_centre_mm(INDEX)[2])
    at_one = 1.0 / float(distance_of(1.0, CAL.rig, INDEX) or 0.0) - 1.0 / middle
    return (1.0 / depth_mm - 1.0 / middle) / at_one


def test_the_camera_that_sees_more_of_the_object_is_believed() -> None:
    few = even(0.0)
    few[:3] = 6.0
    dim, full = frames_of(few, even(20.0)), frames_of(even(6.0), even(30.0))
    for left, right in ((dim, full), (full, dim)):
        numbers = seen(left, right, cloud())
        assert numbers["fringe_cells_percent"] == pytest.approx(100.0, abs=1.0)
        for name, wanted, within in (
            ("top_dn", 30.0, 0.5), ("light_dn", 30.0, 0.1), ("object_percent", 40.0, 0.5), ("fringe_dn", 6.0, 0.2),
        ):  # fmt: skip
            assert numbers[name] == pytest.approx(wanted, abs=within), name
        # Where fringes are seen, the water's glow is not asked.
        assert (numbers["glow_per_m"], numbers["distance_mm"]) == (None, None)


def test_where_no_fringes_are_seen_the_left_cameras_glow_is_asked_for_the_water() -> None:
    numbers = seen(GLOW, np.zeros_like(GLOW), cloud())
    assert (numbers["fringe_dn"], numbers["object_percent"]) == (None, None)
    assert numbers["glow_per_m"] is not None
    assert seen(np.zeros_like(GLOW), GLOW, cloud())["glow_per_m"] is None


def test_forty_points_say_where_the_object_lies() -> None:
    depths = [379.0] * 10 + [380.0] * 10 + [680.0] * 8 + [681.0] * 12
    for points, told in ((depths, (530.0, 25.0, 30.0)), (depths[1:], None)):
        numbers = seen(GLOW, GLOW, cloud(*points), None if told is None else percent_at(900.0))
        found = [numbers[name] for name in ("distance_mm", "near_percent", "far_percent")]
        assert found == ([None] * 3 if told is None else pytest.approx(told))


@pytest.mark.parametrize(
    ("depth_mm", "near", "far"),
    [(367.5, 100.0, 0.0), (369.5, None, None), (520.0, None, None), (699.5, None, None), (701.5, 0.0, 100.0)],
)
def test_the_parallax_alone_is_believed_far_outside(depth_mm: float, near: float | None, far: float | None) -> None:
    """By three hundredths beyond 380 and 680 mm, with too few points to say better."""
    numbers = seen(GLOW, GLOW, cloud(500.0), percent_at(depth_mm))
    assert (numbers["near_percent"], numbers["far_percent"]) == (near, far)
    assert numbers["distance_mm"] == (None if near is None else pytest.approx(depth_mm))
