"""Owns why something wanted for the calibration came to nothing: a kind that the screen has words for, and the log's sentence."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Mishap(Enum):
    """What to tell the diver; it decides what he can do."""

    RECORDING = "recording"
    """A recording, or the artefact in it, cannot be used."""
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
    """What became of a task."""

    mishap: Mishap
    detail: str
    """For the log, and for who repairs it: English, with names and values."""
