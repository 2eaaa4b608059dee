"""Owns the verb ``bringup guide``, and how it speaks with whoever stands at the instrument: a line on stderr, an Enter as the answer."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from io import UnsupportedOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from appliance.cli.arguments import number, option, repeated
from appliance.cli.bringup import say_findings
from appliance.cli.output import Exit, Progress, UsageError, complain, say, say_json
from appliance.cli.places import WithRig

if TYPE_CHECKING:  # brings OpenCV, which `--help` can do without
    from appliance.bringup.guide_state import StepRecord
    from appliance.service.bringup.guide import Walked

ANSWERED_WITHIN_S = 3600.0
"""Time for which an Enter is waited for: whoever is away for longer calls again, and goes on where he was."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BringupGuide(WithRig):
    """Walk from a box of parts to the first plane in twelve steps, each checked; a second call goes on where the first one stopped."""

    out: Path | None = option("--out", "folder for state, page and pictures", parse=Path, metavar="FOLDER")
    only: Sequence[str] = repeated("--only", "this step and no other; may be repeated", metavar="STEP")
    again: Sequence[str] = repeated("--again", "this step although it is good; may be repeated", metavar="STEP")
    endurance_minutes: float = option(
        "--endurance-minutes",
        "length of the step endurance (default: %(default)g)",
        default=10.0,
        parse=number(0.02, 1440.0),
        metavar="MIN",
    )
    plane_mm: float | None = option(
        "--plane-mm",
        "distance at which the white plane stands (default: the rig file's working distance)",
        parse=number(50.0, 3000.0),
        metavar="MM",
    )

    def run(self) -> Exit:
        if self.rig is None:
            raise UsageError("--rig: not given, and the packaged rig file is never changed; give the instrument's")
        if self.out is None:
            raise UsageError("--out: not given; give a folder, in which state, page and pictures are kept")
        if self.out.exists() and not self.out.is_dir():
            raise UsageError(f"--out {self.out}: is a file; give a folder, which is made if it is not there")
        self.read_rig()
        from appliance.bringup.finding import BringupError
        from appliance.bringup.guide import NAMES
        from appliance.service.bringup.guide import GuideOptions, walk

        for flag, steps in (("--only", self.only), ("--again", self.again)):
            for name in steps:
                if name not in NAMES:
                    raise UsageError(f"{flag} {name}: no such step; allowed are {', '.join(NAMES)}")
        options = GuideOptions(tuple(self.only), tuple(self.again), self.endurance_minutes, self.plane_mm)
        try:
            with Progress() as progress:
                walked = walk(self.rig, self.out, options, AtTheTerminal(sys.stdin, sys.stderr), progress, self._tell)
        except BringupError as error:
            complain(str(error), as_json=self.json)
            return Exit.FAILED
        # On stderr, where errors are looked for: findings are results, this is why there are no more.
        if walked.stopped is not None:
            complain(walked.stopped, as_json=self.json)
        if self.json:
            say_json(report_of(walked))
        else:
            say(_end(walked, self.out))
        return Exit.OK if walked.good else Exit.FAILED

    def _tell(self, name: str, record: StepRecord) -> None:
        if not self.json:
            say(f"\n{name}: {'good' if record.good else 'WRONG'}")
            say_findings(record.findings)


class AtTheTerminal:
    """``appliance.bringup.person.Person`` at a terminal, or a program in the place of one."""

    def __init__(self, answers: TextIO, lines: TextIO) -> None:
        self._answers, self._lines = answers, lines

    def tell(self, what: str) -> None:
        """Say it, in a line that begins with ``DO:``."""
        self._lines.write(f"DO: {what}\n")
        self._lines.flush()

    def ask(self, what: str) -> None:
        """Say it, and wait for an Enter. Raises GivenUp at the end of the input, or after an hour."""
        from appliance.bringup.person import GivenUp

        self.tell(f"{what}; then press Enter")
        answer = _line(self._answers, ANSWERED_WITHIN_S)
        if answer is None:
            raise GivenUp(f"nobody answered within {ANSWERED_WITHIN_S / 60.0:g} minutes; call again to go on here")
        if not answer.endswith("\n"):
            raise GivenUp("the input ended; call again to go on here")


def _line(stream: TextIO, timeout_s: float) -> str | None:
    """Return the next line, without an end where the input ended; ``None``: none came in time."""
    try:
        descriptor = stream.fileno()
    except UnsupportedOperation:  # no file behind it: whatever is in it can be read at once
        return stream.readline()
    # Byte by byte, past the stream's buffer: lines that wait in there would be seen by nobody who asks the kernel.
    found = b""
    while not found.endswith(b"\n"):
        if not select.select([descriptor], [], [], timeout_s)[0]:
            return None
        byte = os.read(descriptor, 1)
        if not byte:
            break
        found += byte
    return found.decode(errors="replace")


def report_of(walked: Walked) -> dict[str, Any]:
    """Return what came of a call, JSON-ready."""
    return {
        "good": walked.good,
        "steps": [
            {"name": name, "good": one.good, "findings": [finding.as_dict() for finding in one.findings]}
            for name, one in walked.steps.items()
        ],
        "done": list(walked.done),
        "stopped": walked.stopped,
        "written": [str(path) for path in walked.written],
    }


def _end(walked: Walked, folder: Path) -> str:
    good = sum(one.good for one in walked.steps.values())
    if walked.good and good == 12:
        return (
            f"\nall twelve steps are good; the page is {folder / 'bringup.html'}; next: calibrate (docs/calibration.md)"
        )
    return f"\n{good} of 12 steps are good; the page to send to somebody who helps is {folder / 'bringup.html'}"
