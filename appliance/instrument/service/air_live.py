"""Recording views of a board in air with the running instrument, each judged at once.

A take is a short sequence of one constant pattern, recorded like a scan: both cameras are fired by the same pulses, and
the ledger is audited. A view is kept if the board rested, both cameras see it, and its position is new.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import silent
from appliance.calibrate import BoardView, NoBoard, ViewFolder, coverage, find_boards, mean_of, view_of
from appliance.instrument.capture.grabber import Grabber
from appliance.instrument.capture.scan import ScanRecorder, ScanSettings
from appliance.instrument.capture.store import FrameStore
from appliance.instrument.service.devices import Devices, DeviceSupervisor
from appliance.measure import SIDES, Direction, Fault, Kind, Pattern
from appliance.store import Rig, hold_lock
from drivers import rig as drivers_rig
from drivers.api import Board, Clock, DeviceError, Projector, Wires

Image = NDArray[np.uint8]

PICTURES = 4
"""Images of each camera in a take.

Their mean has half the noise, and between first and last (50 ms) a board shows its motion.
"""
OPEN_TIMEOUT_S = 20.0
POLL_S = 0.05
BETWEEN_TAKES_S = 0.3
MOST_FAULTS = 5
"""Largest number of consecutive faults; beyond, the devices are to blame."""


class LiveError(Exception):
    """No more views can be recorded; the text has reason and remedy. Earlier views are kept."""


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Options for recording boards."""

    views: int = 20
    projector_light: bool = True
    """True if the projector illuminates the board, not the room."""
    exposure_ms: float | None = None
    """``None``: the rig file's."""
    patience_s: float = 300.0
    """Longest time without a new view."""


def record_views(rig: Rig, target: ViewFolder, options: LiveOptions, say: Callable[[str], None]) -> int:
    """Record views into ``target`` up to the requested number; return how many are new.

    Earlier views count. ``say`` is called for every view, with the board's faults and the missing regions. Raises
    LiveError, DeviceError, StorageError.
    """
    if options.exposure_ms is not None:
        left, right = (replace(c, exposure_ms=options.exposure_ms) for c in (rig.camera.left, rig.camera.right))
        rig = replace(rig, camera=replace(rig.camera, left=left, right=right))
    size_px = (rig.camera.left.width_px, rig.camera.left.height_px)
    views = _stored_views(target, size_px)
    if views:
        say(f"{len(views)} views exist already")
    new = 0
    with hold_lock(rig.storage.root), ExitStack() as stack:
        status = stack.enter_context(_status(rig.storage.root))
        wires = stack.enter_context(drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options))
        take = stack.enter_context(_takes(rig, wires, options.projector_light))
        clock, last_message, faults = wires.clock, "", 0
        last_ns = clock.now_ns()
        while len(views) < options.views:
            # Since the last new view, not since the start: a complete recording may take an hour.
            if clock.now_ns() - last_ns > options.patience_s * 1e9:
                raise LiveError(
                    f"no new view in {options.patience_s:g} s ({last_message or 'no board'}); start again to continue"
                )
            name = target.next_name()
            pictures = take()
            if isinstance(pictures, Fault):
                faults += 1
                # A single fault (a late flip, a lost frame) does no harm here: the next take follows at once.
                if faults > MOST_FAULTS:
                    raise LiveError(f"{faults} recordings in a row failed: {pictures.detail}; check the devices")
                continue
            faults = 0
            view = view_of(name, *pictures, views, target.design)
            if isinstance(view, NoBoard):
                # Every take is judged, but the last message is not repeated.
                if _without_name(view.reason, name) != last_message:
                    last_message = _without_name(view.reason, name)
                    say(last_message)
                clock.sleep_s(BETWEEN_TAKES_S)
                continue
            # Saved before it counts: after switching off now, the next call goes on with this view.
            target.save(name, *(mean_of(p) for p in pictures))
            views.append(view)
            new, last_message, last_ns = new + 1, "", clock.now_ns()
            missing = coverage(views, *size_px).missing
            say(
                f"view {name}: {len(view.corners_mm)} corners ({len(views)} of {options.views}); "
                f"{'; '.join(missing) or 'all regions seen'}"
            )
            status(f"VIEW_{name}")
    return new


