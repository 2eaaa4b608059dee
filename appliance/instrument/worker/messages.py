"""Messages between the worker process and its parent, pickled on one pipe.

    WorkOrder, WorkLimits    setup of a worker, and its limits
    Begin … Ping             orders to the worker
    Ready, Pong, …           its signs of life; its results are ``appliance.measure.News``

A ticket numbers the sequences; news of an earlier one are ignored. Messages contain no pixels or points: frames are in
the shared store, clouds in shared memory, where ``CloudLocation`` names the part.
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
    """Setup of a worker to reconstruct scans; a changed one needs another worker."""

    calibration: Calibration
    water: Water
    sequence: PatternSequence
    noise: StereoNoise = TYPICAL_PAIR
    """Noise of the cameras with their settings."""


@dataclass(frozen=True, slots=True)
class WorkLimits:
    """Limits of a worker; beyond one of them it is started again."""

    start_s: float = 240.0
    """Longest start; without compiled kernels it takes most of a minute, and more on a busy computer."""
    cloud_s: float = 10.0
    """Longest step between the last frame and the full cloud; a hundred times of what it takes."""
    computing_s: float = 60.0
    """The same while the worker uses a processor: it may be throttled, or shared."""
    alive_s: float = 5.0
    """Longest time to answer a ping while idle."""
    memory_mb: float = 1000.0
    """Largest private memory, MB; the shared frames do not count.

    Motion compensation of a scan of 1600 × 1200 takes 740.
    """
    start_memory_mb: float = 1500.0
    """The same until it is ready: without compiled kernels, it includes the compiler."""


@dataclass(frozen=True, slots=True)
class Begin:
    """Order to the worker: the frames of a new sequence will follow."""

    ticket: int
    settings: AcquisitionSettings
    second: bool = False
    """True if the frames are the second exposure of the latest scan, in the second part of the store."""
    belongs_to: int | None = None
    """Number of the scan's object.

    The scan is compared with the one before if both belong to the same object, or to none.
    """


@dataclass(frozen=True, slots=True)
# No ticket: the pipe keeps the order, so that messages after a ``Begin`` belong to it. Answers need one, since they
# cross with orders.
class FrameStored:
    """Order to the worker: frame ``index`` of the camera ``side`` is in the store."""

    side: str
    index: int


@dataclass(frozen=True, slots=True)
class Finish:
    """Order to the worker: all frames are there; send all facts about them."""


@dataclass(frozen=True, slots=True)
class Drop:
    """Order to the worker: the sequence is no longer needed."""


@dataclass(frozen=True, slots=True)
class Keep:
    """Order to the worker: the diver keeps the latest scan, with which the next one is to be compared."""


@dataclass(frozen=True, slots=True)
class LookAt:
    """Order to the worker: give guidance from the live image in the shared memory."""

    taken_ns: int
    """Time of the image; the answer ``LiveGuidance`` carries it."""
    shape: tuple[int, int]
    """Height and width of the image, px."""
    belongs_to: int
    """Number of the object of the next scan."""


@dataclass(frozen=True, slots=True)
class CloudCopied:
    """Order to the worker: the full cloud was copied, and its memory may be used again."""

    ticket: int


@dataclass(frozen=True, slots=True)
class Ping:
    """Order to the worker: answer ``Pong``."""


@dataclass(frozen=True, slots=True)
class Ready:
    """Report of the worker: it is loaded, and buffers are allocated. Its parent passes it on."""


@dataclass(frozen=True, slots=True)
class Pong:
    """Report of the worker: it is alive."""


ToWorker = Begin | FrameStored | Finish | Drop | Keep | LookAt | CloudCopied | Ping
FromWorker = Ready | Pong | News | LiveGuidance | WorkerFailure
