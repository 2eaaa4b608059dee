"""Every frame of a scan that is not the pattern it should be is found and named, and no good scan is accused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.fault import FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import TYPICAL
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.verdict import Judgement
from appliance.measure.verdicts.identity.evidence import Witness, follow
from appliance.measure.verdicts.identity.judge import judge_identity
from appliance.measure.verdicts.identity.lines import take_lines
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from hw_sim.water.medium import turbid
from tests.support.golden_texts import Says
from tests.support.rendered import RenderedScan, render_scan
from tests.support.synthetic import frames as ideal_frames

SEQUENCE = build_sequence(16, 128, 96)
"""Small: 18 frames, so that everything can be tried."""
N = len(SEQUENCE)
SIZE_PX = (144, 192)
Frames = NDArray[np.uint8]
Takes = Mapping[str, Frames]
"""(2, n, h, w) of each camera: the same patterns, recorded twice."""
READ_DN, DN_PER_E = 0.5, 1.0 / 51.0


def surface() -> NDArray[np.float64]:
    """Pattern coordinates of a board that bends a little and fills the field."""
    v, u = np.mgrid[0.0 : SIZE_PX[0], 0.0 : SIZE_PX[1]]
    return np.stack([0.64 * u + 0.04 * v + 2.0 * np.sin(u / 45.0) + 1.0, 0.63 * v + 0.01 * u + 2.0], -1)


def recorded(ideal: NDArray[np.float64], seed: int, light: float = 1.0) -> Frames:
    """As a camera records it: photon and read noise, 2 DN of black."""
    mean = 2.0 + light * (ideal - 3.0)
    noise = np.random.default_rng(seed).standard_normal(mean.shape) * np.sqrt(READ_DN**2 + mean * DN_PER_E)
    return np.clip(np.rint(mean + noise), 0, 255).astype(np.uint8)


def scan(ideal: NDArray[np.float64], light: float = 1.0) -> dict[str, Frames]:
    return {side: recorded(ideal, seed, light) for seed, side in enumerate(SIDES)}


@pytest.fixture(scope="module")
def ideal() -> NDArray[np.float64]:
    return ideal_frames(SEQUENCE, surface())


@pytest.fixture(scope="module")
def board(ideal: NDArray[np.float64]) -> Takes:
    return {side: np.stack([recorded(ideal, 10 * take + of) for take in range(2)]) for of, side in enumerate(SIDES)}


def with_order(board: Takes, order: Sequence[int], sides: str = "left") -> Judgement:
    """What is said when frame k of ``sides`` shows the pattern ``order[k]``; shown again, it has other noise."""
    frames = {side: takes[0] for side, takes in board.items()}
    for side in sides.split():
        frames[side] = np.stack([board[side][k % 2, shown] for k, shown in enumerate(order)])
    return judge_identity(frames, SEQUENCE)


def swapped(i: int, j: int) -> list[int]:
    order = list(range(N))
    order[i], order[j] = j, i
    return order


def code(judgement: Judgement) -> FaultCode | None:
    return None if judgement.fault is None else judgement.fault.code


@pytest.mark.parametrize("light", [1.0, 0.08])
def test_a_good_scan_passes(ideal: NDArray[np.float64], light: float) -> None:
    judgement = judge_identity(scan(ideal, light), SEQUENCE)
    assert (judgement.verdict.passed, judgement.fault) == (True, None)
    assert (judgement.verdict.numbers["doubt"] or 1.0) < 0.3


def test_every_swap_of_two_frames_is_found(board: Takes) -> None:
    witness = Witness(take_lines(board["left"][0], SEQUENCE, TYPICAL), SEQUENCE, TYPICAL)
    assert not witness.evidence(np.arange(N)).contradicted
    pairs = combinations(range(N), 2)
    missed = [pair for pair in pairs if not witness.evidence(np.array(swapped(*pair))).contradicted]
    assert missed == []


def late(k: int) -> list[int]:
    """Frame k is repeated, and all after it come one late."""
    return [*range(k), *range(k - 1, N - 1)]


def stays(k: int) -> list[int]:
    return [*range(k), *[k] * (N - k)]


WRONG, TIMING, STUCK = FaultCode.PATTERN_WRONG, FaultCode.PROJECTOR_TIMING, FaultCode.CAMERA_STUCK


@pytest.mark.parametrize(
    ("order", "sides", "expected", "device", "numbers"),
    [
        (swapped(4, 5), "left", WRONG, "camera.left", {"frame": 4}),
        (swapped(3, 14), "right", WRONG, "camera.right", {"frame": 3}),
        *[([*range(k), k - 1, *range(k + 1, N)], "left", WRONG, "camera.left", {"frame": k}) for k in (1, 9, N - 1)],
        *[(late(k), "left", WRONG, "camera.left", {"frame": k}) for k in (1, 9, N - 1)],
        ([1, *range(N - 1)], "left", WRONG, "camera.left", {"shift_frames": 1}),
        *[([before, *range(N - 1)], "left right", TIMING, "projector", {"shift_frames": 1}) for before in (1, N - 1)],
        ([*range(1, N), 1], "left right", TIMING, "projector", {"shift_frames": -1}),
        *[(stays(k), "right", STUCK, "camera.right", {"frame": k}) for k in (0, 7, N - 3)],
        (stays(N - 2), "right", WRONG, "camera.right", {"frame": N - 1}),  # two of one image are a repeat
        (stays(7), "left right", WRONG, "projector", {"frame": 7}),
    ],
)
def test_a_wrong_order_is_named_with_who_made_it_and_where(
    board: Takes, order: list[int], sides: str, expected: FaultCode, device: str, numbers: dict[str, int]
) -> None:
    fault = with_order(board, order, sides).fault
    assert fault is not None
    assert (fault.code, fault.device) == (expected, device)
    assert {name: fault.numbers[name] for name in numbers} == numbers


def test_both_cameras_frozen_to_the_bit_are_no_projector(board: Takes) -> None:
    for k in (0, N - 4):
        judgement = judge_identity({side: takes[0][stays(k)] for side, takes in board.items()}, SEQUENCE)
        assert code(judgement) is FaultCode.CAMERA_STUCK


@pytest.mark.parametrize(
    ("turn", "sides", "device"),
    [
        ((1, -1), "left", "camera.left"),
        ((-1, 1), "right", "camera.right"),
        ((-1, -1), "left", "camera.left"),
        ((1, -1), "left right", "projector"),
        ((-1, -1), "left right", "projector"),
    ],
)
def test_a_turned_picture_is_named_with_its_way(
    board: Takes, turn: tuple[int, int], sides: str, device: str, says: Says
) -> None:
    """Turned in both cameras it is the projector's doing."""
    frames = {name: takes[0] for name, takes in board.items()}
    for side in sides.split():
        frames[side] = np.ascontiguousarray(frames[side][:, :: turn[0], :: turn[1]])
    fault = judge_identity(frames, SEQUENCE).fault
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.PICTURE_MIRRORED, device)
    says(fault.detail)