def _stored_views(target: ViewFolder, size_px: tuple[int, int]) -> list[BoardView]:
    if not any(target.folder.glob("*/left.png")):
        return []
    boards = find_boards(target.folder, target.design, size_px, silent)
    return list(boards.views)


def _without_name(reason: str, name: str) -> str:
    return reason.removeprefix(f"{name}: ")


@contextmanager
def _takes(rig: Rig, wires: Wires, is_lit: bool) -> Iterator[Callable[[], tuple[Image, Image] | Fault]]:
    """Yield a function that takes PICTURES images with each camera, (n, h, w), or returns a fault."""
    kind = Kind.BRIGHT if is_lit else Kind.DARK
    pattern = Pattern(kind, Direction.X, 0, rig.scan.period_px, rig.projector.width_px)
    shown = np.ascontiguousarray(
        np.broadcast_to(pattern.codes(), (rig.projector.height_px, rig.projector.width_px)), np.uint8
    )

    def load(projector: Projector) -> None:
        # In place of the dark picture after the patterns: the light stays on between two takes, to place the board.
        projector.load([shown] * (PICTURES + 1))
        projector.show(PICTURES)

    settings = ScanSettings(
        rig.projector.refresh_hz,
        int(1000.0 * rig.camera.left.exposure_ms),
        rig.board.trigger_delay_us,
        rig.projector.latency_blanks,
    )
    left = rig.camera.left
    with FrameStore(PICTURES, left.height_px, left.width_px) as store, Devices(rig, wires, load) as devices:
        grabbers, board, projector = open_devices(devices, wires.clock)
        recorder = ScanRecorder(grabbers, board, projector, wires.clock, settings)

        def take() -> tuple[Image, Image] | Fault:
            report = recorder.record((pattern,) * PICTURES, store, lambda _side, _index: None, lambda: None)
            if report.fault is not None:
                return report.fault
            # Copied, since the next take overwrites the store.
            return store.frames("left").copy(), store.frames("right").copy()

        yield take


def open_devices(devices: Devices, clock: Clock) -> tuple[dict[str, Grabber], Board, Projector]:
    """Return cameras, board and projector, once all are open. Raises DeviceError for a missing one."""
    supervisors: list[DeviceSupervisor[Any]] = [*devices.cameras.values(), devices.board, devices.projector]
    end_ns = clock.now_ns() + int(OPEN_TIMEOUT_S * 1e9)
    reason = "does not answer"
    while True:
        for supervisor in supervisors:
            change = supervisor.poll()
            reason = getattr(change, "reason", reason)
        # Keys and display are not needed in air.
        grabbers = {side: k.value for side, k in devices.cameras.items() if k.value is not None}
        board, projector = devices.board.value, devices.projector.value
        if len(grabbers) == len(SIDES) and board is not None and projector is not None:
            return grabbers, board, projector
        if clock.now_ns() > end_ns:
            lost = ", ".join(supervisor.device.value for supervisor in supervisors if supervisor.value is None)
            raise DeviceError(lost, reason, "Check the connectors, or run `kingfisher check`")
        clock.sleep_s(POLL_S)


@contextmanager
def _status(root: Path) -> Iterator[Callable[[str], None]]:
    """Yield a function that writes ``run/status.json``; remove the file at the end.

    ``docs/protocols/status.md`` describes it.
    """
    path = root / "run" / "status.json"

    def write(result: str | None) -> None:
        calibration = {"step": "AIR", "busy": False, "result": result}
        draft = path.with_name(f".{path.name}.draft")
        with suppress(OSError):
            draft.write_text(json.dumps({"state": "CALIBRATE", "alerts": [], "calibration": calibration}) + "\n")
            draft.replace(path)

    write(None)
    try:
        yield write
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
