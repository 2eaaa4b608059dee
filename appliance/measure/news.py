"""Owns the facts that a sequence gives, each under one name from the procedure over the worker's pipe to the machine.

Points are never in a fact: ``Found`` says where they are, and whoever holds that memory is asked for a copy.
"""

from __future__ import annotations

from dataclasses import dataclass

from appliance.measure.cloud import Found
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import Guidance, Overlap
from appliance.measure.verdict import Judgement


@dataclass(frozen=True, slots=True)
class PatternIdentity:
    """Judgement whether each frame shows the pattern it should.

    With a fault, points would mean nothing, and none follow.
    """

    judgement: Judgement


@dataclass(frozen=True, slots=True)
class CoarseCloud:
    """Cloud of every few pixels."""

    found: Found
    cpu_s: float = 0.0
    """Processor time of this cloud, the identity before it included."""


@dataclass(frozen=True, slots=True)
class WorkProgress:
    """One step more of the work, of which nothing else is to be told: a judge has spoken, or a step of a second
    exposure is done."""

    step: str


@dataclass(frozen=True, slots=True)
class Verdicts:
    """All judgements of the scan, identity first, in place of those before."""

    judgements: tuple[Judgement, ...]
    cpu_s: float = 0.0
    """Processor time of all judges but that of identity; of the second time, that of the compensation."""
    compensating: bool = False
    """True if instrument and scene moved against each other: it is tried next to take that out of the points."""


@dataclass(frozen=True, slots=True)
class FullCloud:
    """Cloud of every pixel, with the final judgements of the scan."""

    found: Found
    judgements: tuple[Judgement, ...] = ()
    cpu_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Bracket:
    """Outcome of a second exposure: the cloud of both, or the fault for which there is none."""

    found: Found | None
    """Cloud of both; ``None``: refused."""
    pair: Judgement
    """Judgement of both together, the verdict ``pair``."""
    second: tuple[Judgement, ...] = ()
    """Judgements of the second sequence alone."""
    cpu_s: float = 0.0

    @property
    def fault(self) -> Fault:
        """Fault for which both are not one cloud, where they are not."""
        return self.pair.fault or Fault(FaultCode.RECONSTRUCTION_FAILED, self.pair.verdict.text)


@dataclass(frozen=True, slots=True)
class ScanOverlap:
    """Overlap of the scan with the one before of its object, found some time after the full cloud."""

    overlap: Overlap
    cpu_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ReconstructionFailure:
    """Fault for which the frames get no points now; the next scan's may."""

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
    """Guidance by a live picture. It belongs to no sequence: a scan that begins ends it."""

    guidance: Guidance | None
    """``None``: it cannot be told."""
    taken_ns: int
    """Time at which the picture was handed over."""
    cpu_s: float = 0.0


@dataclass(frozen=True, slots=True)
class WorkerFailure:
    """Failure of the worker's process, in words: its own last ones, or its parent's, which starts it again or has given
    up."""

    text: str
