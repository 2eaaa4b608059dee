"""Points of exact coordinates on a plane that two pinholes see, and the reason of each pixel that has none."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.desk.foreign.camera import DecodedCamera, clean_camera
from appliance.desk.foreign.cameras import NO_PORT, ForeignRig
from appliance.desk.foreign.decode import AxisCoordinates, Reason
from appliance.desk.foreign.description import AxisConvention, Description, ImageFiles
from appliance.desk.foreign.first_look import check_import
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.importing import draw_reasons
from appliance.desk.foreign.points import ForeignCloud, depths_of, find_points
from appliance.desk.foreign.problem import ForeignError, Table
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens

W, H, F_PX, DEPTH_MM, PROJECTOR_F_PX = 120, 90, 150.0, 400.0, 1200.0
NOISE_PX = 0.002
OFF_MM = 0.004
"""What that noise is in depth: both coordinates' difference, over what a millimetre of depth changes it by."""


def rig(
    baseline_mm: float = 100.0, toe_in_deg: float = 14.0, size_px: tuple[int, int] = (W, H), f_px: float = F_PX
) -> ForeignRig:
    """A left camera that looks along z, and a right one beside it that is turned towards its axis."""
    lens = Lens((f_px, f_px), ((size_px[0] - 1) / 2, (size_px[1] - 1) / 2))
    left = HousedCamera(*size_px, lens, NO_PORT, lens_in_water=True)
    c, s = np.cos(np.radians(toe_in_deg)), np.sin(np.radians(toe_in_deg))
    turned = ((c, 0.0, -s), (0.0, 1.0, 0.0), (s, 0.0, c))
    return ForeignRig(StereoRig(left, replace(left, rotation=turned, translation_mm=(baseline_mm, 0.0, 0.0))), 1.0)


def seen(camera: HousedCamera, seed: int) -> DecodedCamera:
    """The coordinates that a projector half way between both cameras draws on the plane z = ``DEPTH_MM``."""
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    x, y = (u - camera.lens.c_px[0]) / camera.lens.f_px[0], (v - camera.lens.c_px[1]) / camera.lens.f_px[0]
    along = np.stack([x, y, np.ones_like(x)], -1) @ np.asarray(camera.rotation).T
    place_mm = np.asarray(camera.translation_mm) + along * ((DEPTH_MM - camera.translation_mm[2]) / along[..., 2:])
    noise = np.random.default_rng(seed)
    placed = {}
    for k, name in enumerate("xy"):
        drawn_px = 500.0 + PROJECTOR_F_PX * place_mm[..., k] / DEPTH_MM + noise.normal(0.0, NOISE_PX, x.shape)
        placed[name] = AxisCoordinates(
            drawn_px.astype(np.float32), np.zeros(x.shape, np.uint8), np.full(x.shape, 100.0, np.float32)
        )
    return DecodedCamera(
        ImageSet((), (), np.zeros((1, *x.shape), np.uint8), 255.0), {}, placed, np.zeros(x.shape, np.uint8)
    )


def described(
    axes: str, near_mm: float | None = None, far_mm: float | None = None, max_sigma_mm: float | None = None
) -> Description:
    found = tuple(AxisConvention(name, 1000.0, (32.0,), ((0.0, 120.0, 240.0),)) for name in axes)
    return Description(
        "", Path(), {"left": ImageFiles(("*",)), "right": ImageFiles(("*",))}, None, "grey", None, (1000, 1000), found,
        Table("", {}), near_mm=near_mm, far_mm=far_mm, max_sigma_mm=max_sigma_mm,
    )  # fmt: skip


def both(cameras: ForeignRig) -> tuple[DecodedCamera, DecodedCamera]:
    left, right = (seen(one, seed) for seed, one in enumerate((cameras.rig.left, cameras.rig.right)))
    return left, right


def searched(description: Description, cameras: ForeignRig, left: DecodedCamera, right: DecodedCamera) -> ForeignCloud:
    """Points of the directions that are described, of cameras that have both."""
    names = [axis.name for axis in description.axes]
    first, second = (
        clean_camera(replace(one, placed={name: one.placed[name] for name in names})) for one in (left, right)
    )
    return find_points(description, cameras, first, second)


