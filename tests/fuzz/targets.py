"""The list of all fuzz targets: every parser of bytes that come from outside."""

from __future__ import annotations

from tests.fuzz import camera, console, files, foreign, lines
from tests.fuzz.target import Target

TARGETS: tuple[Target, ...] = (*camera.TARGETS, *lines.TARGETS, *files.TARGETS, *foreign.TARGETS, *console.TARGETS)