def test_a_dark_projector_before_something_to_see(ideal: NDArray[np.float64]) -> None:
    ambient = np.broadcast_to(3.0 + 0.1 * (ideal[0] - 3.0), ideal.shape)
    assert code(judge_identity(scan(ambient), SEQUENCE)) is FaultCode.PROJECTOR_DARK


def test_a_wrong_scan_compiles_nothing_that_an_empty_one_has_not(board: Takes) -> None:
    """What the installation compiles is what an empty scan runs; compiling takes seconds, when a diver waits."""
    judge_identity({side: np.zeros_like(takes[0]) for side, takes in board.items()}, SEQUENCE)
    before = list(follow.signatures)
    with_order(board, swapped(4, 9))
    assert follow.signatures == before


def test_open_water_is_nothing_to_judge() -> None:
    veil = np.array([3.0 + 2.0 * pattern.codes().mean() / 247.0 for pattern in SEQUENCE.patterns])
    judgement = judge_identity(scan(np.broadcast_to(veil[:, None, None], (N, *SIZE_PX))), SEQUENCE)
    assert (judgement.verdict.passed, judgement.fault) == (None, None)


def test_a_wrong_number_of_frames_is_said(board: Takes) -> None:
    with pytest.raises(ValueError, match="17 frames of camera left for a sequence of 18"):
        judge_identity({side: takes[0, :-1] for side, takes in board.items()}, SEQUENCE)


def test_a_good_scan_that_moves_in_flickering_light_passes_and_each_exchanged_frame_is_found_in_it() -> None:
    hands = Motion(velocity_mm_s=(12.0, -9.0, 8.0), rotation_deg_s=(0.5, -1.0, 0.5))
    scene = Scene("frustum", ambient=0.1, motion=hands, daylight=Daylight(flicker_depth=0.5, flicker_hz=100.0))
    seen = render_scan(scene, "realistic", 10_501, 160, 32, 0.008, frame_s=1.0 / 60.0)
    good = judge_identity(seen.frames, seen.sequence)
    assert good.verdict.passed is True, good.verdict.text
    assert (good.verdict.numbers["doubt"] or 1.0) < 0.7
    n = len(seen.sequence)
    for side in SIDES:
        witness = Witness(take_lines(seen.frames[side], seen.sequence, TYPICAL), seen.sequence, TYPICAL)
        for i in range(n - 1):
            order = np.arange(n)
            order[[i, i + 1]] = i + 1, i
            assert witness.evidence(order).contradicted, (side, i)


