"""Every dropped, repeated, swapped or cut frame, early and late in the sequence, ends as its named fault; the next scan works.

The shipped drivers over the simulated wires, small images, both sides in turn. No service: this is the capture's promise.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from appliance.instrument.capture.grabber import Grabber
from appliance.instrument.capture.scan import CaptureReport, ScanRecorder, ScanSettings
from appliance.instrument.capture.store import FrameStore
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.patterns import build_sequence
from drivers import rig as drivers_rig
from drivers.api import Board, CameraSettings
from hw_sim.wires import open as open_wires
from hw_sim.world import World, WorldOptions
from tests.support.rendered import pictures

N = 24
WIDTH, HEIGHT = 96, 72
PLACES = (0, 1, 10, N - 1)
CARD = "/dev/dri/card0"


@dataclass
class Bench:
    world: World
    grabbers: dict[str, Grabber]
    board: Board
    recorder: ScanRecorder
    store: FrameStore
    arrived: list[tuple[str, int]]

    def record(self, fault: str = "") -> CaptureReport:
        """Return what became of a scan in which ``fault`` happened; it is mended afterwards."""
        self.arrived.clear()
        if fault:
            self.world.fault(fault)
        report = self.recorder.record(
            build_sequence(16), self.store, lambda side, k: self.arrived.append((side, k)), lambda: None
        )
        self.world.clear_faults()
        return report

    def named(self, fault: str) -> Fault:
        """Return how ``fault`` ended a scan."""
        found = self.record(fault).fault
        assert found is not None
        return found


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with bench_of("every-frame-fault", 60.0, 2.0) as made:
        yield made


@contextmanager
def bench_of(name: str, refresh_hz: float, idle_speed: float, latency_blanks: int = 0) -> Iterator[Bench]:
    with ExitStack() as stack:
        options = WorldOptions(
            *(name, "realistic", 1, WIDTH, HEIGHT, "plane"), idle_speed=idle_speed, refresh_hz=refresh_hz, stills=True
        )
        world = stack.enter_context(World(options))
        wires = stack.enter_context(open_wires({"world": name}))
        kms = drivers_rig.OutputKind("kms")
        outputs = stack.enter_context(
            drivers_rig.open_outputs(
                drivers_rig.OutputSpec(kms, CARD, "HDMI-A-1", 1024, 768, refresh_hz),
                drivers_rig.OutputSpec(kms, CARD, "DP-1", 800, 480, refresh_hz),
                wires,
            )
        )
        projector = outputs.open_projector()
        projector.load([*pictures(build_sequence(16)), np.zeros((768, 1024), np.uint8)])
        projector.show(N)
        course = ScanSettings(refresh_hz, 12000, 500, latency_blanks)
        grabbers = {}
        for side in ("left", "right"):
            spec = drivers_rig.CameraSpec(f"camera.{side}", f"KF-CAM-{side[0].upper()}")
            camera = stack.enter_context(drivers_rig.open_camera(spec, wires))
            settings = CameraSettings(WIDTH, HEIGHT, 12000.0, 0.0)
            camera.configure(settings)
            grabbers[side] = stack.enter_context(Grabber(side, camera, wires.clock, settings, course.timeouts))
        board = stack.enter_context(drivers_rig.open_board(drivers_rig.BoardSpec(f"kfsim://{name}/board"), wires))
        store = stack.enter_context(FrameStore(N, HEIGHT, WIDTH))
        recorder = ScanRecorder(grabbers, board, projector, wires.clock, course)
        yield Bench(world, grabbers, board, recorder, store, [])


def test_a_clean_scan_has_every_frame_of_both_cameras_and_no_fault(bench: Bench) -> None:
    report = bench.record()
    assert report.fault is None
    assert sorted(bench.arrived) == sorted((side, k) for side in ("left", "right") for k in range(N))
    bright, dark = bench.store.frames("left")[:2]
    assert np.median(bright) > 100 > 20 > np.median(dark)
    assert len(report.ledger.pulses) == len(report.ledger.flips) == N


def test_a_projector_that_buffers_a_frame_is_waited_for_where_the_rig_file_knows_it() -> None:
    for latency_blanks, bright_at in ((1, 0), (0, 1)):
        with bench_of(f"latency-{latency_blanks}", 60.0, 2.0, latency_blanks) as late:
            report = late.record("projector wrong")
            assert report.fault is None, "the images alone can tell"
            assert report.ledger.as_dict()["latency_blanks"] == latency_blanks
            light = [float(np.median(frame)) for frame in late.store.frames("left")[:3]]
            assert int(np.argmax(light)) == bright_at
            assert light[bright_at + 1] < 20


def test_a_projector_of_2_hz_records_the_same_scan_and_a_lost_frame_is_still_named() -> None:
    with bench_of("slow-projector", 2.0, 20.0) as slow:
        report = slow.record()
        assert report.fault is None
        flips_ns = [flip.time_ns for flip in report.ledger.flips]
        assert np.diff(flips_ns) == pytest.approx([0.5e9] * (N - 1), rel=1e-3)
        bright, dark = slow.store.frames("left")[:2]
        assert np.median(bright) > 100 > 20 > np.median(dark)
        lost = slow.named(f"camera.right intermittent frame={N // 2}")
        assert (lost.code, lost.device) == (FaultCode.FRAME_MISSING, "camera.right")


def test_an_exposure_holds_from_the_next_scan_on_in_both_cameras(bench: Bench) -> None:
    def seen(exposure_us: float, gain_db: float) -> list[float]:
        for grabber in bench.grabbers.values():
            grabber.expose(exposure_us, gain_db)
        assert bench.record().fault is None
        return [float(np.median(bench.store.frames(side)[0])) - 2.0 for side in ("left", "right")]

    half, brighter = seen(6_000.0, 0.0), seen(6_000.0, 6.0)
    nominal = seen(12_000.0, 0.0)
    assert half == pytest.approx([0.5 * dn for dn in nominal], rel=0.03)
    assert brighter == pytest.approx([10.0**0.3 * dn for dn in half], rel=0.03)


@pytest.mark.parametrize(
    ("sentence", "codes"),
    [
        ("camera.{side} intermittent frame={k}", {FaultCode.FRAME_MISSING}), ("camera.{side} wrong how=repeat frame={k}", {FaultCode.FRAME_REPEATED}),
        ("camera.{side} wrong how=swap frame={k}", {FaultCode.FRAME_ORDER}), ("camera.{side} garbage how=truncate frame={k}", {FaultCode.FRAME_TRUNCATED}),
        ("camera.{side} garbage how=leader frame={k}", {FaultCode.FRAME_CORRUPT, FaultCode.FRAME_MISSING}),
        ("camera.{side} garbage how=trailer frame={k}", {FaultCode.FRAME_CORRUPT, FaultCode.FRAME_MISSING}),
        ("projector delayed frame={k}", {FaultCode.LATE_FLIP}), ("board wrong how=vsync frame={k}", {FaultCode.SYNC_LOST}),
        ("board intermittent frame={k}", {FaultCode.PULSE_MISSING, FaultCode.FRAME_MISSING}),
    ],
)  # fmt: skip
def test_what_is_spoilt_is_named_and_the_next_scan_works(bench: Bench, sentence: str, codes: set[FaultCode]) -> None:
    for number, k in enumerate(PLACES):
        side = ("left", "right")[number % 2]
        report = bench.record(sentence.format(side=side, k=k))
        fault = report.fault
        assert fault is not None, k
        assert fault.code in codes, (k, fault)
        assert fault.device == f"camera.{side}" or not sentence.startswith("camera")
        if "vsync" in sentence:
            assert (fault.device, f"pulse {k} was fired on vertical sync" in fault.detail) == ("board", True)
        if codes in ({FaultCode.FRAME_MISSING}, {FaultCode.LATE_FLIP}):
            assert fault.numbers["frame"] == k
        assert report.recording_s < 5.0
    assert bench.record().fault is None


@pytest.mark.parametrize("sentence", ["projector delayed frame=5", "camera.left garbage how=truncate frame=5"])
def test_a_scan_that_is_given_up_stops_the_pulses_at_once(bench: Bench, sentence: str) -> None:
    waited_s = []
    for _ in range(3):  # the fastest counts: world time runs on while a busy machine lets the host wait
        report = bench.record(sentence)
        ended_ns = bench.world.time_ns
        assert bench.world.armed is None
        assert len(report.ledger.pulses) < N
        waited_s.append((ended_ns - report.ledger.flips[-1].time_ns) / 1e9)
    assert min(waited_s) < 0.2  # neither does it wait for the pulses that no longer come


def test_the_first_pattern_follows_a_live_view_at_once(bench: Bench) -> None:
    waited_s = []
    for _ in range(3):  # the fastest counts: world time runs on while a busy machine lets the host wait
        for grabber in bench.grabbers.values():
            grabber.live()
        bench.board.live(6, 500, 12000)
        bench.world.time.sleep_s(0.5)
        assert all(grabber.latest(0) is not None for grabber in bench.grabbers.values())
        begun_ns = bench.world.time_ns
        report = bench.record()
        assert report.fault is None
        waited_s.append((report.ledger.flips[0].time_ns - begun_ns) / 1e9)
    assert min(waited_s) < 0.4


def test_one_answer_of_the_board_that_counts_a_sync_too_many_is_not_believed_and_ten_expose_no_neighbours(
    bench: Bench,
) -> None:
    assert bench.record("board wrong how=query").fault is None, "two other answers agree"
    bright, dark = bench.store.frames("left")[:2]
    assert np.median(bright) > 100 > 20 > np.median(dark)
    fault = bench.named("board wrong how=query count=10")
    assert (fault.code, fault.numbers["shift_frames"]) == (FaultCode.PROJECTOR_TIMING, 1)
    assert bench.record().fault is None


@pytest.mark.parametrize(("late_ms", "code"), [(8.3, FaultCode.PROJECTOR_TIMING), (5.0, None)])
def test_pulses_that_come_half_a_blank_after_their_patterns(
    bench: Bench, late_ms: float, code: FaultCode | None
) -> None:
    """A tap that lags a little says nothing about which pattern is lit."""
    fault = bench.record(f"board delayed amount={late_ms} count={N}").fault
    assert (fault and fault.code) == code


def test_a_laser_that_stays_on_forbids_the_scan_and_a_camera_that_is_unplugged_in_it_ends_it(bench: Bench) -> None:
    assert bench.named("laser.left stuck").code is FaultCode.LASER_ON
    assert not bench.arrived
    report = bench.record("camera.right off frame=9")
    assert report.fault is not None
    assert (report.fault.code, report.fault.device) == (FaultCode.CAMERA_LOST, "camera.right")
    assert report.recording_s < 3.0
