"""Owns the steps of the calibration in water: what is held at each, and how one recording of it was judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType

from appliance.calibrate.recordings import ArtefactKind


class Step(Enum):
    """Steps in their order: four recordings, the adjustment, a fifth recording that it has not seen, the decision."""

    M1 = "M1"
    """Ball bar, lying, one end nearer."""
    M2 = "M2"
    """Ball bar, upright, one end nearer."""
    M3 = "M3"
    """Plane, near."""
    M4 = "M4"
    """Plane, far."""
    SOLVE = "SOLVE"
    VERIFY = "VERIFY"
    """Ball bar, both ends equally far."""
    RESULT = "RESULT"


STEPS = tuple(Step)
HELD: Mapping[Step, ArtefactKind] = MappingProxyType(
    {
        Step.M1: ArtefactKind.BALL_BAR,
        Step.M2: ArtefactKind.BALL_BAR,
        Step.M3: ArtefactKind.PLANE,
        Step.M4: ArtefactKind.PLANE,
        Step.VERIFY: ArtefactKind.BALL_BAR,
    }
)
"""The steps with a recording, and what is held before the instrument."""
USED = (Step.M1, Step.M2, Step.M3, Step.M4)
"""The recordings that the adjustment uses."""


class Refusal(Enum):
    """Reasons why a recording will not do."""

    NOT_FOUND = "NOT_FOUND"
    """No ball bar or plane in the cloud."""
    FEW_POINTS = "FEW_POINTS"
    """The artefact was found, but too little of it is fit to calibrate with: edges, glare, dirt."""
    BAD_FIT = "BAD_FIT"
    """The points do not lie on balls or a plane: moved, damaged, or something else."""
    WRONG_SIZE = "WRONG_SIZE"
    """The artefact was found, but not of the certificate's size: another artefact, or a wrong certificate."""
    LAY_DOWN = "LAY_DOWN"
    STAND_UP = "STAND_UP"
    TILT_MORE = "TILT_MORE"
    TILT_LESS = "TILT_LESS"
    TOO_NEAR = "TOO_NEAR"
    TOO_FAR = "TOO_FAR"
    NOT_FILLED = "NOT_FILLED"
    """The plane covers too little of the picture."""
    MOVED = "MOVED"
    """Instrument and artefact moved against each other while it was recorded."""
    WRONG_PATTERN = "WRONG_PATTERN"
    """A frame does not show its pattern."""


UNITS: Mapping[Refusal, str] = MappingProxyType(
    {
        Refusal.NOT_FOUND: "",
        Refusal.FEW_POINTS: "",
        Refusal.BAD_FIT: "mm",
        Refusal.WRONG_SIZE: "mm",
        Refusal.LAY_DOWN: "°",
        Refusal.STAND_UP: "°",
        Refusal.TILT_MORE: "°",
        Refusal.TILT_LESS: "°",
        Refusal.TOO_NEAR: "mm",
        Refusal.TOO_FAR: "mm",
        Refusal.NOT_FILLED: "%",
        Refusal.MOVED: "px",
        Refusal.WRONG_PATTERN: "",
    }
)
"""Unit of the number that is shown with a refusal."""


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """One recording of one step, judged. ``refusal`` ``None``: it will do."""

    step: Step
    refusal: Refusal | None
    number: float | None
    """Measured number in the unit of the refusal (``UNITS``); for an accepted recording the RMS distance from its
    surfaces in mm. ``None`` where nothing was measured."""
    points: int = 0
    detail: str = ""
    """A sentence with the numbers, for the log and the manifest."""
    scan_id: str | None = None
    """The scan that holds its frames, once it is kept."""


@dataclass(frozen=True, slots=True)
class AdjustmentSummary:
    """Outcome of the adjustment, as it judges itself."""

    method: str
    residual_px: float
    warnings: tuple[str, ...]
    calibration_hash: str


