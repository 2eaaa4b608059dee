"""The verb ``report``: one page about a dive, a table of reprocessed scans, or an object."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operands, path_option
from appliance.cli.desk import WithObjects, check_page, object_name, write_files, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError

TABLE = ".csv"


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeReport(WithObjects):
    """Write one self-contained page about a dive, a table or an object.

    The page of a dive has verdicts, figures and a picture of each scan.
    """

    what: tuple[str, ...] = operands(
        "WHAT",
        "scans of a dive by their numbers (default: all that were kept), the table.csv of `kingfisher archive "
        "reprocess`, or object:NAME",
        at_least_one=False,
    )
    out: Path | None = path_option("--out", "the page, .html (default: dive.html, season.html or NAME.html here)")

    def run(self) -> Exit:
        """Write the page. Raises UnknownScan, UsageError, ResultsError, ObjectError, StorageError."""
        name = next((name for name in map(object_name, self.what) if name is not None), None)
        table = name is None and any(Path(word).suffix.lower() == TABLE for word in self.what)
        if len(self.what) > 1 and (name is not None or table):
            raise UsageError(f"{' '.join(self.what)}: give scans, or one table, or one object")
        out = self.out or Path(f"{name or ('season' if table else 'dive')}.html")
        check_page(out)
        if name is not None:
            return self._of_object(name, out)
        return self._of_table(Path(self.what[0]), out) if table else self._of_dive(out)

    def _of_dive(self, out: Path) -> Exit:
        from appliance.store import Library

        root = self.existing_root()
        library = Library(root)
        # In the order in which they were typed, else in that of their numbers.
        entries = [library.entry(scan) for scan in self.what] or library.entries()
        if not entries:
            raise UsageError(
                f"--root {root}: holds no scans; give the storage root of a dive, the folder that holds scans/"
            )
        from appliance.desk import report_of_dive, write_report

        with ProgressLine() as progress:
            report = report_of_dive(root, entries, progress)
            with writing(out):
                write_report(out, report)
        scans = [{"scan": scan.name, "verdict": scan.word} for scan in report.scans]
        lines = [*(f"warning: {line}" for line in report.warnings), f"{out}: {report.subtitle}"]
        self.tell({"file": str(out), "scans": scans, "warnings": list(report.warnings)}, lines)
        return Exit.OK

    def _of_table(self, table: Path, out: Path) -> Exit:
        from appliance.desk import page_of_table

        page, count = page_of_table(table)
        write_files({out: page.encode()})
        self.tell({"page": str(out), "scans": count}, [f"{out}  {count} scans"])
        return Exit.OK

    def _of_object(self, name: str, out: Path) -> Exit:
        options = self.scan_options()
        root, solved = self.solved(options, name)
        from appliance.base import require

        require("plotly", "plotly", "a page with a surface that can be turned")
        compile_kernels()
        from appliance.desk import report_of_object, write_report

        with ProgressLine() as progress:
            report = report_of_object(root, solved, options, progress, self.spacing)
            with writing(out):
                write_report(out, report)
        self.tell({"object": solved.name, "files": [str(out)]}, [str(out)])
        return Exit.OK
