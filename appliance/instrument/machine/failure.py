"""Owns why something wanted for the calibration came to nothing: a kind that the screen has words for, and the log's
sentence."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class FailureKind(Enum):
    """Kind of a failure, to tell the diver; it decides what he can do."""

    RECORDING = "recording"
    """A recording, or the artefact in it, cannot be used."""
    CERTIFICATE = "certificate"
    """The ball bar's certificate is not stated."""
    CAMERAS = "cameras"
    """The recordings are of other cameras."""
    NO_SOLUTION = "no solution"
    """Each recording can be used, and no calibration fits all of them."""
    FILES = "files"
    """A file of the session, or a calibration, is damaged, missing or does not fit."""
    DISK = "disk"
    """The disk refused."""
    BROKEN_OFF = "broken off"
    """The computation ended without an answer."""
    NO_ANSWER = "no answer"
    """Nobody answered in time."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of a task."""

    kind: FailureKind
    detail: str
    """Details for the log, and for who repairs it: English, with names and values. Never on the screen."""
    about: str = ""
    """The step that it is about; empty: none in particular."""
