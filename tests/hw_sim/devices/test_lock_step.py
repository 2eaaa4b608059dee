"""A recording world waits for its host: the same frames on a slow machine as on a fast one, none lost or invented."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hw_sim.rendering.render import Renderer
from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import Recorder, good, greys


def test_every_frame_shows_its_own_pattern_and_all_agree_about_time(bench: Bench) -> None:
    recorder = bench.recorder(patterns=12)
    got = recorder.record()
    pulses = [bench.board.wait_report("PULSE") for _ in range(12)]
    assert [int(report[3]) for report in pulses] == list(range(12))
    assert bench.board.wait_report("DONE")[3] == "12"
    flips_ns = np.array([flip["time_ns"] for flip in recorder.flips[2:]])
    times_ns = [np.array([int(report[5]) * 1000 for report in pulses])]
    for side in ("left", "right"):
        frames = good(got[side])
        assert [f.block_id for f in frames] == list(range(12))
        means = [float(f.image.mean()) for f in frames]
        assert means == sorted(means), "each pattern is brighter than the one before"
        assert means[-1] > 3 * means[0]
        times_ns.append(np.array([f.time_ns for f in frames]))
    sequences = [flip["sequence"] for flip in recorder.flips]
    assert np.diff(sequences).tolist() == [1] * (len(sequences) - 1), "one flip per vertical blank"
    for other in times_ns:
        assert np.ptp(np.diff(other) - np.diff(flips_ns)) < 3000, "four clocks, one second"


def test_a_slow_host_records_the_same_frames(make_bench: Callable[..., Bench]) -> None:
    def record(between: Callable[[int], None]) -> dict[str, list[Any]]:
        bench = make_bench(texture="strong", motion={"velocity_mm_s": [40.0, 0.0, 30.0]})
        return {side: good(frames) for side, frames in bench.recorder(patterns=5).record(between=between).items()}

    fast, slow = record(lambda k: None), record(lambda k: time.sleep(0.04 * (k % 3)))
    for side in ("left", "right"):
        assert len(fast[side]) == len(slow[side]) == 5
        assert all((a.image == b.image).all() for a, b in zip(fast[side], slow[side], strict=True))
        gaps_ns = (np.diff([f.time_ns for f in frames]) for frames in (fast[side], slow[side]))
        assert next(gaps_ns) == pytest.approx(next(gaps_ns), abs=16)


def test_a_host_that_does_not_read_its_cameras_is_waited_for(bench: Bench) -> None:
    recorder = bench.recorder(patterns=12)
    projector, board = recorder.projector, bench.board
    projector.show(0)
    board.ask("ARM", 12, int(board.ask("VSYNC")[0]) + 3, 500, 8000)
    for _ in range(2):
        projector.show(0)
    played = 0
    for shade in recorder.shades[:9]:
        projector.flip(shade)
        until_s = time.monotonic() + (20.0 if played < 4 else 1.0)  # of real time: the world's stands still
        while not projector.node.wait_readable(0.0) and time.monotonic() < until_s:
            time.sleep(0.01)
        if not projector.node.wait_readable(0.0):
            break
        projector.node.read(32)
        played += 1
    assert 4 <= played < 9, "nobody reads, and the world goes on"
    for side in ("left", "right"):
        assert [recorder.cameras[side].frame(1000, bench.size).block_id for _ in range(4)] == [0, 1, 2, 3]
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
    later = Recorder({"left": camera}, bench.board, projector, [0] * 3, bench.size)
    assert len(good(later.record(between=lambda k: time.sleep(0.2))["left"])) == 3


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
    live = [camera.frame(5000, bench.size) for _ in range(10)]
    real_s, world_s = time.monotonic() - start_s, (bench.wires.clock.now_ns() - start_ns) / 1e9
    assert world_s == pytest.approx(real_s, abs=0.1)
    assert [f.block_id for f in live] == list(range(1, 11)), "none is lost"
    # 10 pulses are 1 s: were every image made, it would be 3, and the view ever later.
    assert world_s < 2.0
    assert len({f.image.tobytes() for f in live}) < 8, "some are sent twice"

    shades = [projector.buffer(g) for g in greys([60, 130, 200])]
    bench.board.ask("STOP")
    bench.drain(camera)
    recorder = Recorder({"left": camera}, bench.board, projector, shades, bench.size)
    means = [float(f.image.mean()) for f in good(recorder.record()["left"])]
    assert len(means) == 3
    assert means == sorted(means)
    assert means[2] > 2 * means[0], "each its own pattern"