def test_printed_squares_that_move_are_no_wrong_pattern_and_exchanged_frames_are_found_before_them() -> None:
    """Every fourth sample had another mean in X than in Y, so that an order which left next to no doubt was taken for movement."""
    scene = Scene("plane", texture="checker", motion=Motion(velocity_mm_s=(8.0, -8.0, 5.0)))
    seen = render_scan(scene, "realistic", 10_902, 160, 32, 0.01, frame_s=1.0 / 60.0)
    assert judge_identity(seen.frames, seen.sequence).verdict.passed
    order = np.arange(len(seen.sequence))
    order[[8, 12]] = 12, 8
    fault = judge_identity({**seen.frames, "left": seen.frames["left"][order]}, seen.sequence).fault
    assert fault is not None
    assert (fault.code, fault.numbers["frame"]) == (FaultCode.PATTERN_WRONG, 8)


def test_an_x_sine_for_a_y_sine_is_found_where_the_water_outshines_the_fringes(ideal: NDArray[np.float64]) -> None:
    """Weak fringes were looked for with the steps in question: those samples were left at which the wrong one fits."""
    lit = ideal.reshape(len(ideal), -1).mean(axis=1) / ideal.max()
    water = 200.0 * (1.0 - 0.18) * lit / lit[SEQUENCE.bright]
    frames = recorded(3.0 + 0.18 * (ideal - 3.0) + water[:, None, None], 5)
    witness = Witness(take_lines(frames, SEQUENCE, TYPICAL), SEQUENCE, TYPICAL)

    def opposite(order: Sequence[int]) -> float:
        doubts = witness.evidence(np.array(order)).doubts
        return max(doubt for name, doubt in doubts.items() if name.startswith("opposite"))

    assert opposite(range(N)) < 0.5
    of_x, of_y = (SEQUENCE.axis(direction).sine for direction in Direction)
    assert [pair for pair in zip(of_x, of_y, strict=True) if opposite(swapped(*pair)) < 1.0] == []


