"""Owns the verb ``evaluate``: artefacts in stored scans, measured and written down as a page and as JSON."""

from __future__ import annotations

import json as json_form
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appliance.cli.arguments import operand, option
from appliance.cli.desk import measuring, place_of, scan_in, whole_scan, writable, writable_page, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, Progress, UsageError, say, say_json, table
from appliance.cli.places import WithCalibration
from appliance.store import LocalFileSystem, replace_file

DEFAULT_OUT = Path("evaluation.html")
SCANS_CHECKED = 0.1
"""The part of the progress that comparing checksums gets."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluate(WithCalibration):
    """Measure every artefact of the list; FAILED if one was not found, after the report was written all the same."""

    list: Path = operand("LIST", "which artefact each scan shows (TOML or JSON)", parse=Path)
    out: Path | None = option("--out", "the page, and beside it FILE with .json", parse=Path, metavar="FILE")

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
        measuring(wish.calibration)
        from appliance.store import read_list, refuse_repeats

        scans = read_list(self.list)
        # A wrong number is told before minutes of compiling, and of comparing checksums.
        folders = [scan_in(wish, place_of(self.list, entry.scan)) for entry in scans.entries]
        refuse_repeats(self.list, scans.entries, folders)
        compile_kernels()
        from appliance.desk import run_evaluation
        from appliance.measure import as_html, as_json
        from appliance.store import instrument_of, one_calibration, open_source

        with Progress() as progress:
            sources = []
            for k, entry in enumerate(scans.entries):
                progress(f"comparing checksums of {entry.scan}", SCANS_CHECKED * k / len(scans.entries))
                sources.append(open_source(whole_scan(wish, place_of(self.list, entry.scan)), wish))

            def step(what: str, part: float) -> None:
                progress(what, SCANS_CHECKED + (1.0 - SCANS_CHECKED) * part)

            instrument_of(sources, wish)  # refuses two
            evaluation = run_evaluation(scans, sources, one_calibration(sources, wish).calibration, step)
        content = as_json(evaluation)
        text = json_form.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        for path, written in ((page, as_html(evaluation)), (data, text)):
            with writing(path):
                replace_file(LocalFileSystem(), path, written.encode())
        if self.json:
            say_json(content)
        else:
            _tell(content, page)
        # The report is there either way; a program that only looks at the code must not take a missing artefact for a
        # good one.
        return Exit.OK if evaluation.complete else Exit.FAILED


def _tell(content: dict[str, Any], page: Path) -> None:
    for scan in content["scans"]:
        if scan["reason"] is not None:
            say(f"{scan['scan']}  {scan['artefact']}: {scan['reason']}")
    measured = [(scan["scan"], q) for scan in content["scans"] for q in scan["quantities"]]
    if measured:
        columns = ("SCAN", "QUANTITY", "OF", "VALUE mm", "U (k=2) mm", "LIMIT mm", "POINTS", "")
        say(table(columns, [(scan, *_row(quantity)) for scan, quantity in measured]))
    for key, value in content["summary"].items():
        say(f"{key:<24} {'-' if value is None else f'{value:.4f}'}")
    say(f"{'limits':<24} {content['limits_kept']}")
    say(f"{'report':<24} {page}")


def _row(quantity: dict[str, Any]) -> tuple[str, ...]:
    lengths = (quantity[name] for name in ("value_mm", "expanded_uncertainty_mm", "limit_mm"))
    shown = ("-" if value is None else f"{value:.4f}" for value in lengths)
    return (quantity["quantity"], quantity["of"], *shown, str(quantity["points"]), quantity["kept"])
