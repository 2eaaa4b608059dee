"""Owns the verbs ``bringup``: what a new instrument measures of itself before its first scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import option, switch
from appliance.cli.desk import writing
from appliance.cli.output import Exit, Progress, UsageError, complain, say, say_json, table
from appliance.cli.places import WithRig
from appliance.storage.atomic import make_folders, replace_file
from appliance.storage.filesystem import LocalFileSystem

if TYPE_CHECKING:  # both bring OpenCV, which `--help` can do without
    from appliance.bringup.finding import Finding


@dataclass(frozen=True, slots=True, kw_only=True)
class BringupProjector(WithRig):
    """Measure the projector before a white wall with the instrument's own cameras, and write what follows into the rig file."""

    out: Path | None = option("--out", "folder for the page and its pictures", parse=Path, metavar="FOLDER")
    dry_run: bool = switch("--dry-run", "measure and report; leave the rig file as it is")

    def run(self) -> Exit:
        rig = self.read_rig()
        if self.rig is None and not self.dry_run:
            raise UsageError(
                "--rig: not given, and the packaged rig file is never changed; give the instrument's, or measure with --dry-run"
            )
        # Before minutes of measuring, not after them.
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise UsageError(f"--out {self.out}: is a file; give a folder, which is made if it is not there")
        from appliance.bringup.conclusions import conclusions, keys_of
        from appliance.bringup.finding import BringupError
        from appliance.bringup.page import PAGE, pictures_of, projector_page
        from appliance.bringup.projector import measure_projector
        from appliance.bringup.rig_edit import replace_rig, with_keys
        from appliance.service.light_bench import light_bench

        # Read before the long measurement, so that a file that cannot be edited is known by then.
        path = None if self.rig is None else self.rig
        text = "" if path is None else path.read_text(encoding="utf-8-sig")
        try:
            with Progress() as progress, light_bench(rig) as bench:
                measured = measure_projector(bench, rig.scan.most_gain_db, progress)
            findings = conclusions(measured, rig.projector.refresh_hz)
            good = all(one.ok for one in findings)
            keys = keys_of(measured, rig.projector.refresh_hz, rig.camera.left.exposure_ms) if good else {}
            changed = with_keys(text, keys) if keys and path is not None else text
        except BringupError as error:
            complain(str(error), as_json=self.json)
            return Exit.FAILED
        written: list[Path] = []
        if self.out is not None:
            pictures = pictures_of(measured, 1e6 / rig.projector.refresh_hz)
            written += write_page(self.out, PAGE, projector_page(findings, keys, measured, pictures), pictures)
        kept = None
        if keys and path is not None and not self.dry_run and changed != text:
            kept = replace_rig(path, text, changed)
        report = {
            "good": good,
            "findings": [one.as_dict() for one in findings],
            "light": {
                "latency_blanks": measured.timing.latency_blanks,
                "begins_us": measured.timing.begins_us,
                "ends_us": measured.timing.ends_us,
                "windows_us": [[one.begins_us, one.ends_us] for one in measured.timing.windows],
            },
            "keys": {f"{place.table}.{place.key}": value for place, value in keys.items()},
            "rig_file": str(path) if kept is not None else None,
            "before": None if kept is None else str(kept),
            "written": [str(one) for one in written],
        }
        if self.json:
            say_json(report)
        else:
            say_findings(findings)
            for place, value in keys.items():
                say(f"[{place.table}] {place.key} = {list(value) if isinstance(value, tuple) else value}")
            say(f"written into {path}; as it was: {kept}" if kept is not None else "the rig file was not changed")
        return Exit.OK if good else Exit.FAILED


@dataclass(frozen=True, slots=True, kw_only=True)
class BringupTrigger(WithRig):
    """Fire 64 triggers as the rig file says and count what board and cameras make of them; FAILED where anything is missing."""

    def run(self) -> Exit:
        rig = self.read_rig()
        from appliance.service.bringup.trigger import fired, trigger_findings
        from appliance.service.light_bench import light_bench

        with Progress() as progress, light_bench(rig) as bench:
            progress("firing")
            findings = trigger_findings(fired(bench, rig).ledger)
        if self.json:
            say_json([one.as_dict() for one in findings])
        else:
            say_findings(findings)
        return Exit.OK if all(one.ok for one in findings) else Exit.FAILED


def say_findings(findings: tuple[Finding, ...]) -> None:
    """Print findings as a table, and remedies below it."""
    say(table(("CHECK", "", "SEEN"), [(one.name, "ok" if one.ok else "WRONG", one.said) for one in findings]))
    for one in findings:
        if not one.ok:
            say(f"{one.name}: {one.remedy}" + (f" (allowed: {one.limits})" if one.limits else ""))


def write_page(folder: Path, name: str, page: str, pictures: dict[str, tuple[str, bytes]]) -> list[Path]:
    """Write a page and its pictures into a folder, which is made. Raises UsageError, StorageError."""
    files = {name: page.encode(), **{picture: data for picture, (_, data) in pictures.items()}}
    with writing(folder):
        make_folders(LocalFileSystem(), folder)
        for file, data in files.items():
            replace_file(LocalFileSystem(), folder / file, data)
    return [folder / file for file in files]