def seen_where(inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The patterns on a part of the board; beside it, nothing is illuminated."""
    return ideal_frames(SEQUENCE, np.where(inside[..., None], surface(), np.nan))


def doubts(ideal: NDArray[np.float64], order: Sequence[int]) -> Mapping[str, float]:
    witness = Witness(take_lines(recorded(ideal, 7), SEQUENCE, TYPICAL), SEQUENCE, TYPICAL)
    return witness.evidence(np.array(order)).doubts


def test_coarse_images_of_which_no_edge_is_seen_are_not_exchanged_unseen() -> None:
    """In milk the borders of the coarsest stripes are not told. Exchanged, quarters of the field change places: each neighbour
    follows the other, and the middle of all stays."""
    across = surface()[..., 0] / SEQUENCE.width_px
    ideal = seen_where(np.min([abs(across - edge) for edge in (0.25, 0.5, 0.75)], axis=0) > 0.06)
    assert max(doubts(ideal, range(N)).values()) < 0.3
    coarse, finer = SEQUENCE.axis(Direction.X).gray[:2]
    wrong = doubts(ideal, swapped(coarse, finer))
    assert max(doubt for name, doubt in wrong.items() if name != "elsewhere x") < 1.0, "nothing else sees it"
    assert wrong["elsewhere x"] > 1.5
    frames = {"left": recorded(ideal, 1)[swapped(coarse, finer)], "right": recorded(ideal, 2)}
    assert code(judge_identity(frames, SEQUENCE)) is FaultCode.PATTERN_WRONG


def test_what_reaches_from_before_the_volume_to_behind_it_is_no_wrong_pattern() -> None:
    """Its stripes lie as far apart in the image as those of exchanged Gray images, but in both cameras."""
    board, half = surface(), np.mgrid[0.0 : SIZE_PX[0], 0.0 : SIZE_PX[1]][1] < SIZE_PX[1] / 2
    moved_px = np.where(half, 0.15, -0.15) * SEQUENCE.width_px
    near, far = board.copy(), board.copy()
    near[..., 0] += moved_px
    far[..., 0] -= moved_px
    far[(far[..., 0] < 0.0) | (far[..., 0] > SEQUENCE.width_px - 1)] = np.nan
    frames = {"left": recorded(ideal_frames(SEQUENCE, near), 1), "right": recorded(ideal_frames(SEQUENCE, far), 2)}
    judgement = judge_identity(frames, SEQUENCE)
    assert (judgement.verdict.passed, judgement.fault) == (None, None)
    alone = {"left": frames["left"], "right": recorded(ideal_frames(SEQUENCE, board), 2)}
    assert code(judge_identity(alone, SEQUENCE)) is FaultCode.PATTERN_WRONG, "depth is seen by both"


def test_a_camera_that_reads_one_direction_only_is_not_said_to_show_its_patterns(board: Takes) -> None:
    """Its images of the other direction may be in any order."""
    frames = {side: takes[0] for side, takes in board.items()}
    right = frames["right"].copy()
    across = SEQUENCE.axis(Direction.X)
    gray = right[list(across.gray)].astype(np.float64)
    # Stripes across the base line that nobody reads: their bits are half way.
    right[list(across.gray)] = np.rint(0.5 * (gray.max(axis=0) + gray.min(axis=0)))
    judgement = judge_identity({"left": frames["left"], "right": right}, SEQUENCE)
    assert judgement.fault is None
    assert judgement.verdict.text == "each frame of camera.left shows its pattern"
    assert judgement.verdict.numbers["right_doubt"] is None


@pytest.fixture(scope="module")
def near() -> RenderedScan:
    """A pipe's front at 345 mm, in water that keeps it from being saturated."""
    scene = Scene(object="pipe", pose=(0.0, 0.0, 370.0, 0.0, 6.0, 20.0), texture="strong", water=turbid(2.0))
    return render_scan(scene, "realistic", 5, 160, 32)


def test_in_a_near_and_saturated_picture_a_wrong_gray_image_is_found_and_no_right_one(near: RenderedScan) -> None:
    """What is clear in it are borders of the picture and of stripes: these came as WRONG PATTERN."""
    frames = {side: np.clip(8 * stack.astype(np.int64), 0, 255).astype(np.uint8) for side, stack in near.frames.items()}
    bright = frames["left"][near.sequence.bright]
    assert np.mean(bright[bright > 60] == 255) > 0.8
    assert judge_identity(frames, near.sequence).fault is None
    gray = near.sequence.axis(Direction.X).gray
    frames["left"][gray[4]] = frames["left"][gray[3]]
    assert code(judge_identity(frames, near.sequence)) is FaultCode.PATTERN_WRONG


def test_a_lamp_that_blinds_a_camera_does_not_make_it_stuck(board: Takes) -> None:
    frames = {side: takes[0].copy() for side, takes in board.items()}
    frames["left"][:, :, :120] = 255
    assert judge_identity(frames, SEQUENCE).fault is None


def lit_by_lamp(frames: NDArray[np.uint8] | NDArray[np.float64], swing_dn: float) -> Frames:
    """The same before a lamp of 3.1 Hz that adds up to twice ``swing_dn`` everywhere, frame by frame at 60 a second."""
    added = swing_dn * (1.0 + np.cos(2.0 * np.pi * 3.1 * np.arange(len(frames)) / 60.0))
    return np.asarray(np.clip(np.rint(frames + added[:, None, None]), 0, 255), np.uint8)


def black(seed: int, swing_dn: float = 0.0) -> dict[str, Frames]:
    """What cameras record of nothing, before a lamp of such changes."""
    noise = np.random.default_rng(seed).standard_normal((2, N, *SIZE_PX))
    return {side: lit_by_lamp(2.0 + 0.5 * one, swing_dn) for side, one in zip(SIDES, noise, strict=True)}


def test_a_flickering_lamp_before_an_object_that_is_too_near_makes_no_projector_dark(near: RenderedScan) -> None:
    """The mean of the frames says nothing of the projector then: a lamp of 3 Hz before a far plane was PROJECTOR DARK."""
    frames = {side: lit_by_lamp(stack, 10.0) for side, stack in near.frames.items()}
    for seen in (near.frames, frames):
        judged = judge_identity(seen, near.sequence)
        assert (judged.verdict.passed, judged.fault) == (None, None)
        assert judged.verdict.numbers["left_samples"] == 0.0, "the stripes are displaced: nothing is left to be judged"


@pytest.mark.parametrize(
    ("time_us", "expected"), [(200, None), (2_000, FaultCode.PROJECTOR_DARK), (12_000, FaultCode.PROJECTOR_DARK)]
)
def test_only_an_exposure_that_shows_lit_water_tells_a_dark_projector(time_us: int, expected: FaultCode | None) -> None:
    """0.2 ms before nothing, or into thick water, was PROJECTOR DARK: a hundredth of a grey value of veil is not seen."""
    assert code(judge_identity(black(7), SEQUENCE, exposure=Exposure(time_us))) is expected


def test_a_dark_projector_before_a_flickering_lamp_is_not_told_from_nothing_in_reach() -> None:
    """The lamp's changes are many times what lit water adds, so that its absence says nothing; the diver hears NOTHING SEEN, IS LIGHT COVERED?"""
    assert judge_identity(black(8, 1.5), SEQUENCE).fault is None
