"""View models: one frozen value per screen, complete in itself, in physical units.

A view contains facts, without positions, colours or text. ``None`` is "not known" and is drawn as a dash, never as
zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate import Session, Step
from appliance.instrument.machine.alerts import Alert
from appliance.instrument.machine.leading import GuidanceText, OverlapText
from appliance.instrument.machine.states import Calibrating, State
from appliance.instrument.machine.words import Label, Text
from appliance.instrument.ranging.reach import Marks, Reach
from appliance.measure import STANDARD, Grade, WorkingVolume
from drivers.api import Key

KeyLabels = Mapping[Key, Label]
"""Present label of each key. A key without a label has none drawn."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Base of all views: alerts, the most severe first, and the labels of the keys."""

    alerts: tuple[Alert, ...] = ()
    keys: KeyLabels = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DeviceLine:
    """One device of the self-test, named as in the rig file.

    ``detail`` is one short line, or empty; of an alert its remedy.
    """

    device: str
    works: bool | None
    """``None``: not known yet."""
    detail: Alert | Label = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SelfTestView(View):
    """Each device, and storage, calibration and worker, with its result, if known. Up to nine lines fit."""

    devices: tuple[DeviceLine, ...]
    version: str
    opened: bool = True
    """False while devices are being opened for the first time."""
    finished: bool = False
    passed: bool = False
    """True if every line is OK; valid once ``finished``. A failed device need not forbid a scan."""


@dataclass(frozen=True, slots=True)
class Gauge:
    """Distance and tilt of the object, from the laser dots, and the advice."""

    distance_mm: float | None
    tilt_deg: float | None
    """Positive where the right side of the surface is farther away."""
    word: Reach
    volume: WorkingVolume = STANDARD
    """Working volume of the housing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AimView(View):
    """Live images while the diver aims. An image is (h, w) uint8; ``None`` is a camera without one."""

    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scans_taken: int
    scans_left: int | None
    temperature_c: float | None
    exposure: str | None = None
    """Exposure of the next scan, with its unit; ``None``: not shown."""
    gauge: Gauge | None = None
    """Reading of the laser dots; ``None`` while the lasers are off."""
    marks: Marks | None = None
    """Positions where the laser dots will appear; ``None``: no marks are drawn."""
    water: Text | None = None
    """Name of the water that the refractive index is computed for."""
    overlap: OverlapText | None = None
    """Text about the overlap of the latest scan with the one before; ``None``: none."""
    guidance: GuidanceText | None = None
    """Guidance to the next view, in place of ``overlap``; ``None``: none."""
    object: int | None = None
    """Number of the object that scans belong to; ``None``: of none."""
    scan_allowed: bool = True
    """False draws the label of SCAN dim; the reason is an alert."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgressView(View):
    """A scan on its way: ARMED (dark), CAPTURE, or CHECK and RECONSTRUCT, in which the diver may move.

    That of CAPTURE is drawn once, before the first pattern; no other is drawn until the last one.
    """

    state: State

    @property
    def computes(self) -> bool:
        """True during computation, whose duration is not known."""
        return self.state not in (State.ARMED, State.CAPTURE)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReviewView(View):
    """A scan and its grade. The coarse cloud comes first; the full one replaces it in a later view.

    ``points_mm`` is (n, 3) float32 in the left camera frame, ``values`` (n,) float32 their distance in mm, shown as
    colours. The arrays must not change while they are shown; the same memory in the next view is not copied again. No
    points: (0, 3), (0,).
    """

    points_mm: NDArray[np.float32]
    values: NDArray[np.float32]
    coarse: bool
    grade: Grade
    points: int
    coverage_percent: float | None
    noise_mm: float | None
    distance_mm: float | None
    duration_s: float | None
    """Time in seconds from the key press to this picture; ``None``: not known."""
    lengths_doubtful: bool = False
    """True if lengths are unreliable, which the grade then mentions."""
    overlap: OverlapText | None = None
    """Text about the overlap with the scan before; ``None``: none."""
    next_scan: str | None = None
    """Exposure of the next scan, with its unit, if it differs from that of this one."""
    turn_steps: int = 0
    """Number of steps by which the diver turned the cloud to the right."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SavingView(View):
    """A scan on its way to the disk. ``saved`` is a promise: set it after the last fsync, not before."""

    scan_id: str
    saved: bool


@dataclass(frozen=True, slots=True)
class MenuRow:
    """One line of a menu, with its present ``value``."""

    text: Text
    value: Label = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MenuView(View):
    """A page of the menu. Any number of rows: those around the selected one are shown."""

    title: Text
    rows: tuple[MenuRow, ...]
    selected: int
    changing: bool = False
    """True while the value of the selected row is being changed."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredScan:
    """One scan as the gallery shows it. Unreadable values of a damaged scan are ``None``."""

    scan_id: str
    damaged: bool = False
    preview: NDArray[np.uint8] | None = None
    """(h, w, 3) uint8 RGB as it was stored; it must not change while it is shown."""
    grade: Grade | None = None
    corrected: bool = False
    """True if its motion was compensated."""
    lengths_doubtful: bool = False
    points: int | None = None
    coverage_percent: float | None = None
    noise_mm: float | None = None
    distance_mm: float | None = None
    captured_at: str | None = None
    """Wall time of the capture; ``None`` if the clock was unreliable."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GalleryView(View):
    """One scan on the disk, ``index`` of ``count``, the newest first, from 0; ``scan`` ``None``: no scans."""

    scan: StoredScan | None = None
    index: int = 0
    count: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrateView(View):
    """One step of the calibration: instruction, live images, and result of the latest recording."""

    position: Calibrating
    session: Session
    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scan_allowed: bool = True
    """False draws the label of SCAN dim, as in ``AimView``; only at the steps that record."""
    gauge: Gauge | None = None
    """Reading of the laser dots, drawn as in ``AimView``, and so are the marks."""
    marks: Marks | None = None
    volume: WorkingVolume = STANDARD
    """Working volume of the housing, for the distances of planes."""

    @property
    def step(self) -> Step:
        """The current step."""
        return self.position.step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoolingView(View):
    """Too hot to shine: dark until ``temperature_c`` has fallen to ``limit_c``."""

    temperature_c: float | None
    limit_c: float
    remaining_s: float | None
    """Estimated time in seconds until then; ``None``: not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SafeView(View):
    """No light any more: ``alert`` has cause and remedy. ``saved``: every scan is durable."""

    alert: Alert
    saved: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShutdownView(View):
    """The instrument is switching off. ``reason``: the alert that forced it, ``None`` if the diver did."""

    reason: Alert | None = None
    saving: bool = False
    """True while a save is being finished."""


AnyView = (
    SelfTestView
    | AimView
    | ProgressView
    | ReviewView
    | SavingView
    | MenuView
    | GalleryView
    | CalibrateView
    | CoolingView
    | SafeView
    | ShutdownView
)
