"""The verb ``evaluate``: artefacts in stored scans, measured and written down as a page and as JSON."""

from __future__ import annotations

import json as json_form
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appliance.base import part_of
from appliance.cli.arguments import operand, path_option
from appliance.cli.desk import opened_scans, place_of, scan_in, writable, writable_page, write_files
from appliance.cli.output import Exit, UsageError, table
from appliance.cli.places import WithCalibration

DEFAULT_OUT = Path("evaluation.html")
SCANS_CHECKED = 0.1
"""The part of the progress that comparing checksums gets."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluate(WithCalibration):
    """Measure every artefact of the list; FAILED if one was not found, after the report was written all the same."""

    list: Path = operand("LIST", "which artefact each scan shows (TOML or JSON)", parse=Path)
    out: Path | None = path_option("--out", "the page, and beside it FILE with .json")

    def run(self) -> Exit:
        wish = self.wish()
        page = self.out or DEFAULT_OUT
        data = page.with_suffix(".json")
        # `--out x.json` would be overwritten by the JSON that stands beside the page.
        if data == page:
            raise UsageError(
                f"--out {page}: the JSON is written beside the page; give the page's name, for example x.html"
            )
        if data.absolute() == self.list.absolute():
            raise UsageError(f"--out {page}: {data} is the list itself; give another name")
        writable_page(page)
        writable(data)
        from appliance.store import ScanList

        scans = ScanList.read(self.list)
        places = [place_of(self.list, entry.scan) for entry in scans.entries]
        scans.refuse_repeats(self.list, [scan_in(wish, place) for place in places])
        with opened_scans(wish, places, SCANS_CHECKED) as (sources, progress):
            from appliance.desk import run_evaluation
            from appliance.store import SourceScan

            step = part_of(progress, SCANS_CHECKED, 1.0)
            SourceScan.instrument_of(sources, wish)  # refuses two
            evaluation = run_evaluation(scans, sources, SourceScan.one_calibration(sources, wish).calibration, step)
        content = evaluation.as_json()
        text = json_form.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        write_files({page: evaluation.as_html().encode(), data: text.encode()})
        self.tell(content, _lines(content, page))
        # The report is there either way; a program that only looks at the code must not take a missing artefact for a
        # good one.
        return Exit.OK if evaluation.complete else Exit.FAILED


def _lines(content: dict[str, Any], page: Path) -> list[str]:
    lines = [
        f"{one['scan']}  {one['artefact']}: {one['reason']}" for one in content["scans"] if one["reason"] is not None
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
