"""Owns what a report says, as plain values: whoever merged the scans fills them in, and the page only lays them out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from appliance.desk.surface.deviation import Deviation
from appliance.desk.surface.fusion import FusedCloud
from appliance.desk.surface.mesh import Mesh
from appliance.measure import Grade

Vector = tuple[float, float, float]


def when(wall_time: str) -> str:
    """Return an ISO 8601 time as it has room in a table: date, hours and minutes, by the clock of the instrument."""
    return wall_time[:16].replace("T", " ")


class ReportVerdict(Enum):
    """The answer to whether something may be relied on."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    """It takes part, and something is held against it."""
    UNCHECKED = "unchecked"
    """A pair that takes part, and that no loop of pairs checks."""
    REFUSED = "refused"
    """It takes no part; the reason says why."""


@dataclass(frozen=True, slots=True)
class ReportScan:
    """One scan of the object or the dive. ``None``: not known, and shown as a dash."""

    name: str
    verdict: ReportVerdict
    reason: str = ""
    """Words for the verdict; empty where there is nothing to say."""
    recorded: str | None = None
    points: int | None = None
    distance_mm: float | None = None
    sigma_mm: float | None = None
    """Median of its points' sigma."""
    ray_gap_mm: float | None = None
    position_mm: Vector | None = None
    """Place of the left camera in the object's frame."""
    rotation_deg: Vector | None = None
    """Rotation vector of its placement: axis times angle in degrees."""
    pose_sigma_mm: float | None = None
    warnings: Sequence[str] = ()
    picture_png: bytes | None = None
    """The scan as its left camera sees it (``report.still.picture_of_scan``)."""
    grade: Grade | None = None
    """Its grade, which is shown in place of the verdict's word; ``None``: it is not the grade that decides."""

    @property
    def word(self) -> str:
        """The one word that is shown of it."""
        return self.verdict.value if self.grade is None else self.grade.value


@dataclass(frozen=True, slots=True)
class ReportPair:
    """Two scans that were compared with each other."""

    first: str
    second: str
    verdict: ReportVerdict
    reason: str = ""
    overlap_percent: float | None = None
    matches: int | None = None
    """Features that both scans show."""
    residual_mm: float | None = None
    sigma_mm: float | None = None
    """Standard deviation of the displacement that their pose leaves over the overlap, RMS."""
    sigma_deg: float | None = None
    """Standard deviation of the turn between both, in its weakest direction."""


@dataclass(frozen=True, slots=True)
class ReportTerm:
    """One contribution to the uncertainty."""

    what: str
    value_mm: float
    """Standard uncertainty it contributes."""
    how: str = ""
    """The source of the figure."""


@dataclass(frozen=True, slots=True)
class ReportBudget:
    """Uncertainty of a length, by its contributions."""

    over_mm: float
    """The length that it is stated for."""
    terms: Sequence[ReportTerm]
    combined_mm: float
    """Standard uncertainty of all; twice that covers some 95 %."""
    statement: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ReportNominal:
    """The comparison of the report's points with a nominal surface."""

    name: str
    deviation: Deviation
    """One for each point of the report's ``surface``."""
    tolerance_mm: float | None = None
    """Deviations beyond plus or minus that are marked."""


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """Everything on one page."""

    title: str
    subtitle: str = ""
    about: Mapping[str, str] = field(default_factory=dict)
    """Facts that the page begins with: instrument, calibration, water, dates, in words."""
    scans: Sequence[ReportScan] = ()
    pairs: Sequence[ReportPair] = ()
    budget: ReportBudget | None = None
    surface: FusedCloud | None = None
    mesh: Mesh | None = None
    """Drawn instead of the surface's points where there is one and there is no nominal surface."""
    nominal: ReportNominal | None = None
    warnings: Sequence[str] = ()
    up: Vector = (0.0, -1.0, 0.0)
    """Direction that is shown upwards; by default that of the camera's frame, whose y points down."""

    def __post_init__(self) -> None:
        """Raises ValueError for a comparison of other points than those of the surface."""
        if self.nominal is not None and (
            self.surface is None or len(self.nominal.deviation.deviation_mm) != len(self.surface.grey)
        ):
            raise ValueError("nominal: there must be one deviation for each point of the surface")
