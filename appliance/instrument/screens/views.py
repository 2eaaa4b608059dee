"""Owns what a screen can show: one frozen value per screen, complete in itself, in physical units.

A view says what is so; it holds no position, no colour and no words of its own. ``None`` is "not known" and is drawn
as a dash, never as zero.
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
"""The present meaning of each key. A key without a label has none drawn."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Base of all views: alerts, the gravest first, and the meaning of the keys."""

    alerts: tuple[Alert, ...] = ()
    keys: KeyLabels = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DeviceLine:
    """One device of the self-test, named as in the rig file; ``detail`` is one short line, or empty: of an alert what
    to do."""

    device: str
    works: bool | None
    """``None``: nobody knows yet."""
    detail: Alert | Label = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SelfTestView(View):
    """Each device, and storage, calibration and worker, with its result as soon as it is known. Up to nine lines fit."""

    devices: tuple[DeviceLine, ...]
    version: str
    opened: bool = True
    """False while devices are still opened for the first time."""
    finished: bool = False
    passed: bool = False
    """True if every line says OK; it means nothing before ``finished``. What failed need not forbid a scan."""


@dataclass(frozen=True, slots=True)
class Gauge:
    """Distance and tilt of the object, from the laser dots, and what to do about them."""

    distance_mm: float | None
    tilt_deg: float | None
    """Positive where the right side of the surface is farther away."""
    word: Reach
    volume: WorkingVolume = STANDARD
    """Range in which the housing measures."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AimView(View):
    """Live pictures while the diver chooses the place. A picture is (h, w) uint8; ``None`` is a camera without one."""

    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scans_taken: int
    scans_left: int | None
    temperature_c: float | None
    exposure: str | None = None
    """Exposure of the next scan, with its unit; ``None``: there is nothing to say of it."""
    gauge: Gauge | None = None
    """Reading of the laser dots; ``None`` while the lasers are off."""
    marks: Marks | None = None
    """Places where the laser dots are going to be seen; ``None``: no marks are drawn."""
    water: Text | None = None
    """Word for the water that the refractive index is computed for."""
    overlap: OverlapText | None = None
    """Words about the overlap of the latest scan with the one before; ``None``: nothing is said."""
    guidance: GuidanceText | None = None
    """Words about the overlap that a scan from here would have, and the way to a better one, in place of ``overlap``;
    ``None``: nothing is said."""
    object: int | None = None
    """Number of the object that scans belong to; ``None``: of none."""
    scan_allowed: bool = True
    """False draws the label of SCAN dim; the reason is an alert."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgressView(View):
    """A scan on its way: ARMED (nothing shines yet), CAPTURE, CHECK or RECONSTRUCT, in which the diver may move.

    That of CAPTURE is drawn once, before the first pattern: until the last one nothing is drawn.
    """

    state: State

    @property
    def computes(self) -> bool:
        """True where something is computed; for how long, nobody knows."""
        return self.state not in (State.ARMED, State.CAPTURE)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReviewView(View):
    """A scan and its verdict. The coarse cloud comes first; the full one replaces it in a later view.

    ``points_mm`` is (n, 3) float32 in the left camera frame, ``values`` (n,) float32 their distance in mm, which is
    what the colours mean. The arrays must not change while they are shown; the same memory in the next view is not
    copied again. No points: (0, 3), (0,).
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
    """Time in seconds from the key press to this picture; ``None`` where it is not known."""
    lengths_doubtful: bool = False
    """Lengths are not to be trusted: no grade stands alone."""
    overlap: OverlapText | None = None
    """Words about the overlap with the scan before; ``None``: nothing is said."""
    next_scan: str | None = None
    """Exposure of the next scan, with its unit, where it is not that of this one."""
    turn_steps: int = 0
    """Number of steps by which the diver turned the cloud: to the right."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SavingView(View):
    """A scan on its way to the disk. ``saved`` is a promise: set it after the last fsync, not before."""

    scan_id: str
    saved: bool


@dataclass(frozen=True, slots=True)
class MenuRow:
    """One line of a menu. ``value`` is what is chosen now, in one word or several."""

    text: Text
    value: Label = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MenuView(View):
    """A page of the menu. Any number of rows: those around the selected one are shown."""

    title: Text
    rows: tuple[MenuRow, ...]
    selected: int
    changing: bool = False
    """The value of the selected row is being changed, and not yet taken."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredScan:
    """One scan as the gallery shows it. What a damaged scan does not tell is ``None``."""

    scan_id: str
    damaged: bool = False
    preview: NDArray[np.uint8] | None = None
    """(h, w, 3) uint8 RGB as it was stored; it must not change while it is shown."""
    grade: Grade | None = None
    corrected: bool = False
    """Motion was taken out of its points."""
    lengths_doubtful: bool = False
    points: int | None = None
    coverage_percent: float | None = None
    noise_mm: float | None = None
    distance_mm: float | None = None
    taken: str | None = None
    """Wall time; ``None`` where the clock was not to be trusted."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GalleryView(View):
    """One scan on the disk, ``index`` (from 0, the newest first) of ``count``; ``scan`` ``None`` is an empty gallery."""

    scan: StoredScan | None = None
    index: int = 0
    count: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrateView(View):
    """One step of the calibration: what to hold and how, the live pictures, and what became of the latest recording."""

    at: Calibrating
    session: Session
    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scan_allowed: bool = True
    """False draws the label of SCAN dim, like in ``AimView``; it means something only at the steps that record."""
    gauge: Gauge | None = None
    """Reading of the laser dots, drawn like that of ``AimView``, and so are the marks."""
    marks: Marks | None = None
    volume: WorkingVolume = STANDARD
    """Range in which the housing measures: where planes are to be held."""

    @property
    def step(self) -> Step:
        """The step that is shown."""
        return self.at.step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoolingView(View):
    """Too hot to shine: dark until ``temperature_c`` has fallen to ``limit_c``."""

    temperature_c: float | None
    limit_c: float
    remaining_s: float | None
    """Estimated time in seconds until it is that cool; ``None`` where it cannot be told."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SafeView(View):
    """No light any more: ``alert`` says why, and what to do. ``saved``: every scan is durable on the disk."""

    alert: Alert
    saved: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShutdownView(View):
    """The instrument is switching off. ``reason`` is the alert that forced it, ``None`` after the diver's wish."""

    reason: Alert | None = None
    saving: bool = False
    """A save is still being finished."""


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
