"""Without a process that reconstructs, the instrument starts all the same, says so, and tries again."""

from __future__ import annotations

from pathlib import Path

from appliance.calibration.design import Design, design_calibration
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.machine import events as on
from appliance.machine.states import Part
from appliance.optics.water import Water
from appliance.patterns.sequence import build_sequence
from appliance.scan.fault import FaultCode
from appliance.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.storage.library import Library
from appliance.worker.order import WorkLimits
from drivers.native import MonotonicClock
from drivers.wall_clock import KernelCalendar


def events_until_settled(scans: ScanController, timeout_s: float = 60.0) -> list[on.Event]:
    clock = MonotonicClock()
    found: list[on.Event] = []
    end_ns = clock.now_ns() + int(timeout_s * 1e9)
    while not scans.worker_settled and clock.now_ns() < end_ns:
        found += [
            event for event in scans.poll() if not isinstance(event, on.PartBusy)
        ]  # how long it takes is the host's
        clock.sleep_s(0.01)
    return found


def test_a_worker_that_cannot_live_is_a_condition_and_no_endless_boot(tmp_path: Path) -> None:
    rig = simulated(load_rig(default_sim_rig()), SimOptions(root=tmp_path, size="400x300"))
    calibration = design_calibration(
        Design(11.5, 18.0, 230.0, 12.41, 30.0, 5.0, 1.77), "KF-TEST", 400, 300, Water(20.0, 0.0, 530.0)
    )
    library = Library(tmp_path)
    library.prepare()
    for memory_mb, expected in ((20.0, on.ConditionRaised), (2000.0, on.ConditionCleared)):
        limits = WorkLimits(memory_mb=memory_mb, start_memory_mb=memory_mb)
        with ScanController(
            rig,
            MeasuringSetup(calibration, build_sequence(16)),
            ScanStorage(library),
            MonotonicClock(),
            KernelCalendar(),
            limits,
        ) as scans:
            event, told = events_until_settled(scans)
            assert isinstance(event, expected)
            assert isinstance(told, on.PartTested)
            assert (told.part, told.passed) == (Part.WORKER, expected is on.ConditionCleared), (
                "the self-test hears of it"
            )
            fault = event.fault if isinstance(event, on.ConditionRaised) else event
            assert fault.code is FaultCode.RECONSTRUCTION_FAILED
            assert scans.worker_settled
