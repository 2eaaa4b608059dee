"""The verbs ``calibration show``, ``use`` and ``accept``: calibrations, their health, and the end of an alarm."""

from __future__ import annotations

import json as json_form
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from appliance.cli.arguments import number_above, operand, path_option
from appliance.cli.desk import check_writable, write_files
from appliance.cli.output import Exit, UsageError, say_report, table
from appliance.cli.places import WithRoot
from appliance.store import CALIBRATION_FILE, hold_lock

if TYPE_CHECKING:  # imported in the verbs, because a wrong word does not need it
    from appliance.calibrate import HealthTrend, ThirdEye, TrendPoint
    from appliance.measure import Calibration
    from appliance.store import Rig

NOMINAL = "nominal"
SHOWN = 20
"""Number of latest scans in the table; ``--json`` has all of the trend."""
AT_MOST_PERCENT = 0.1
"""Largest length error that is accepted by default."""
MAX_BYTES = 64_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowCalibration(WithRoot):
    """Show the calibration in use, that of a file, or the nominal one of the rig file, and whether it still holds."""

    file: str | None = operand(
        "FILE", f"a calibration file, or {NOMINAL} for that of the design (default: the one in use)", optional=True
    )
    out: Path | None = path_option("--out", "write it to a file, which is never replaced")

    def run(self) -> Exit:
        rig = self.rooted_rig()
        check_writable(self.out)
        if self.out is not None and self.out.exists():
            raise UsageError(f"--out {self.out}: exists already; a calibration is never replaced; give a new name")
        calibration = self._calibration(rig)
        if self.out is not None:
            from appliance.measure import encode_calibration

            write_files({self.out: encode_calibration(calibration)})
            self.tell({"file": str(self.out)}, [str(self.out)])
            return Exit.OK
        from appliance.calibrate import HealthFile, describe_calibration, third_eye_file

        content = describe_calibration(calibration)
        trend = HealthFile(rig.storage.root, calibration.hash).read()
        eye = third_eye_file(rig.storage.root, calibration.hash).read()
        if self.json:
            self.tell({**content, "health": _health(calibration, trend, eye)})
        else:
            say_report(content)
            self.tell(None, ["", *_health_lines(calibration, trend, eye)])
        return Exit.OK

    def _calibration(self, rig: Rig) -> Calibration:
        from appliance.store import Instrument, load_calibration

        if self.file is not None:
            return Instrument(rig).design() if self.file == NOMINAL else load_calibration(Path(self.file))
        root = self.named_root()
        if root is not None and self.rig is None:
            # A named root means the calibration below it, also of another instrument than that of the packaged rig
            # file.
            return load_calibration(root / CALIBRATION_FILE)
        return Instrument(rig).calibration()[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class UseCalibration(WithRoot):
    """Put an earlier calibration, or that of a file, in use.

    The former one is kept, so that the same verb undoes it.
    """

    kernels: ClassVar[bool] = False

    name: str | None = operand(
        "NAME", "a file of calibration/kept; with a slash, any file (default: the last one kept)", optional=True
    )

    def run(self) -> Exit:
        rig = self.rooted_rig()
        from appliance.calibrate import Calibrations, SessionError
        from appliance.measure import IN_AIR
        from appliance.store import load_calibration

        root, today = rig.storage.root, datetime.now(UTC).date().isoformat()
        calibrations = Calibrations(root, rig.rig.serial)
        if self.name is not None and "/" in self.name:
            path = Path(self.name)
            calibration = load_calibration(path)
            if calibration.rig_serial != rig.rig.serial or calibration.method == IN_AIR:
                raise UsageError(
                    f"NAME {path}: is of instrument {calibration.rig_serial}, method {calibration.method}; allowed are "
                    "water calibrations "
                    f"of {rig.rig.serial}"
                )
            with hold_lock(root):
                calibrations.install(calibration, today)
        else:
            with hold_lock(root):
                try:
                    path = calibrations.bring_back(self.name, today)
                except SessionError as error:
                    raise UsageError(f"calibration use: {error}") from error
            calibration = load_calibration(path)
        self.tell(
            {
                "file": str(path),
                "calibration": calibration.hash,
                "method": calibration.method,
                "made_at": calibration.made_at,
            },
            [f"in use: {path}, {calibration.method}, made {calibration.made_at}"],
        )
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptHealth(WithRoot):
    """End an alarm after the length check in REPORT found the lengths right."""

    kernels: ClassVar[bool] = False

    report: Path = operand("REPORT", "the .json that `kingfisher evaluate` wrote", parse=Path)
    at_most_percent: float | None = operand(
        "PERCENT",
        f"largest length error that is accepted (default: {AT_MOST_PERCENT:g})",
        parse=number_above(0.0, 10.0),
        optional=True,
    )

    def run(self) -> Exit:
        """End the alarm. Raises UsageError for a report that does not show it, StorageError while the service runs."""
        rig = self.rooted_rig()
        root = rig.storage.root
        from appliance.store import load_calibration

        calibration = load_calibration(root / CALIBRATION_FILE)
        content = _content(self.report, calibration.hash)
        worst, at_most = _worst_percent(self.report, content), self.at_most_percent or AT_MOST_PERCENT
        if worst > at_most:
            raise UsageError(
                f"REPORT {self.report}: largest E_L of the ball bar is {worst:.3f} %; allowed are up to {at_most:g} %: "
                "calibrate again, or state another limit after REPORT"
            )
        from appliance.calibrate import HealthFile, accept_change

        # The running service keeps the trend in memory and would write it over this answer.
        with hold_lock(root):
            file = HealthFile(root, calibration.hash)
            trend = file.read()
            if trend.alarm is None:
                raise UsageError(f"REPORT {self.report}: no alarm to withdraw; nothing was changed")
            # Under the lock: the alarm that is answered is the one that stands now.
            _recorded_since(self.report, content, trend)
            answer = f"{self.report.name}: largest E_L of the ball bar {worst:.3f} %, after: {trend.alarm}"
            file.write(accept_change(trend, answer))
        self.tell({"accepted": answer}, [f"accepted: {answer}"])
        return Exit.OK


def _health(calibration: Calibration, trend: HealthTrend, eye: ThirdEye) -> dict[str, Any]:
    """Return the trend of the ray gaps since the calibration was put in use, JSON-ready."""
    from appliance.calibrate import UNMEASURED
    from appliance.measure import MODES

    return {
        "calibration": calibration.hash,
        "method": calibration.method,
        "measured": calibration.method not in UNMEASURED,
        "judged": trend.judged,
        "alarm": trend.alarm,
        "answers": list(trend.answers),
        "reference_scans": len(trend.reference.rests_um),
        **({} if eye.misfit_px is None else {"projector": {"hash": eye.hash, "misfit_px": eye.misfit_px}}),
        "overlaps": [{**asdict(news), "alarm": news.alarm} for news in trend.overlaps],
        "scans": [
            {
                "scan": point.scan,
                **{f"{name}_um": value for name, value in zip(MODES, point.amplitudes_um, strict=True)},
                **{f"{name}_sigma_um": value for name, value in zip(MODES, point.sigma_um, strict=True)},
                **_third(point),
                "rest_um": point.rest_um,
                "score": point.score,
                "sum": point.total,
                "alarm": point.alarm,
            }
            for point in trend.points
        ],
    }


def _third(point: TrendPoint) -> dict[str, float]:
    from appliance.calibrate import THIRD_MODES

    if point.third_um is None or point.third_sigma_um is None:
        return {}
    amplitudes: dict[str, float] = {}
    for name, value, sigma in zip(THIRD_MODES, point.third_um, point.third_sigma_um, strict=True):
        amplitudes |= {f"{name}_um": value, f"{name}_sigma_um": sigma}
    return amplitudes


def _health_lines(calibration: Calibration, trend: HealthTrend, eye: ThirdEye) -> list[str]:
    from appliance.calibrate import FITTED_SCANS, LEARNT_SCANS, UNMEASURED

    if calibration.method in UNMEASURED:
        return [f"uncalibrated: this calibration ({calibration.method}) is not one in water; there is no trend"]
    return [
        f"whether it still holds: {trend.judged} scans judged",
        f"reference   {len(trend.reference.rests_um)} of {LEARNT_SCANS} scans",
        f"projector   {len(eye.scans)} of {FITTED_SCANS} scans"
        if eye.misfit_px is None
        else f"projector   fitted to {FITTED_SCANS} scans, misfit {eye.misfit_px:.2f} px",
        f"alarm       {trend.alarm or 'none'}",
        *(f"accepted    {answer}" for answer in trend.answers),
        *(
            f"overlaps    object {news.object}, {news.scans} scans: bent by {news.bend_um:.0f} ± {news.sigma_um:.0f} "
            "µm, "
            f"score {news.score:.1f}{'  ALARM' if news.alarm else ''}"
            for news in trend.overlaps
        ),
        *([_points(trend)] if trend.points else []),
    ]


def _content(report: Path, calibration_hash: str) -> dict[str, Any]:
    remedy = "give the .json that `kingfisher evaluate` wrote"
    try:
        with report.open("rb") as file:
            content: dict[str, Any] = json_form.loads(file.read(MAX_BYTES))
        calibration_used = content["about"]["calibration"]
        # Evaluated only to find missing values here, with this error, instead of later.
        content["summary"]["e_l_ball_bar_percent"], [(scan["scan"], scan["artefact"]) for scan in content["scans"]]
    except OSError as error:
        raise UsageError(f"REPORT {report}: cannot be read ({error.strerror}); {remedy}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"REPORT {report}: is no report of an evaluation; {remedy}") from error
    # A length that is right with another calibration says nothing about the one with the alarm.
    if calibration_used != calibration_hash:
        raise UsageError(
            f"REPORT {report}: is made with calibration {calibration_used!s:.16}; evaluate with the one in use"
        )
    return content


def _worst_percent(report: Path, content: dict[str, Any]) -> float:
    worst = content["summary"]["e_l_ball_bar_percent"]
    # JSON's true is a bool, which Python counts as an integer: it would pass as an error of 1 %.
    if isinstance(worst, bool) or not isinstance(worst, int | float) or content.get("complete") is not True:
        raise UsageError(f"REPORT {report}: has no ball bar; scan the ball bar and evaluate again")
    return float(worst)


def _recorded_since(report: Path, content: dict[str, Any], trend: HealthTrend) -> None:
    """Raise UsageError for lengths that were recorded before the alarm, which do not show its present state."""
    from appliance.measure import Artefact

    # Scans are numbered in the order of recording, while the clock may be wrong: their order is that of the numbers.
    first = next((point.scan for point in trend.points if point.alarm and point.scan is not None), None)
    bars = [str(scan["scan"]) for scan in content["scans"] if scan["artefact"] == Artefact.BALL_BAR.value]
    old = [scan for scan in bars if first is not None and not (scan.isdigit() and int(scan) >= int(first))]
    if old:
        raise UsageError(
            f"REPORT {report}: scan {', '.join(old)} was recorded before the alarm of scan {first}; scan the ball bar "
            "again and evaluate that"
        )


def _points(trend: HealthTrend) -> str:
    from appliance.calibrate import THIRD_MODES
    from appliance.measure import MODES

    rows, shown = [], trend.points[-SHOWN:]
    names = (*MODES, *(THIRD_MODES if any(point.third_um is not None for point in shown) else ()))
    for point in shown:
        values = [*zip(point.amplitudes_um, point.sigma_um, strict=True)]
        values += zip(point.third_um or (), point.third_sigma_um or (), strict=True)
        amplitudes = [f"{value:+.1f} ± {sigma:.1f}" for value, sigma in values]
        amplitudes += ["-"] * (len(names) - len(values))
        last = f"{point.total:.1f}{'  ALARM' if point.alarm else ''}"
        rows.append((point.scan or "?", *amplitudes, f"{point.rest_um:.1f}", f"{point.score:.1f}", last))
    return table(("SCAN", *(f"{name} µm" for name in names), "rest µm", "score", "sum"), rows)
