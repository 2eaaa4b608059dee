"""Content of a report as plain values, which the page only lays out."""

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
    """Return an ISO 8601 time for a table: date, hours and minutes, by the clock of the instrument."""
    return wall_time[:16].replace("T", " ")


class ReportVerdict(Enum):
    """Reliability of a scan or a scan pair."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    """It takes part, with a fault."""
    UNCHECKED = "unchecked"
    """A pair that takes part, and that no loop of pairs checks."""
    REFUSED = "refused"
    """It takes no part; the reason says why."""


@dataclass(frozen=True, slots=True)
class ReportScan:
    """One scan of the object or the dive. ``None`` means unknown, and is shown as a dash."""

    name: str
    verdict: ReportVerdict
    reason: str = ""
    """Reason of the verdict in words; may be empty."""
    recorded: str | None = None
    points: int | None = None
    distance_mm: float | None = None
    sigma_mm: float | None = None
    """Median of its points' sigma."""
    ray_gap_mm: float | None = None
    position_mm: Vector | None = None
    """Place of the left camera in the object's frame."""
    rotation_deg: Vector | None = None
    """Rotation vector of its pose: axis times angle in degrees."""
    pose_sigma_mm: float | None = None
    warnings: Sequence[str] = ()
    picture_png: bytes | None = None
    """The scan as its left camera sees it (``report.still.picture_of_scan``)."""
    grade: Grade | None = None
    """Its grade, which is shown in place of the verdict's word; ``None``: the verdict's word is shown."""

    @property
    def word(self) -> str:
        """The word that is shown for it."""
        return self.verdict.value if self.grade is None else self.grade.value


@dataclass(frozen=True, slots=True)
class ReportPair:
    """A compared scan pair."""

    first: str
    second: str
    verdict: ReportVerdict
    reason: str = ""
    overlap_percent: float | None = None
    matches: int | None = None
    """Number of keypoints in both scans."""
    residual_mm: float | None = None
    sigma_mm: float | None = None
    """Standard deviation of the displacement by their pose, RMS over the overlap."""
    sigma_deg: float | None = None
    """Standard deviation of the rotation between both, in its weakest direction."""


@dataclass(frozen=True, slots=True)
class ReportTerm:
    """One contribution to the uncertainty."""

    what: str
    value_mm: float
    """Standard uncertainty of this contribution."""
    how: str = ""
    """The source of the figure."""


@dataclass(frozen=True, slots=True)
class ReportBudget:
    """Uncertainty of a length, by its contributions."""

    over_mm: float
    """The length for which it is stated."""
    terms: Sequence[ReportTerm]
    combined_mm: float
    """Standard uncertainty of all; twice that covers some 95 %."""
    statement: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ReportNominal:
    """Comparison of the report's points with a nominal surface."""

    name: str
    deviation: Deviation
    """Deviation of each point of the report's ``surface``."""
    tolerance_mm: float | None = None
    """Deviations beyond plus or minus this are marked."""


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """Content of one page."""

    title: str
    subtitle: str = ""
    about: Mapping[str, str] = field(default_factory=dict)
    """Facts at the top of the page: instrument, calibration, water, dates, in words."""
    scans: Sequence[ReportScan] = ()
    pairs: Sequence[ReportPair] = ()
    budget: ReportBudget | None = None
    surface: FusedCloud | None = None
    mesh: Mesh | None = None
    """Mesh that is drawn instead of the surface's points if there is no nominal surface."""
    nominal: ReportNominal | None = None
    warnings: Sequence[str] = ()
    up: Vector = (0.0, -1.0, 0.0)
    """Direction that is shown upwards; the default fits the left camera frame, whose y points down."""

    def __post_init__(self) -> None:
        """Raise ValueError for a comparison of other points than those of the surface."""
        if self.nominal is not None and (
            self.surface is None or len(self.nominal.deviation.deviation_mm) != len(self.surface.grey)
        ):
            raise ValueError("nominal: there must be one deviation for each point of the surface")
