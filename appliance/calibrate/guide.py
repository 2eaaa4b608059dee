"""Steps of the guided calibration in water, and the progress of one session through them.

Step, STEPS, HELD, USED           the steps, their order, and the artefact of each recording
Refusal, UNITS, RecordingCheck    the judgement of one recording
AdjustmentSummary, LengthCheck    result of the adjustment, and the length check of VERIFY
Session                           progress of one calibration
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType

from appliance.calibrate.recordings import ArtefactKind


class Step(Enum):
    """Steps in their order: four recordings, the adjustment, a recording that it has not seen, the decision."""

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
"""Artefact of each step that records one."""
USED = (Step.M1, Step.M2, Step.M3, Step.M4)
"""Steps whose recordings the adjustment uses."""


class Refusal(Enum):
    """Reasons why a recording is not accepted."""

    NOT_FOUND = "NOT_FOUND"
    """No ball bar or plane in the cloud."""
    FEW_POINTS = "FEW_POINTS"
    """The artefact was found, but too few pixels of it can be used: edges, glare, dirt."""
    BAD_FIT = "BAD_FIT"
    """The points do not lie on balls or a plane: moved, damaged, or another object."""
    WRONG_SIZE = "WRONG_SIZE"
    """The artefact was found, but its size is not that of the certificate."""
    LAY_DOWN = "LAY_DOWN"
    STAND_UP = "STAND_UP"
    TILT_MORE = "TILT_MORE"
    TILT_LESS = "TILT_LESS"
    TOO_NEAR = "TOO_NEAR"
    TOO_FAR = "TOO_FAR"
    NOT_FILLED = "NOT_FILLED"
    """The plane covers too little of the image."""
    MOVED = "MOVED"
    """Instrument and artefact moved relative to each other during the recording."""
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
"""Unit of the number that is shown with each refusal."""


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """Judgement of the recording of one step; accepted where ``refusal`` is ``None``."""

    step: Step
    refusal: Refusal | None
    number: float | None
    """Measured number in the unit of the refusal (``UNITS``); for an accepted recording the RMS residual of its
    surfaces in mm. ``None`` without a measurement."""
    points: int = 0
    detail: str = ""
    """Sentence with the numbers, for the log and the manifest."""
    scan_id: str | None = None
    """Scan with its frames, once it is stored."""


@dataclass(frozen=True, slots=True)
class AdjustmentSummary:
    """Result of the adjustment by its own numbers."""

    method: str
    residual_px: float
    warnings: tuple[str, ...]
    calibration_hash: str


@dataclass(frozen=True, slots=True)
class LengthCheck:
    """Length check with a bar that the adjustment has not seen: (measured − calibrated)/calibrated."""

    before: float | None
    """Error with the earlier calibration, or with the one in use before a solution; ``None`` where no bar is found."""
    after: float | None
    """Error with the solved calibration; ``None`` before a solution, when the bar only checks the one in use."""
    sigma: float
    """Relative standard uncertainty of ``after`` (else of ``before``), from the points' noise and the certificate."""
    checked: str | None = None
    """Hash of the calibration of ``before``; ``None`` for the nominal one."""

    @property
    def better(self) -> bool | None:
        """True if the length error is smaller than before; ``None`` if the difference may be noise or there is none.

        Noise is a change within two standard uncertainties.
        """
        if self.after is None:
            return None
        if self.before is None:
            return True
        gain = abs(self.before) - abs(self.after)
        return None if abs(gain) <= 2.0 * self.sigma else gain > 0.0


MOST_LENGTH_ERROR = 0.001
"""Relative length error above which the calibration in use, or the stated water, must not be trusted."""


@dataclass(frozen=True, slots=True)
class Session:
    """Progress of one calibration. Its recordings are stored scans; all of it survives a loss of power."""

    trials: tuple[RecordingCheck, ...] = ()
    """Accepted recordings, at most one for each step."""
    solved: AdjustmentSummary | None = None
    verified: LengthCheck | None = None
    in_use: bool = False
    """The instrument measures with the solved calibration."""
    kept: str | None = None
    """File name of the calibration that was in use before; ``None`` without one."""

    def check(self, step: Step) -> RecordingCheck | None:
        """Return the accepted recording of a step."""
        return next((check for check in self.trials if check.step is step), None)

    def done(self, step: Step) -> bool:
        """Tell whether a step is done."""
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
        """Tell whether a step can be done now.

        Recordings can be made in any order, SOLVE after all that it uses, RESULT after VERIFY. VERIFY checks the solved
        calibration, or else the one in use.
        """
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
        """Relative error of the bar of VERIFY with the calibration in use; ``None`` before a check."""
        if self.verified is None:
            return None
        return self.verified.after if self.in_use else self.verified.before

    @property
    def wrong(self) -> bool:
        """True if length errors certainly exceed the limit."""
        error, verified = self.length_error, self.verified
        return error is not None and verified is not None and abs(error) - 2.0 * verified.sigma > MOST_LENGTH_ERROR

    @property
    def right(self) -> bool:
        """True if length errors are within the limit, by a check whose uncertainty is small enough."""
        error, verified = self.length_error, self.verified
        return error is not None and verified is not None and max(abs(error), 2.0 * verified.sigma) <= MOST_LENGTH_ERROR

    @property
    def next_step(self) -> Step:
        """First step that is not done; RESULT when all are."""
        return next((step for step in STEPS if not self.done(step)), Step.RESULT)

    def with_check(self, check: RecordingCheck) -> Session:
        """Return the session with ``check`` in place of an older recording of its step.

        A solution that used the older one is dropped.
        """
        trials = tuple(t for t in self.trials if t.step is not check.step)
        changed = replace(self, trials=(*trials, check))
        if check.step not in USED:
            return changed
        verified = self.verified
        # A check of the former calibration says nothing about the next solution.
        if verified is not None and verified.after is None:
            changed = replace(changed, trials=tuple(t for t in changed.trials if t.step is not Step.VERIFY))
        if verified is not None:  # its error of the calibration in use is still true
            error = self.length_error
            checked = self.solved.calibration_hash if self.in_use and self.solved is not None else verified.checked
            verified = None if error is None else LengthCheck(error, None, verified.sigma, checked)
        return replace(changed, solved=None, verified=verified, in_use=False)
