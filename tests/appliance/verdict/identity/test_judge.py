"""Every frame of a scan that is not the pattern it should be is found and named, and no good scan is accused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence, build_sequence
from appliance.scan.fault import FaultCode
from appliance.scan.noise import TYPICAL
from appliance.scan.sides import SIDES
from appliance.scan.verdict import Judgement
from appliance.verdict.identity.counts import follow
from appliance.verdict.identity.evidence import LineEvidence, Witness
from appliance.verdict.identity.explain import Explanation, What
from appliance.verdict.identity.judge import _may_be_motion, judge_identity
from appliance.verdict.identity.lines import take_lines
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from hw_sim.water.medium import Water
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


def surface(part: float = 1.0, at: float = 0.0) -> NDArray[np.float64]:
    """Pattern coordinates of a board that bends a little and fills ``part`` of the field from ``at`` on; NaN beside it."""
    v, u = np.mgrid[0.0 : SIZE_PX[0], 0.0 : SIZE_PX[1]]
    p = 0.64 * u + 0.04 * v + 2.0 * np.sin(u / 45.0) + 1.0
    q = 0.63 * v + 0.01 * u + 2.0
    inside = (abs(u / SIZE_PX[1] - at - part / 2) <= part / 2) & (abs(v / SIZE_PX[0] - at - part / 2) <= part / 2)
    return np.where(inside[..., None], np.stack([p, q], -1), np.nan)


def recorded(ideal: NDArray[np.float64], seed: int, light: float = 1.0) -> Frames:
    """As a camera records it: photon and read noise, 2 DN of black."""
    mean = 2.0 + light * (ideal - 3.0)
    noise = np.random.default_rng(seed).standard_normal(mean.shape) * np.sqrt(READ_DN**2 + mean * DN_PER_E)
    return np.clip(np.rint(mean + noise), 0, 255).astype(np.uint8)


def scan(ideal: NDArray[np.float64], light: float = 1.0) -> dict[str, Frames]:
    return {side: recorded(ideal, seed, light) for seed, side in enumerate(("left", "right"))}


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
    assert judgement.verdict.passed is True
    assert judgement.fault is None
    assert (judgement.verdict.numbers["doubt"] or 1.0) < 0.3


def test_every_swap_of_two_frames_is_found(board: Takes) -> None:
    witness = Witness(take_lines(board["left"][0], SEQUENCE, TYPICAL), SEQUENCE, TYPICAL)
    assert not witness.evidence(np.arange(N)).contradicted
    pairs = combinations(range(N), 2)
    missed = [pair for pair in pairs if not witness.evidence(np.array(swapped(*pair))).contradicted]
    assert missed == []


def assert_named(board: Takes, pair: tuple[int, int]) -> None:
    judgement = with_order(board, swapped(*pair))
    assert code(judgement) is FaultCode.PATTERN_WRONG, pair
    said = f"camera.left shows the patterns of frames {pair[0]} and {pair[1]} in each other's place"
    assert said in judgement.verdict.text


def test_swapped_neighbours_are_named(board: Takes) -> None:
    for i in range(N - 1):
        assert_named(board, (i, i + 1))


TURNS = {
    "mirrored left to right": lambda frames: frames[:, :, ::-1],
    "mirrored top to bottom": lambda frames: frames[:, ::-1],
    "turned by 180°": lambda frames: frames[:, ::-1, ::-1],
}


@pytest.mark.parametrize("how", TURNS)
@pytest.mark.parametrize("side", SIDES)
def test_a_camera_that_turns_its_picture_is_named_with_the_way_it_does(board: Takes, how: str, side: str) -> None:
    frames = {name: takes[0] for name, takes in board.items()}
    frames[side] = np.ascontiguousarray(TURNS[how](frames[side]))
    judgement = judge_identity(frames, SEQUENCE)
    assert code(judgement) is FaultCode.PICTURE_MIRRORED
    assert judgement.fault is not None
    assert judgement.fault.device == f"camera.{side}"
    assert judgement.fault.detail.startswith(f"camera.{side} sees the picture {how}: switch its ReverseX")


@pytest.mark.parametrize("how", TURNS)
def test_what_both_cameras_see_turned_is_the_projectors_doing(board: Takes, how: str) -> None:
    frames = {name: np.ascontiguousarray(TURNS[how](takes[0])) for name, takes in board.items()}
    judgement = judge_identity(frames, SEQUENCE)
    assert judgement.fault is not None
    assert (judgement.fault.code, judgement.fault.device) == (FaultCode.PICTURE_MIRRORED, "projector")
    assert how in judgement.fault.detail
    assert "rear projection" in judgement.fault.detail


def test_a_wrong_order_of_a_mirrored_picture_is_no_mere_mirror(board: Takes) -> None:
    frames = {name: takes[0] for name, takes in board.items()}
    frames["left"] = np.ascontiguousarray(frames["left"][swapped(3, 4), :, ::-1])
    assert code(judge_identity(frames, SEQUENCE)) is FaultCode.PATTERN_WRONG


@pytest.mark.long
def test_any_two_swapped_frames_are_named(board: Takes) -> None:
    for pair in combinations(range(N), 2):
        assert_named(board, pair)


def test_every_repeat_is_found_and_named(board: Takes) -> None:
    for k in range(1, N):
        order = [*range(k), k - 1, *range(k + 1, N)]
        judgement = with_order(board, order)
        assert code(judgement) is FaultCode.PATTERN_WRONG, k
        assert judgement.verdict.numbers["frame"] == k


def test_every_repeat_with_all_after_it_late_is_found_and_named(board: Takes) -> None:
    for k in range(1, N):
        judgement = with_order(board, [*range(k), *range(k - 1, N - 1)])
        assert code(judgement) is FaultCode.PATTERN_WRONG, k
        assert judgement.verdict.numbers["frame"] == k


@pytest.mark.parametrize("before", [1, N - 1])
def test_a_projector_one_frame_late_or_early(board: Takes, before: int) -> None:
    late = with_order(board, [before, *range(N - 1)], "left right")
    assert code(late) is FaultCode.PROJECTOR_TIMING
    assert late.fault is not None
    assert late.fault.numbers["shift_frames"] == 1
    early = with_order(board, [*range(1, N), 1], "left right")
    assert code(early) is FaultCode.PROJECTOR_TIMING
    assert early.fault is not None
    assert early.fault.numbers["shift_frames"] == -1


def test_one_camera_a_frame_behind_the_other(board: Takes) -> None:
    judgement = with_order(board, [1, *range(N - 1)])
    assert code(judgement) is FaultCode.PATTERN_WRONG
    assert judgement.fault is not None
    assert judgement.fault.device == "camera.left"
    assert judgement.fault.numbers["shift_frames"] == 1


def test_a_frozen_camera_is_named_from_any_frame_on(board: Takes) -> None:
    for k in range(N - 2):
        judgement = with_order(board, [*range(k), *[k] * (N - k)], "right")
        assert code(judgement) is FaultCode.CAMERA_STUCK, k
        assert judgement.fault is not None
        assert (judgement.fault.device, judgement.fault.numbers["frame"]) == ("camera.right", k)
    last = with_order(board, [*range(N - 2), N - 2, N - 2], "right")
    assert code(last) is FaultCode.PATTERN_WRONG  # two of one image are a repeat


@pytest.mark.parametrize("k", [0, 5, N - 4])
def test_both_cameras_frozen_to_the_bit_are_no_projector(board: Takes, k: int) -> None:
    frames = {side: takes[0][[*range(k), *[k] * (N - k)]] for side, takes in board.items()}
    assert code(judge_identity(frames, SEQUENCE)) is FaultCode.CAMERA_STUCK


def test_a_projector_that_stays_on_a_pattern(board: Takes) -> None:
    judgement = with_order(board, [*range(7), *[7] * (N - 7)], "left right")
    assert code(judgement) is FaultCode.PATTERN_WRONG
    assert judgement.fault is not None
    assert (judgement.fault.device, judgement.fault.numbers["frame"]) == ("projector", 7)


def test_a_dark_projector_before_something_to_see(ideal: NDArray[np.float64]) -> None:
    ambient = np.broadcast_to(3.0 + 0.1 * (ideal[0] - 3.0), ideal.shape)
    judgement = judge_identity(scan(ambient), SEQUENCE)
    assert code(judgement) is FaultCode.PROJECTOR_DARK


def test_open_water_is_nothing_to_judge() -> None:
    veil = np.array([3.0 + 2.0 * pattern.codes().mean() / 247.0 for pattern in SEQUENCE.patterns])
    judgement = judge_identity(scan(np.broadcast_to(veil[:, None, None], (N, *SIZE_PX))), SEQUENCE)
    assert judgement.verdict.passed is None
    assert judgement.fault is None


def shown_apart(ideal: NDArray[np.float64], pq: NDArray[np.float64], i: int, j: int) -> float:
    """Share of the surface on which two frames differ."""
    seen = np.isfinite(pq).all(-1)
    return float((abs(ideal[i] - ideal[j])[seen] > 40.0).mean())


def test_what_a_small_thing_hides() -> None:
    """On a third of the field coarse stripes are missing: of all pairs, those found are those that differ there."""
    pq = surface(0.36, 0.3)
    ideal = ideal_frames(SEQUENCE, pq)
    frames = recorded(ideal, 3)
    witness = Witness(take_lines(frames, SEQUENCE, TYPICAL), SEQUENCE, TYPICAL)
    assert witness.evidence(np.arange(N)).judged
    apart = {pair: shown_apart(ideal, pq, *pair) for pair in combinations(range(N), 2)}
    found = {pair: witness.evidence(np.array(swapped(*pair))).contradicted for pair in apart}
    invisible = [pair for pair, share in apart.items() if share == 0.0]
    assert not any(found[pair] for pair in invisible)
    missed = [(pair, share) for pair, share in apart.items() if share > 0.05 and not found[pair]]
    assert missed == []


def test_a_wrong_number_of_frames_is_said(board: Takes) -> None:
    with pytest.raises(ValueError, match="17 frames of camera left for a sequence of 18"):
        judge_identity({side: takes[0, :-1] for side, takes in board.items()}, SEQUENCE)


def test_all_periods_of_the_instrument() -> None:
    for period_px in (16, 32, 64):
        sequence: PatternSequence = build_sequence(period_px)
        v, u = np.mgrid[0.0:300.0, 0.0:400.0]
        ideal = ideal_frames(sequence, np.stack([2.5 * u + 0.1 * v + 3.0, 2.5 * v + 2.0], -1))
        good = scan(ideal)
        assert judge_identity(good, sequence).verdict.passed is True
        wrong = list(range(len(sequence)))
        k = sequence.axis(sequence.patterns[2].direction).gray[-1]
        wrong[k - 1 : k + 1] = k, k - 1
        good["right"] = good["right"][wrong]
        judgement = judge_identity(good, sequence)
        assert judgement.fault is not None
        assert (judgement.fault.numbers["frame"], judgement.fault.device) == (k - 1, "camera.right")


def test_a_wrong_scan_compiles_nothing_that_an_empty_one_has_not(board: Takes) -> None:
    """What the installation compiles is what an empty scan runs; compiling takes seconds, when a diver waits."""
    judge_identity({side: np.zeros_like(takes[0]) for side, takes in board.items()}, SEQUENCE)
    before = list(follow.signatures)
    with_order(board, swapped(4, 9))
    with_order(board, [1, *range(N - 1)], "left right")
    assert follow.signatures == before


HANDS = Motion(velocity_mm_s=(12.0, -9.0, 8.0), rotation_deg_s=(0.5, -1.0, 0.5))
SCENES = {
    "dark": (Scene("pipe", texture="strong", ambient=0.2), 0.0012, 0.0),
    "turbid": (Scene("shell", water=Water(attenuation_per_m=1.2, backscatter=0.1, blur_px_per_m=3.0)), 0.008, 0.0),
    "milk": (Scene("plane", water=Water(attenuation_per_m=2.5, backscatter=0.6)), 0.012, 0.0),
    "moving in flicker": (
        Scene("frustum", ambient=0.1, motion=HANDS, daylight=Daylight(flicker_depth=0.5, flicker_hz=100.0)),
        0.008,
        1.0 / 60.0,
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_what_the_simulated_cameras_see(name: str) -> None:
    """Good scans of hard scenes pass; each frame that is exchanged for the next is found in them."""
    scene, exposure_s, frame_s = SCENES[name]
    seen = render_scan(scene, "realistic", 10_501, 320, 32, exposure_s, frame_s=frame_s)
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


def test_simulated_open_water_is_nothing_to_judge() -> None:
    far = Scene("plane", pose=(0.0, 0.0, 20_000.0, 0.0, 0.0, 0.0), water=Water(backscatter=0.03))
    seen = render_scan(far, "realistic", 10_502, 320, 64)
    judgement = judge_identity(seen.frames, seen.sequence)
    assert (judgement.verdict.passed, judgement.fault) == (None, None)


def test_what_rushes_by_is_left_to_the_judge_of_motion() -> None:
    scene = Scene("pipe", texture="strong", motion=Motion(velocity_mm_s=(80.0, -40.0, 30.0)))
    seen = render_scan(scene, "realistic", 10_901, 200, 32, 0.006, frame_s=1.0 / 60.0)
    judgement = judge_identity(seen.frames, seen.sequence)
    assert (judgement.verdict.passed, judgement.fault) == (None, None)
    late = {side: frames[[1, *range(len(frames) - 1)]] for side, frames in seen.frames.items()}
    assert judge_identity(late, seen.sequence).verdict.passed is not True


@pytest.fixture(scope="module")
def printed_and_moving() -> RenderedScan:
    scene = Scene("plane", texture="checker", motion=Motion(velocity_mm_s=(8.0, -8.0, 5.0)))
    return render_scan(scene, "realistic", 10_902, 200, 32, 0.01, frame_s=1.0 / 60.0)


def test_printed_squares_that_move_are_no_wrong_pattern(printed_and_moving: RenderedScan) -> None:
    assert judge_identity(printed_and_moving.frames, printed_and_moving.sequence).verdict.passed


@pytest.mark.parametrize("pair", [(8, 12), (3, 17), (7, 14)])
def test_exchanged_frames_are_found_before_printed_squares_that_move(
    printed_and_moving: RenderedScan, pair: tuple[int, int]
) -> None:
    """Every fourth sample had another mean in X than in Y, so that an order which left next to no doubt was taken for movement."""
    seen = printed_and_moving
    order = np.arange(len(seen.sequence))
    order[list(pair)] = order[list(reversed(pair))]
    judgement = judge_identity({**seen.frames, "left": seen.frames["left"][order]}, seen.sequence)
    assert judgement.fault is not None
    assert judgement.fault.code is FaultCode.PATTERN_WRONG
    assert judgement.fault.numbers["frame"] == pair[0]


def test_what_spoils_nearly_all_tests_is_movement_only_where_a_third_of_all_moves() -> None:
    """Hands at 30 mm/s in flickering light let two thirds of all exchanged frames of a checkered thing pass unseen."""
    many = LineEvidence({f"doubt {k}": 1.4 for k in range(5)}, {}, 5000, 4000, 100)
    few = replace(many, doubts={"forward y": 1.4, "phase y": 0.8})
    unexplained = Explanation(What.UNEXPLAINED, 0, moved=0.3)
    assert not _may_be_motion(unexplained, many)
    assert _may_be_motion(unexplained, few)
    assert _may_be_motion(replace(unexplained, moved=0.4), many)


@pytest.mark.parametrize("fringe", [0.24, 0.18])
def test_an_x_sine_in_the_place_of_a_y_sine_is_found_where_the_water_outshines_the_fringes(
    ideal: NDArray[np.float64], fringe: float
) -> None:
    """Weak fringes were looked for with the steps in question: those samples were left at which the wrong one fits."""
    lit = ideal.reshape(len(ideal), -1).mean(axis=1) / ideal.max()
    water = 200.0 * (1.0 - fringe) * lit / lit[SEQUENCE.bright]
    frames = recorded(3.0 + fringe * (ideal - 3.0) + water[:, None, None], 5)
    witness = Witness(take_lines(frames, SEQUENCE, TYPICAL), SEQUENCE, TYPICAL)

    def opposite(order: NDArray[np.int64]) -> float:
        return max(doubt for name, doubt in witness.evidence(order).doubts.items() if name.startswith("opposite"))

    assert opposite(np.arange(N)) < 0.5
    of_x, of_y = (SEQUENCE.axis(direction).sine for direction in Direction)
    missed = [pair for pair in zip(of_x, of_y, strict=True) if opposite(np.array(swapped(*pair))) < 1.0]
    assert missed == []


@pytest.mark.parametrize("contrast", [0.3, 0.15])
def test_a_coarse_stripe_in_the_place_of_a_soft_sine_is_not_its_opposite(
    ideal: NDArray[np.float64], contrast: float
) -> None:
    """Many times as strong as the fringes, it hid itself: it spoilt what all pairs were compared with."""
    sines = [k for direction in Direction for k in SEQUENCE.axis(direction).sine]
    soft, mean = ideal.copy(), ideal[sines].mean(axis=0)
    soft[sines] = mean + contrast * (ideal[sines] - mean)

    def opposite(order: Sequence[int]) -> float:
        return max(doubt for name, doubt in doubts(soft, order).items() if name.startswith("opposite"))

    assert opposite(range(N)) < 0.1
    axes = [SEQUENCE.axis(direction) for direction in Direction]
    assert [(k, axis) for axis in axes for k in axis.sine if opposite(swapped(axis.gray[0], k)) < 1.0] == []


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
    order = swapped(coarse, finer)
    frames = {"left": recorded(ideal, 1)[order], "right": recorded(ideal, 2)}
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


def test_a_bright_frame_exchanged_for_one_that_is_dark_on_a_fourteenth_is_found() -> None:
    """Less than a twelfth was taken for what moves past; but nothing that moves leaves a frame that is right everywhere."""
    down = surface()[..., 1]
    image = SEQUENCE.axis(Direction.Y).gray[1]
    # It is bright from a third of the field on.
    ideal = seen_where((down > 27.0) & (down < 94.0))
    dark = np.mean((down > 27.0) & (down < 32.0)) / np.mean((down > 27.0) & (down < 94.0))
    assert 0.07 < dark < 0.08
    assert doubts(ideal, range(N))["bright"] < 0.1
    assert doubts(ideal, swapped(SEQUENCE.bright, image))["bright"] > 1.0


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
    assert judgement.verdict.text == "each frame of camera.left is its pattern"
    assert judgement.verdict.numbers["right_doubt"] is None
