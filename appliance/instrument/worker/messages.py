"""Owns the messages between the worker process and its parent, pickled on one pipe.

    WorkOrder, WorkLimits    what a worker is started for, and the bounds of what it may take
    Begin … Ping             orders to the worker
    Ready, Pong, …           its signs of life; its results are ``appliance.measure.News``

A ticket numbers the sequences that were begun; news of an earlier one are of no interest any more. Pixels and points
are never in a message: frames lie in the shared store, clouds in shared memory, where ``Found`` says which part.
"""

from __future__ import annotations

from dataclasses import dataclass

from appliance.measure import (
    TYPICAL_PAIR,
    AcquisitionSettings,
    Calibration,
    LiveGuidance,
    News,
    PatternSequence,
    StereoNoise,
    Water,
    WorkerFailure,
)


@dataclass(frozen=True, slots=True)
class WorkOrder:
    """Everything a worker must know to reconstruct scans; another order needs another worker."""

    calibration: Calibration
    water: Water
    sequence: PatternSequence
    noise: StereoNoise = TYPICAL_PAIR
    """Noise of the cameras as they are set."""


@dataclass(frozen=True, slots=True)
class WorkLimits:
    """The bounds of what a worker may take; beyond, it is started again."""

    start_s: float = 240.0
    """A cold start without compiled kernels takes most of a minute, and more on a busy machine."""
    cloud_s: float = 10.0
    """Longest time from one step to the next of those that lead from the last frame to the full cloud; a hundred times
    what they take."""
    computing_s: float = 60.0
    """The same where it is seen to compute: on a processor that is throttled, or shared."""
    alive_s: float = 5.0
    """Longest time from a question to its answer while it has nothing to do."""
    memory_mb: float = 1000.0
    """Largest memory of its own, MB; the shared frames do not count. Compensating a scan of 1600 × 1200 takes 740."""
    start_memory_mb: float = 1500.0
    """The same until it is ready: without compiled kernels, the compiler is in it, too."""


@dataclass(frozen=True, slots=True)
class Begin:
    """The order to the worker: the frames of a new sequence will follow."""

    ticket: int
    settings: AcquisitionSettings
    second: bool = False
    """True if the frames are the second exposure of the scan begun last, and lie in the second place of the store."""
    belongs_to: int | None = None
    """Number of the scan's object: it is compared with the scan before where that is of the same one, or both are of
    none."""


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
    """The order to the worker: the diver aims at what the live picture in the shared memory shows, and wants to be
    guided."""

    taken_ns: int
    """Time at which the picture was put there; ``LiveGuidance``, the answer, carries it."""
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
    """The worker's report: what every scan needs is loaded, and buffers are allocated. Its parent hands it on."""


@dataclass(frozen=True, slots=True)
class Pong:
    """The worker's report: it is there."""


ToWorker = Begin | FrameStored | Finish | Drop | Keep | LookAt | CloudCopied | Ping
FromWorker = Ready | Pong | News | LiveGuidance | WorkerFailure