@pytest.mark.parametrize("axes", ["x", "xy"])
@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ((None, None, 1e-4), Reason.SIGMA),
        ((410.0, 2000.0, None), Reason.DEPTH),
        ((200.0, 390.0, None), Reason.DEPTH),
        ((), None),
    ],
)
def test_points_lie_where_the_plane_is_and_the_filter_that_took_them_is_named(
    axes: str, limits: tuple[float | None, ...], reason: Reason | None
) -> None:
    cameras = rig()
    cloud = searched(described(axes, *limits), cameras, *both(cameras))
    assert sum(cloud.reasons.values()) + cloud.points == W * H
    if reason:
        assert cloud.points == 0
        # Along a curve nothing is searched beyond the depths: there the coordinate is not found.
        wanted = Reason.NO_MATCH if (axes, reason) == ("x", Reason.DEPTH) else reason
        assert next(iter(cloud.reasons)) is wanted
        assert cloud.reasons[wanted] > 0.6 * W * H
        assert cloud.largest_reasons()[0].startswith(f"{wanted.word}: ")
        assert wanted.text in cloud.largest_reasons()[0]
        if reason is Reason.SIGMA:
            # It says which limit would do.
            assert float(cloud.largest_reasons()[0].split("mostly ")[1].split()[0]) == pytest.approx(OFF_MM, rel=0.5)
    else:
        there = cloud.cloud.mask
        assert cloud.cloud.shape == (H, W)
        assert there.mean() > 0.7
        points_mm, (_, u) = cloud.cloud.points_mm[there], np.nonzero(there)
        assert np.allclose(points_mm[:, 2], DEPTH_MM, atol=0.2)
        assert np.allclose(points_mm[:, 0], (u - (W - 1) / 2) / F_PX * DEPTH_MM, atol=0.1)


def test_rays_that_pass_each_other_are_a_gap() -> None:
    """The right image is moved up by four of its pixels."""
    cameras = rig()
    left, right = both(cameras)
    moved = {
        name: replace(one, coordinate_px=np.roll(one.coordinate_px, -4, axis=0)) for name, one in right.placed.items()
    }
    cloud = searched(described("xy"), cameras, left, replace(right, placed=moved))
    assert cloud.points == 0
    assert next(iter(cloud.reasons)) is Reason.GAP


def test_what_decoding_leaves_out_keeps_its_reason() -> None:
    cameras = rig()
    left, right = both(cameras)
    bands = {"x": (Reason.WEAK, 0), "y": (Reason.SATURATED, 20)}
    placed = {}
    for name, (why, row) in bands.items():
        one = left.placed[name]
        one.reason[row : row + 10], one.coordinate_px[row : row + 10] = why, np.nan
        placed[name] = one
    cloud = searched(described("xy"), cameras, replace(left, placed=placed), right)
    assert (cloud.reason_map[:10] == Reason.WEAK).all()
    assert (cloud.reason_map[20:30] == Reason.SATURATED).all()
    assert cloud.reasons[Reason.WEAK] == cloud.reasons[Reason.SATURATED] == 10 * W
    assert cloud.decoded_pixels == W * H - 20 * W


def nothing_seen(camera: DecodedCamera) -> DecodedCamera:
    def blind(one: AxisCoordinates) -> AxisCoordinates:
        nowhere, weak = np.full_like(one.coordinate_px, np.nan), np.full_like(one.reason, Reason.WEAK)
        return replace(one, coordinate_px=nowhere, reason=weak)

    return replace(camera, placed={name: blind(one) for name, one in camera.placed.items()})


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_a_lack_of_points_is_said_and_not_raised(axes: str) -> None:
    cameras = rig()
    left, right = both(cameras)
    away = replace(cameras.rig.right, rotation=((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)))
    backwards = replace(cameras, rig=replace(cameras.rig, right=away))
    blind = searched(described(axes), cameras, nothing_seen(left), right)
    alone = searched(described(axes), cameras, left, nothing_seen(right))
    behind = searched(described(axes), backwards, left, right)
    assert [one.points for one in (blind, alone, behind)] == [0, 0, 0]
    assert blind.failure
    assert alone.failure
    assert blind.reasons == {Reason.WEAK: W * H}
    assert next(iter(behind.reasons)) is Reason.NO_MATCH


