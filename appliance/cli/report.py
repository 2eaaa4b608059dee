"""Owns the verb ``report``: one page about the scans of a dive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operands, option
from appliance.cli.desk import writable_page, writing
from appliance.cli.output import Exit, Progress, UsageError, say, say_json
from appliance.cli.places import WithRoot


@dataclass(frozen=True, slots=True, kw_only=True)
class DiveReport(WithRoot):
    """One page about the scans of a dive: verdicts, figures and a picture of each; it asks for nothing from outside. No scans: all."""

    scans: tuple[str, ...] = operands("SCAN", "their numbers (default: all that were kept)", at_least_one=False)
    out: Path | None = option("--out", "the page, .html (default: dive.html here)", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        """Raises UnknownScan, UsageError, StorageError."""
        out = self.out or Path("dive.html")
        writable_page(out)
        from appliance.store import Library

        root = self.existing_root()
        library = Library(root)
        # In the order in which they were typed; without any, in that of their numbers.
        entries = [library.entry(scan) for scan in self.scans] or library.entries()
        if not entries:
            raise UsageError(
                f"--root {root}: holds no scans; give the storage root of a dive, the folder that holds scans/"
            )
        from appliance.desk import report_of_dive, write_report

        with Progress() as progress:
            report = report_of_dive(root, entries, progress)
            with writing(out):
                write_report(out, report)
        if self.json:
            words = {
                "file": str(out),
                "scans": [{"scan": one.name, "verdict": one.word} for one in report.scans],
            }
            say_json({**words, "warnings": list(report.warnings)})
            return Exit.OK
        for line in report.warnings:
            say(f"warning: {line}")
        say(f"{out}: {report.subtitle}")
        return Exit.OK
