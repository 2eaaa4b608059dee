"""The facts about a sequence, which go from the procedure over the worker's pipe to the machine.

Points are never in a fact: ``CloudLocation`` says where they are, and the owner of that memory makes a copy on request.
"""

from __future__ import annotations

from dataclasses import dataclass

from appliance.measure.cloud import CloudLocation
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import Guidance, Overlap
from appliance.measure.verdict import Judgement


@dataclass(frozen=True, slots=True)
class PatternIdentity:
    """Judgement whether each frame shows its pattern.

    With a fault, points would have no meaning, and none follow.
    """

    judgement: Judgement


@dataclass(frozen=True, slots=True)
class CoarseCloud:
    """Cloud of every few pixels."""

    cloud: CloudLocation
    cpu_s: float = 0.0
    """Processor time of this cloud, including the identity before it."""


@dataclass(frozen=True, slots=True)
class WorkProgress:
    """One step of the work without a result of its own: a judge, or a step of a second exposure."""

    step: str


@dataclass(frozen=True, slots=True)
class Verdicts:
    """All judgements of the scan, identity first, instead of the earlier ones."""

    judgements: tuple[Judgement, ...]
    cpu_s: float = 0.0
    """Processor time of all judges except identity; the second time, that of the compensation."""
    compensating: bool = False
    """True if there was motion: compensation is the next step."""


@dataclass(frozen=True, slots=True)
class FullCloud:
    """Cloud of every pixel, with the final judgements of the scan."""

    cloud: CloudLocation
    judgements: tuple[Judgement, ...] = ()
    cpu_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Bracket:
    """Result of a bracket: the cloud of both exposures, or a fault."""

    cloud: CloudLocation | None
    """Cloud of both; ``None``: refused."""
    pair: Judgement
    """Judgement of both together, the verdict ``pair``."""
    second: tuple[Judgement, ...] = ()
    """Judgements of the second sequence alone."""
    cpu_s: float = 0.0

    @property
    def fault(self) -> Fault:
        """Fault for which the exposures were not merged, if they were not."""
        return self.pair.fault or Fault(FaultCode.RECONSTRUCTION_FAILED, self.pair.verdict.text)


@dataclass(frozen=True, slots=True)
class ScanOverlap:
    """Overlap of the scan with the one before of its object, some time after the full cloud."""

    overlap: Overlap
    cpu_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ReconstructionFailure:
    """Fault for which these frames get no points; the next scan may."""

    fault: Fault


SequenceFact = (
    PatternIdentity | CoarseCloud | WorkProgress | Verdicts | FullCloud | Bracket | ScanOverlap | ReconstructionFailure
)


@dataclass(frozen=True, slots=True)
class News:
    """Envelope of a fact."""

    number: int
    """Number of the sequence: the ticket of its ``Begin`` on the worker's pipe, that of its scan everywhere else."""
    fact: SequenceFact


@dataclass(frozen=True, slots=True)
class LiveGuidance:
    """Guidance by a live image. It belongs to no sequence, and ends when a scan begins."""

    guidance: Guidance | None
    """``None``: unknown."""
    taken_ns: int
    """Time of the live image."""
    cpu_s: float = 0.0


@dataclass(frozen=True, slots=True)
class WorkerFailure:
    """Failure of the worker's process, in its last words or those of its parent.

    The parent starts it again or has given up.
    """

    text: str