@dataclass(frozen=True, slots=True)
class Verified:
    """The length of a bar that the adjustment has not seen: relative error, (measured − calibrated)/calibrated."""

    before: float | None
    """Error with the earlier calibration, or the one in use while nothing is solved; ``None`` where it finds no bar."""
    after: float | None
    """Error with the solved calibration; ``None``: nothing is solved, the bar only checks the one in use."""
    sigma: float
    """Standard uncertainty of ``after`` (of ``before`` without it) from the noise of the points and from the
    certificate, relative as well."""
    checked: str | None = None
    """Hash of the calibration that ``before`` is of; ``None``: of the drawing."""

    @property
    def better(self) -> bool | None:
        """Tell whether the length came out better than before; ``None`` where the difference may be chance (two sigma),
        or where there is nothing to compare."""
        if self.after is None:
            return None
        if self.before is None:
            return True
        gain = abs(self.before) - abs(self.after)
        return None if abs(gain) <= 2.0 * self.sigma else gain > 0.0


MOST_LENGTH_ERROR = 0.001
"""Relative error of a length above which the calibration in use, or the water that was stated, is not to be trusted."""


@dataclass(frozen=True, slots=True)
class Session:
    """Progress of one calibration. Its recordings are stored scans; the whole of it survives the loss of power."""

    trials: tuple[RecordingCheck, ...] = ()
    """Accepted recordings, at most one for each step."""
    solved: AdjustmentSummary | None = None
    verified: Verified | None = None
    in_use: bool = False
    """The instrument measures with what was solved."""
    kept: str | None = None
    """Name of the file with the calibration that was in use before; ``None`` where there was none."""

    def check(self, step: Step) -> RecordingCheck | None:
        """Return the recording of a step."""
        return next((check for check in self.trials if check.step is step), None)

    def done(self, step: Step) -> bool:
        """Tell whether a step need not be done again."""
        match step:
            case Step.SOLVE:
                return self.solved is not None
            case Step.VERIFY:
                return self.verified is not None
            case Step.RESULT:
                return self.in_use
            case _:
                return self.check(step) is not None

    def open(self, step: Step) -> bool:
        """Tell whether a step can be done now: recordings in any order, then one after the other. VERIFY checks the
        solved calibration, or else the one in use."""
        match step:
            case Step.SOLVE:
                return all(self.check(used) is not None for used in USED)
            case Step.VERIFY:
                return True
            case Step.RESULT:
                return self.verified is not None
            case _:
                return True

    @property
    def length_error(self) -> float | None:
        """Relative error of the bar of VERIFY with the calibration in use; ``None``: nobody has checked it."""
        if self.verified is None:
            return None
        return self.verified.after if self.in_use else self.verified.before

    @property
    def wrong(self) -> bool:
        """Tell whether lengths are surely wrong by more than is allowed."""
        error, verified = self.length_error, self.verified
        return error is not None and verified is not None and abs(error) - 2.0 * verified.sigma > MOST_LENGTH_ERROR

    @property
    def right(self) -> bool:
        """Tell whether lengths are right within what is allowed, by a check that is exact enough to tell."""
        error, verified = self.length_error, self.verified
        return error is not None and verified is not None and max(abs(error), 2.0 * verified.sigma) <= MOST_LENGTH_ERROR

    @property
    def next_step(self) -> Step:
        """The first step that is not done; the result when all are."""
        return next((step for step in STEPS if not self.done(step)), Step.RESULT)

    def with_check(self, check: RecordingCheck) -> Session:
        """Return the session with a recording in place of its step's older one. A solution that used the older one is
        dropped."""
        others = tuple(t for t in self.trials if t.step is not check.step)
        changed = replace(self, trials=(*others, check))
        if check.step not in USED:
            return changed
        verified = self.verified
        if verified is not None and verified.after is None:  # a check of before is no witness of what will be solved
            changed = replace(changed, trials=tuple(t for t in changed.trials if t.step is not Step.VERIFY))
        if verified is not None:  # what it says of the calibration in use still holds
            error = self.length_error
            checked = self.solved.calibration_hash if self.in_use and self.solved is not None else verified.checked
            verified = None if error is None else Verified(error, None, verified.sigma, checked)
        return replace(changed, solved=None, verified=verified, in_use=False)
