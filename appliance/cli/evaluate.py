"""The verb ``evaluate``: measure artefacts in stored scans, and write a page and JSON."""

from __future__ import annotations

import json as json_form
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appliance.base import part_of
from appliance.cli.arguments import operand, path_option
from appliance.cli.desk import check_page, check_writable, find_scan, open_scans, scan_in_list, write_files
from appliance.cli.output import Exit, UsageError, table
from appliance.cli.places import WithCalibration

DEFAULT_OUT = Path("evaluation.html")
SCANS_CHECKED = 0.1
"""Share of the progress for comparing checksums."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluate(WithCalibration):
    """Measure every artefact of the list; FAILED if any is not found, with the report written all the same."""

    list: Path = operand("LIST", "the list of scans and their artefacts (TOML or JSON)", parse=Path)
    out: Path | None = path_option("--out", "the page; the JSON is written beside it as FILE with .json")

    def run(self) -> Exit:
        options = self.scan_options()
        page = self.out or DEFAULT_OUT
        data = page.with_suffix(".json")
        # `--out x.json` would be overwritten by the JSON beside the page.
        if data == page:
            raise UsageError(
                f"--out {page}: is the JSON, which is written beside the page; give the page's name, for example x.html"
            )
        if data.absolute() == self.list.absolute():
            raise UsageError(f"--out {page}: {data} is the list of scans; give another name")
        check_page(page)
        check_writable(data)
        from appliance.store import ScanList

        scans = ScanList.read(self.list)
        places = [scan_in_list(self.list, entry.scan) for entry in scans.entries]
        scans.refuse_repeats(self.list, [find_scan(options, place) for place in places])
        with open_scans(options, places, SCANS_CHECKED) as (sources, progress):
            from appliance.desk import run_evaluation
            from appliance.store import SourceScan

            step = part_of(progress, SCANS_CHECKED, 1.0)
            SourceScan.instrument_of(sources, options)  # refuses two
            evaluation = run_evaluation(scans, sources, SourceScan.one_calibration(sources, options).calibration, step)
        content = evaluation.as_json()
        text = json_form.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        write_files({page: evaluation.as_html().encode(), data: text.encode()})
        self.tell(content, _lines(content, page))
        # The report is written in any case. A program that reads only the exit code must not take a missing artefact
        # for a good one.
        return Exit.OK if evaluation.complete else Exit.FAILED


def _lines(content: dict[str, Any], page: Path) -> list[str]:
    lines = [
        f"{scan['scan']}  {scan['artefact']}: {scan['reason']}"
        for scan in content["scans"]
        if scan["reason"] is not None
    ]
    measured = [(scan["scan"], q) for scan in content["scans"] for q in scan["quantities"]]
    if measured:
        columns = ("SCAN", "QUANTITY", "OF", "VALUE mm", "U (k=2) mm", "LIMIT mm", "POINTS", "")
        lines.append(table(columns, [(scan, *_row(quantity)) for scan, quantity in measured]))
    for key, value in content["summary"].items():
        lines.append(f"{key:<24} {'-' if value is None else f'{value:.4f}'}")
    return [*lines, f"{'limits':<24} {content['limits_kept']}", f"{'report':<24} {page}"]


def _row(quantity: dict[str, Any]) -> tuple[str, ...]:
    lengths = (quantity[name] for name in ("value_mm", "expanded_uncertainty_mm", "limit_mm"))
    shown = ("-" if value is None else f"{value:.4f}" for value in lengths)
    return (quantity["quantity"], quantity["of"], *shown, str(quantity["points"]), quantity["kept"])
