"""The verbs ``setup guide``, ``measure`` and ``firmware``: a new instrument before its first scan."""

from __future__ import annotations

import os
import select
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from io import UnsupportedOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TextIO

from appliance.cli.arguments import number, operand, operands, option, path_option, switch
from appliance.cli.desk import check_new_folder, writing
from appliance.cli.output import Exit, ProgressLine, UsageError, complain, say, table
from appliance.cli.places import WithRig
from appliance.store import LocalFileSystem

if TYPE_CHECKING:  # these load OpenCV, which `--help` does not need
    from appliance.store import Rig
    from appliance.workshop import Finding, GuideResult, Part, StepRecord

ANSWERED_WITHIN_S = 3600.0
"""Timeout for an Enter; a later call continues at the same step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SetupGuide(WithRig):
    """Lead from a box of parts to the first plane in twelve checked steps.

    A second call continues where the first stopped.
    """

    out: Path | None = path_option("--out", "folder for state, page and images", metavar="FOLDER")
    steps: Sequence[str] = operands(
        "STEP",
        "run these steps only, also good ones (default: from the first step that is not good)",
        at_least_one=False,
    )
    endurance_minutes: float = option(
        "--endurance-minutes",
        "duration of the step endurance (default: %(default)g)",
        default=10.0,
        parse=number(0.02, 1440.0),
        metavar="MIN",
    )
    plane_mm: float | None = option(
        "--plane-mm",
        "distance of the white plane (default: the rig file's working distance)",
        parse=number(50.0, 3000.0),
        metavar="MM",
    )

    def run(self) -> Exit:
        if self.rig is None:
            raise UsageError("--rig: not given, and the packaged rig file is never changed; give the instrument's")
        if self.out is None:
            raise UsageError("--out: not given; give a folder for state, page and images")
        check_new_folder(self.out)
        self.read_rig()
        from appliance.workshop import STEPS, GuideOptions, walk

        names = [step.name for step in STEPS]
        for name in self.steps:
            if name not in names:
                raise UsageError(f"STEP {name}: no such step; allowed are {', '.join(names)}")
        options = GuideOptions(tuple(self.steps), self.endurance_minutes, self.plane_mm)
        with ProgressLine() as progress:
            walked = walk(self.rig, self.out, options, AtTheTerminal(sys.stdin, sys.stderr), progress, self._tell)
        # On stderr, because findings are results, but the reason for an early end is an error.
        if walked.stopped is not None:
            complain(walked.stopped, as_json=self.json)
        self.tell(report_of(walked), [_end(walked, self.out, len(names))])
        return Exit.OK if walked.good else Exit.FAILED

    def _tell(self, name: str, record: StepRecord) -> None:
        if not self.json:
            for line in (f"\n{name}: {'good' if record.good else 'WRONG'}", *lines_of(record.findings)):
                say(line)


@dataclass(frozen=True, slots=True, kw_only=True)
class SetupMeasure(WithRig):
    """Measure the projector with the instrument's own cameras, or fire 64 triggers; FAILED for any fault.

    The projector lights a white wall. Of the triggers, the frames by board and cameras are counted.
    """

    what: str = operand("WHAT", "projector or trigger", choices=("projector", "trigger"))
    out: Path | None = path_option("--out", "with projector: folder for the page and its images", metavar="FOLDER")
    install: bool = switch("--install", "with projector: write the measured values into the rig file")

    def run(self) -> Exit:
        rig = self.read_rig()
        if self.what == "projector":
            return self._projector(rig)
        if self.out is not None or self.install:
            raise UsageError("--out and --install: are for projector; leave them out")
        from appliance.workshop import measure_trigger

        with ProgressLine() as progress:
            progress("firing")
            findings = measure_trigger(rig)
        self.tell([finding.as_dict() for finding in findings], lines_of(findings))
        return Exit.OK if all(finding.ok for finding in findings) else Exit.FAILED

    def _projector(self, rig: Rig) -> Exit:
        path = self.rig
        if path is None and self.install:
            raise UsageError("--rig: not given, and the packaged rig file is never changed; give the instrument's")
        # Checked before minutes of measuring.
        if self.out is not None:
            check_new_folder(self.out)
        from appliance.workshop import projector_report, replace_rig

        # Read before the long measurement, so that an unreadable file is reported at once.
        text = "" if path is None else path.read_text(encoding="utf-8-sig")
        with ProgressLine() as progress:
            report_content = projector_report(rig, text, progress)
        good, timing, backup = all(finding.ok for finding in report_content.findings), report_content.timing, None
        written = [] if self.out is None else [self.out / name for name in report_content.files]
        if self.out is not None:
            with writing(self.out):
                LocalFileSystem().make_folders(self.out)
                for file, content in zip(written, report_content.files.values(), strict=True):
                    LocalFileSystem().replace_file(file, content)
        if path is not None and self.install and report_content.rig_text != text:
            backup = replace_rig(path, text, report_content.rig_text)
        report = {
            "good": good,
            "findings": [finding.as_dict() for finding in report_content.findings],
            "light": {
                "latency_blanks": timing.latency_blanks,
                "begins_us": timing.begins_us,
                "ends_us": timing.ends_us,
                "windows_us": [[window.begins_us, window.ends_us] for window in timing.windows],
            },
            "keys": {f"{place.table}.{place.key}": value for place, value in report_content.keys.items()},
            "rig_file": str(path) if backup is not None else None,
            "before": None if backup is None else str(backup),
            "written": [str(file) for file in written],
        }
        lines = [
            f"[{place.table}] {place.key} = {list(value) if isinstance(value, tuple) else value}"
            for place, value in report_content.keys.items()
        ]
        end = f"written into {path}; as it was: {backup}" if backup is not None else "the rig file was not changed"
        self.tell(report, [*lines_of(report_content.findings), *lines, end])
        return Exit.OK if good else Exit.FAILED


def lines_of(findings: Sequence[Finding]) -> list[str]:
    """Return findings as a table, with the remedies below it."""
    rows = [(finding.name, "ok" if finding.ok else "WRONG", finding.said) for finding in findings]
    return [
        table(("CHECK", "", "SEEN"), rows),
        *(
            f"{finding.name}: {finding.remedy}" + (f" (allowed: {finding.limits})" if finding.limits else "")
            for finding in findings
            if not finding.ok
        ),
    ]


class AtTheTerminal:
    """``appliance.workshop.step.Person`` at a terminal, or a program in their place."""

    def __init__(self, answers: TextIO, lines: TextIO) -> None:
        self._answers, self._lines = answers, lines

    def tell(self, what: str) -> None:
        """Print an instruction in a line that begins with ``DO:``."""
        self._lines.write(f"DO: {what}\n")
        self._lines.flush()

    def ask(self, what: str) -> None:
        """Print an instruction and wait for an Enter. Raises GivenUp at the end of the input, or after an hour."""
        from appliance.workshop import GivenUp

        self.tell(f"{what}; then press Enter")
        answer = _line(self._answers, ANSWERED_WITHIN_S)
        if answer is None:
            raise GivenUp(f"no answer within {ANSWERED_WITHIN_S / 60.0:g} minutes; call again to continue here")
        if not answer.endswith("\n"):
            raise GivenUp("the input ended; call again to continue here")


def _line(stream: TextIO, timeout_s: float) -> str | None:
    """Return the next line, without a line end at the end of the input; ``None`` if none came in time."""
    try:
        descriptor = stream.fileno()
    except UnsupportedOperation:  # not a file: all its content can be read at once
        return stream.readline()
    # Byte by byte, past the stream's buffer, because select() does not see lines that wait in there.
    line = b""
    while not line.endswith(b"\n"):
        if not select.select([descriptor], [], [], timeout_s)[0]:
            return None
        byte = os.read(descriptor, 1)
        if not byte:
            break
        line += byte
    return line.decode(errors="replace")


def report_of(walked: GuideResult) -> dict[str, Any]:
    """Return the result of a call, JSON-ready."""
    return {
        "good": walked.good,
        "steps": [
            {"name": name, "good": step.good, "findings": [finding.as_dict() for finding in step.findings]}
            for name, step in walked.steps.items()
        ],
        "done": list(walked.done),
        "stopped": walked.stopped,
        "written": [str(path) for path in walked.written],
    }


def _end(walked: GuideResult, folder: Path, count: int) -> str:
    good, page = sum(step.good for step in walked.steps.values()), folder / "bringup.html"
    if walked.good and good == count:
        return f"\nall {count} steps are good; the page is {page}; next: calibrate (docs/calibration.md)"
    return f"\n{good} of {count} steps are good; to ask for help, send the page {page}"


# ------------------------------------------------------------------------------------------ firmware


@dataclass(frozen=True, slots=True, kw_only=True)
class LayOutFirmware(WithRig):
    """Write the firmware files of the trigger board or the key pad for the instrument of a rig file.

    They contain its USB identity and the polarity of its vsync.
    """

    kernels: ClassVar[bool] = False

    part: Part = operand("PART", "board or keys", choices=("board", "keys"))
    out: Path | None = path_option("--out", "default: build/board or build/keys", metavar="FOLDER")

    def run(self) -> Exit:
        rig = self.read_rig()
        from appliance.workshop import commands, firmware_files, instrument_values

        folder = self.out or Path("build") / self.part
        files = firmware_files(self.part, rig)
        _check(folder, files)
        with writing(folder):
            _write(folder, files)
        values, typed = instrument_values(self.part, rig), commands(self.part, folder)
        lines = [f"{len(files)} files in {folder}; USB identity {values['VENDOR']:04x}:{values['PRODUCT']:04x}"]
        if "SYNC_RISES" in values:
            mode = f"{rig.projector.width_px}x{rig.projector.height_px} at {rig.projector.refresh_hz:g} Hz"
            lines.append(f"the sync of {mode} begins with a {'rising' if values['SYNC_RISES'] else 'falling'} edge")
        lines.append("with MicroPython on the module and SERVICE to ground:")
        self.tell(
            {"folder": str(folder), "files": sorted(files), "instrument": values, "commands": list(typed)},
            [*lines, *(f"    {command}" for command in typed)],
        )
        return Exit.OK


def _check(folder: Path, files: dict[str, bytes]) -> None:
    """Raise UsageError for a folder with files of another origin, because it is replaced as a whole."""
    check_new_folder(folder)
    existing = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}
    if strange := sorted(existing - files.keys()):
        raise UsageError(f"--out {folder}: has {strange[0]}, which is no file of this firmware; give an empty folder")


def _write(folder: Path, files: dict[str, bytes]) -> None:
    fs, draft = LocalFileSystem(), folder.with_name(f".{folder.name}.draft")
    shutil.rmtree(draft, ignore_errors=True)
    for name, content in files.items():
        fs.make_folders((draft / name).parent)
        fs.replace_file(draft / name, content)
    # As a whole or not at all, because a part of a firmware would be copied like a complete one.
    if folder.exists():
        old = folder.with_name(f".{folder.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        fs.move_folder(folder, old)
        fs.move_folder(draft, folder)
        shutil.rmtree(old)
    else:
        fs.move_folder(draft, folder)