@pytest.mark.parametrize(
    ("baseline_mm", "toe_in_deg", "depth_mm"),
    [(1074.0, 49.1, 930.0), (900.0, 66.0, 400.0), (100.0, 0.0, 400.0), (10.0, 0.0, 500.0), (100.0, -3.0, 400.0)],
)
def test_depths_follow_what_the_cameras_look_at(baseline_mm: float, toe_in_deg: float, depth_mm: float) -> None:
    """Axes that cross nearer than one baseline do so there; parallel ones, and such that part, say nothing."""
    cameras = rig(baseline_mm, toe_in_deg)
    near_mm, far_mm = depths_of(described("x"), cameras.rig, 1.0)
    assert 0.0 < near_mm < 0.7 * depth_mm
    assert far_mm > 1.15 * depth_mm


def test_images_wider_than_a_scratch_row_have_points_all_over() -> None:
    """The kernels' rows hold 4096 columns: strips are narrower, and nothing is lost between them."""
    width = 4400
    cameras = rig(20.0, 2.86, (width, 8), 6000.0)
    cloud = searched(described("xy"), cameras, *both(cameras))
    there = cloud.cloud.mask
    for part in (np.s_[:, 300:800], np.s_[:, 1000:1100], np.s_[:, 4000:4200]):
        assert there[part][1:-1].mean() > 0.9
    # Nor is a point beside a strip's end less sure than those about it.
    assert np.nanmax(cloud.cloud.sigma_mm[2:-2, 100:-100]) < 2.0 * np.nanmedian(cloud.cloud.sigma_mm)
    _, u = np.nonzero(there)
    x_mm = (u - (width - 1) / 2) / 6000.0 * DEPTH_MM
    assert np.allclose(cloud.cloud.points_mm[there][:, 0], x_mm, atol=0.1)


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_pixels_at_which_the_lens_folds_over_are_left_out_and_counted(axes: str) -> None:
    """r (1 + k1 r²) turns back at r² = −1/(3 k1): what lies beyond ⅔ of that radius in the image, no ray reaches."""
    cameras = rig()
    left, right = both(cameras)
    folding = replace(cameras.rig.left, lens=replace(cameras.rig.left.lens, distortion=(-0.9, 0.0, 0.0, 0.0, 0.0)))
    cloud = searched(described(axes), replace(cameras, rig=replace(cameras.rig, left=folding)), left, right)
    v, u = np.mgrid[0:H, 0:W]
    beyond = np.hypot((u - (W - 1) / 2) / F_PX, (v - (H - 1) / 2) / F_PX) > (2.0 / 3.0) * (1.0 / 2.7) ** 0.5
    assert 0.02 < beyond.mean() < 0.2
    assert (cloud.reason_map[beyond] == Reason.NO_RAY).all()
    assert cloud.reasons[Reason.NO_RAY] < 1.4 * beyond.sum()


def test_a_picture_shows_the_reason_of_each_pixel(tmp_path: Path) -> None:
    cameras = rig()
    left, right = both(cameras)
    left.placed["x"].reason[20:50], left.placed["x"].coordinate_px[20:50] = Reason.CONTRADICTION, np.nan
    left.grey[:] = 77
    cloud = searched(described("xy"), cameras, left, right)
    draw_reasons(cloud, tmp_path / "why.png")
    drawn = np.asarray(cv2.imread(str(tmp_path / "why.png")))[..., ::-1]
    assert (drawn[20:50, :W] == Reason.CONTRADICTION.colour).all()
    assert (drawn[:H, :W][cloud.cloud.mask] == 77).all()
    # Each colour that is there is named below.
    for reason in list(Reason)[1:]:
        assert (drawn[H:, :20] == reason.colour).all(axis=-1).any() == (reason in cloud.reasons)


def test_a_side_that_no_map_can_number_is_refused_by_the_headers(tmp_path: Path) -> None:
    for k in range(8):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.zeros((30, 40), np.uint8))
    eye = "matrix = [[50, 0, 20], [0, 50, 15], [0, 0, 1]]\n"
    description = tmp_path / "set.toml"
    for projector_px in (65536, 65535):
        description.write_text(
            '[images]\nleft = "*.png"\norder = "bright dark gray-x*3 gray-y*3"\n'
            f"[projector]\nwidth_px = {projector_px}\nheight_px = 30\n[x]\nstripe_px = 8192\n[y]\nstripe_px = 8\n"
            "[cameras]\nrotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\ntranslation = [-120, 0, 0]\n"
            f"[cameras.left]\n{eye}[cameras.right]\n{eye}"
        )
        with pytest.raises(ForeignError, match="a side of 65536 px") if projector_px > 65535 else nullcontext():
            check_import(description, tmp_path / "cloud.ply")
