"""Owns what the worker process and its parent say to each other: typed values, pickled on one pipe.

A ticket numbers the sequences that were begun; what is said of an earlier one is of no interest any more. Pixels and points
are never in a message: frames lie in the shared store, clouds in shared memory, where ``Found`` says which part.
"""

from __future__ import annotations

from dataclasses import dataclass

from appliance.reconstruct.table import Found
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.guidance import Guidance
from appliance.scan.overlap import Overlap
from appliance.scan.verdict import Judgement


@dataclass(frozen=True, slots=True)
class Begin:
    """The order to the worker: the frames of a new sequence will follow."""

    ticket: int
    settings: AcquisitionSettings
    second: bool = False
    """True if the frames are the second exposure of the scan begun last, and lie in the second place of the store."""
    belongs_to: int | None = None
    """Number of the scan's object: it is compared with the scan before where that is of the same one, or both are of none."""


@dataclass(frozen=True, slots=True)
# No ticket: the pipe keeps the order, so that what follows a ``Begin`` belongs to it. Answers need one, since they
# cross with orders that are on their way.
class FrameStored:
    """The order to the worker: frame ``index`` of the camera ``side`` is in the store."""

    side: str
    index: int


@dataclass(frozen=True, slots=True)
class Finish:
    """The order to the worker: all frames are there; say everything that is to be said of them."""


@dataclass(frozen=True, slots=True)
class Drop:
    """The order to the worker: nobody wants the sequence any more."""


@dataclass(frozen=True, slots=True)
class Keep:
    """The order to the worker: the diver keeps the scan begun last, and the next one is to be compared with it."""


@dataclass(frozen=True, slots=True)
class LookAt:
    """The order to the worker: the diver aims at what the live picture in the shared memory shows, and wants to be guided."""

    number: int
    """Counts these orders; the answer carries it."""
    shape: tuple[int, int]
    """Height and width of the picture, px."""
    belongs_to: int
    """Number of the object that the next scan will be of."""


@dataclass(frozen=True, slots=True)
class CloudCopied:
    """The order to the worker: the full cloud was copied, and its memory may be used again."""

    ticket: int


@dataclass(frozen=True, slots=True)
class Ping:
    """The order to the worker: answer ``Pong``."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The worker's report: what every scan needs is loaded, and buffers are allocated."""


@dataclass(frozen=True, slots=True)
class Loaded:
    """The worker's report, some time after ``Ready``: what only some scans need is loaded, too."""


@dataclass(frozen=True, slots=True)
class Pong:
    """The worker's report: it is there."""


@dataclass(frozen=True, slots=True)
class GoingOn:
    """The worker's report: one step more is done, which tells a slow processor from a process that hangs."""

    ticket: int


@dataclass(frozen=True, slots=True)
class PatternsIdentified:
    """The worker's report: every frame shows the pattern it should."""

    ticket: int


@dataclass(frozen=True, slots=True)
class Spoiled:
    """The worker's report: a frame shows another pattern than it should; there will be no cloud."""

    ticket: int
    judgement: Judgement


@dataclass(frozen=True, slots=True)
class CloudFound:
    """The worker's report: a cloud is in its place in the shared memory; for a full one ``CloudCopied`` is awaited."""

    ticket: int
    full: bool
    found: Found
    cpu_s: float


@dataclass(frozen=True, slots=True)
class SequenceJudged:
    """The worker's report: what is to be said of the sequence, in place of what was said before."""

    ticket: int
    judgements: tuple[Judgement, ...]
    cpu_s: float


@dataclass(frozen=True, slots=True)
class BracketJudged:
    """The worker's report: what became of a second exposure; with a cloud, ``CloudCopied`` is awaited."""

    ticket: int
    found: Found | None
    """The cloud of both; ``None``: ``pair`` says why there is none."""
    second: tuple[Judgement, ...]
    """The judges' word on the second sequence alone."""
    pair: Judgement
    cpu_s: float


@dataclass(frozen=True, slots=True)
class OverlapFound:
    """The worker's report, some time after the full cloud: how much of the scan lies on the one before."""

    ticket: int
    overlap: Overlap
    cpu_s: float


@dataclass(frozen=True, slots=True)
class LookedAt:
    """The worker's report: a live picture was looked at. None comes where a scan began meanwhile."""

    number: int
    guidance: Guidance | None
    """``None``: it cannot be told."""
    cpu_s: float


@dataclass(frozen=True, slots=True)
class SequenceFailed:
    """The worker's report: the frames are not what was agreed; the next sequence's may be."""

    ticket: int
    text: str


@dataclass(frozen=True, slots=True)
class Crashed:
    """The worker's report: its last words."""

    text: str


ToWorker = Begin | FrameStored | Finish | Drop | Keep | LookAt | CloudCopied | Ping
FromWorker = (
    Ready
    | Loaded
    | Pong
    | GoingOn
    | PatternsIdentified
    | Spoiled
    | CloudFound
    | SequenceJudged
    | BracketJudged
    | OverlapFound
    | LookedAt
    | SequenceFailed
    | Crashed
)
