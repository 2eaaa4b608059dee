"""A recording world waits for its host: the same frames on a slow machine as on a fast one, none lost or invented."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import usb.core

from hw_sim.rendering.render import Renderer
from hw_sim.wires import open as open_wires
from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import BoardHost, CardHost, Recorder, U3vHost, good, greys, stripes


def test_every_frame_shows_its_own_pattern(bench: Bench) -> None:
    recorder = bench.recorder(patterns=12)
    got = recorder.record()
    for side in ("left", "right"):
        frames = good(got[side])
        assert [f.block_id for f in frames] == list(range(12))
        means = [float(f.image.mean()) for f in frames]
        assert means == sorted(means), "each pattern is brighter than the one before"
        assert means[-1] > 3 * means[0]
    sequences = [flip["sequence"] for flip in recorder.flips]
    assert np.diff(sequences).tolist() == [1] * (len(sequences) - 1), "one flip per vertical blank"


def test_board_flips_and_frames_agree_about_time(bench: Bench) -> None:
    recorder = bench.recorder(patterns=8)
    frames = good(recorder.record()["left"])
    pulses: list[tuple[int, int]] = []
    while len(pulses) < 8:
        report = bench.board.wait_report("PULSE")
        pulses.append((int(report[3]), int(report[5])))
    assert [k for k, _ in pulses] == list(range(8))
    flips_ns = np.array([flip["time_ns"] for flip in recorder.flips[2:]])
    frames_ns = np.array([f.time_ns for f in frames])
    pulses_ns = np.array([t for _, t in pulses]) * 1000
    for other in (frames_ns, pulses_ns):
        assert np.ptp(np.diff(other) - np.diff(flips_ns)) < 3000, "three clocks, one second"
    assert bench.board.wait_report("DONE")[3] == "8"


def record_with(
    make_bench: Callable[..., Bench], between: Callable[[int], None], **options: object
) -> dict[str, list[Any]]:
    bench = make_bench(texture="strong", **options)
    got = bench.recorder(patterns=8).record(between=between)
    return {side: good(got[side]) for side in got}


def test_a_slow_host_records_the_same_frames(make_bench: Callable[..., Bench]) -> None:
    motion = {"velocity_mm_s": [40.0, 0.0, 30.0]}
    fast = record_with(make_bench, lambda k: None, motion=motion)
    slow = record_with(make_bench, lambda k: time.sleep(0.04 * (k % 3)), motion=motion)
    for side in ("left", "right"):
        assert len(fast[side]) == len(slow[side]) == 8
        for a, b in zip(fast[side], slow[side], strict=True):
            assert (a.image == b.image).all()
        assert np.diff([f.time_ns for f in fast[side]]) == pytest.approx(
            np.diff([f.time_ns for f in slow[side]]), abs=16
        )


def test_another_seed_and_the_next_sequence_have_other_noise(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    recorder = bench.recorder(patterns=3)
    first, second = (good(recorder.record()["left"]) for _ in range(2))
    assert not (first[2].image == second[2].image).all()
    assert abs(first[2].image.astype(int) - second[2].image).mean() < 5, "the same scene"


def test_a_host_that_does_not_read_its_cameras_is_waited_for(bench: Bench) -> None:
    recorder = bench.recorder(patterns=12)
    projector, board = recorder.projector, bench.board
    projector.show(0)
    at = int(board.ask("VSYNC")[0]) + 3
    board.ask("ARM", 12, at, 500, 8000)
    for _ in range(2):
        projector.show(0)
    played = 0
    for shade in recorder.shades[:9]:
        projector.flip(shade)
        until_s = time.monotonic() + 3.0  # of real time: the world's stands still
        while not projector.node.wait_readable(0.0) and time.monotonic() < until_s:
            time.sleep(0.01)
        if not projector.node.wait_readable(0.0):
            break
        projector.node.read(32)
        played += 1
    assert 4 <= played < 9, "nobody reads, and the world goes on"
    for side in ("left", "right"):
        for k in range(4):
            assert recorder.cameras[side].frame(1000, bench.size).block_id == k
    assert projector.node.wait_readable(1.0), "there is room again"


def test_patience_ends_and_comes_back_with_the_next_sequence(
    make_bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hw_sim.timing.world_thread.HOST_TIMEOUT_S", 0.4)
    bench = make_bench()
    camera, projector = bench.camera(), bench.projector()
    projector.show(0)
    bench.board.ask("ARM", 4, int(bench.board.ask("VSYNC")[0]) + 3, 500, 8000)
    start_s = time.monotonic()
    frames = [camera.frame(2000, bench.size) for _ in range(4)]
    assert time.monotonic() - start_s > 0.4
    assert [f.block_id for f in frames] == list(range(4)), "the pulses come, whether the host flips or not"
    bench.board.wait_report("DONE")
    later = Recorder({"left": camera}, bench.board, projector, [0] * 3, bench.size).record(
        between=lambda k: time.sleep(0.2)
    )
    assert len(good(later["left"])) == 3


def test_an_exposure_over_a_blank_sees_both_images(bench: Bench) -> None:
    """From 12 ms after the blank, 8 ms long: 4.667 ms of the first pattern, the rest of the second."""
    projector, camera = bench.projector(), bench.camera(exposure_us=8000)
    black, white = (projector.buffer(g) for g in greys([0, 200]))

    def mean(images: list[int]) -> float:
        recorder = Recorder({"left": camera}, bench.board, projector, images, bench.size)
        return float(good(recorder.record(delay_us=12_000)["left"])[1].image.mean())

    dark, bright = mean([black] * 4), mean([white] * 4)
    falling, rising = mean([black, white, black, black]), mean([black, black, white, white])
    share = (16.667 - 12.0) / 8.0
    assert (falling - dark) / (bright - dark) == pytest.approx(share, abs=0.04)
    assert (rising - dark) / (bright - dark) == pytest.approx(1 - share, abs=0.04)


def test_the_range_of_the_cable_is_seen_by_the_cameras(bench: Bench) -> None:
    projector, camera = bench.projector(), bench.camera()
    black = projector.buffer(greys([0])[0])

    def mean() -> float:
        recorder = Recorder({"left": camera}, bench.board, projector, [black] * 2, bench.size)
        return float(good(recorder.record()["left"])[1].image.mean())

    full = mean()
    projector.set_property("Broadcast RGB", "Automatic")
    assert mean() > full + 0.3, "black is no longer black"


def test_a_sequence_is_played_faster_than_it_happens(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(width_px=400, height_px=300, truth="realistic")
    projector = bench.projector()
    images = [projector.buffer(stripes(16 + k, k)) for k in range(24)]
    cameras = {side: bench.camera(side, exposure_us=12_000) for side in ("left", "right")}
    recorder = Recorder(cameras, bench.board, projector, images, bench.size)
    recorder.record(width_us=12_000)  # the first sequence also traces the scene
    cpu_s = []
    for _ in range(3):
        start_s = time.process_time()
        got = recorder.record(width_us=12_000)
        cpu_s.append(time.process_time() - start_s)
        assert all(len(good(got[side])) == 24 for side in got)
    # All threads together: half a second on two cores, whatever else the machine does.
    assert min(cpu_s) < 1.0


def test_in_real_time_blanks_come_whatever_the_host_does(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(pace="realtime")
    camera, projector = bench.camera(), bench.projector()
    first = projector.show(0)
    bench.board.ask("ARM", 6, int(bench.board.ask("VSYNC")[0]) + 3, 500, 8000)
    start_s, start_ns = time.monotonic(), bench.wires.clock.now_ns()
    frames = [camera.frame(2000, bench.size) for _ in range(6)]
    assert [f.block_id for f in frames] == list(range(6))
    last = projector.show(0)
    real_s, world_s = time.monotonic() - start_s, (bench.wires.clock.now_ns() - start_ns) / 1e9
    assert world_s == pytest.approx(real_s, abs=0.02)
    assert last["sequence"] - first["sequence"] >= 8, "it did not wait for flips"


def test_an_attended_world_is_real_time_between_sequences_and_waits_within_them(
    make_bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Images that take three times as long as they may: the live view skips some, a sequence none."""
    expose = Renderer.expose

    def slow(*arguments: Any) -> object:
        time.sleep(0.3)
        return expose(*arguments)

    monkeypatch.setattr(Renderer, "expose", slow)
    bench = make_bench(pace="attended")
    camera, projector = bench.camera(), bench.projector()
    bench.board.ask("LIVE", 6, 500, 8000)
    camera.frame(20_000, bench.size)  # the first one also traces the scene
    start_s, start_ns = time.monotonic(), bench.wires.clock.now_ns()
    live = [camera.frame(5000, bench.size) for _ in range(20)]
    real_s, world_s = time.monotonic() - start_s, (bench.wires.clock.now_ns() - start_ns) / 1e9
    assert world_s == pytest.approx(real_s, abs=0.1)
    assert [f.block_id for f in live] == list(range(1, 21)), "none is lost"
    # 20 pulses are 2 s: were every image made, it would be 6, and the view ever later.
    assert world_s < 4.0
    assert len({f.image.tobytes() for f in live}) < 15, "some are sent twice"

    shades = [projector.buffer(g) for g in greys([60, 130, 200])]
    recorder = Recorder({"left": camera}, bench.board, projector, shades, bench.size)
    bench.board.ask("STOP")
    while True:
        try:
            camera.frame(400, bench.size)
        except usb.core.USBTimeoutError:
            break
    means = [float(f.image.mean()) for f in good(recorder.record()["left"])]
    assert len(means) == 3
    assert means == sorted(means)
    assert means[2] > 2 * means[0], "each its own pattern"


def test_wires_make_their_own_world_and_end_it() -> None:
    with open_wires({"world": "own", "width_px": 160, "height_px": 120, "truth": "nominal"}) as wires:
        board = BoardHost("kfsim://own/board")
        head = CardHost(wires.open_card("/dev/dri/card0"), 11)
        head.set_mode(head.buffer(greys([9])[0]))
        camera = U3vHost(wires.usb_backend, "KF-CAM-R")
        assert board.ask("PING")
    with pytest.raises(OSError):
        camera.read(0, 4)
    assert head.node.wait_readable(0.05) is False
