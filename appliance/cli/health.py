"""Owns the verbs ``health show`` and ``health accept``: how the ray gaps have behaved, and the answer to an alarm."""

from __future__ import annotations

import json as json_form
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from appliance.cli.arguments import number_above, operand, option
from appliance.cli.output import Exit, UsageError, say, say_json, table
from appliance.cli.places import WithRoot

if TYPE_CHECKING:  # imported in the verbs, after what a wrong word needs
    from appliance.calibrate import HealthTrend
    from appliance.measure import Calibration
    from appliance.store import Rig

SHOWN = 20
"""Latest scans in the table; ``--json`` has all that are remembered."""
AT_MOST_PERCENT = 0.1
"""Length error up to which a check is accepted, unless the option says otherwise."""
MAX_BYTES = 64_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowHealth(WithRoot):
    """The trend of the calibration in use."""

    kernels: ClassVar[bool] = False

    def run(self) -> Exit:
        """Raises CalibrationError where there is none."""
        rig = self.rooted_rig()
        calibration = _in_use(rig)
        from appliance.calibrate import LEARNT_SCANS, UNMEASURED, HealthFile
        from appliance.measure import MODES

        trend = HealthFile(rig.storage.root, calibration.hash).read()
        measured = calibration.method not in UNMEASURED
        taught = len(trend.reference.rests_um)
        if self.json:
            say_json(
                {
                    "calibration": calibration.hash,
                    "method": calibration.method,
                    "measured": measured,
                    "judged": trend.judged,
                    "alarm": trend.alarm,
                    "answers": list(trend.answers),
                    "reference_scans": taught,
                    "overlaps": [
                        {
                            "object": one.object,
                            "scans": one.scans,
                            "bend_um": one.bend_um,
                            "sigma_um": one.sigma_um,
                            "score": one.score,
                            "alarm": one.alarm,
                        }
                        for one in trend.overlaps
                    ],
                    "scans": [
                        {
                            "scan": point.scan,
                            **{f"{name}_um": value for name, value in zip(MODES, point.amplitudes_um, strict=True)},
                            **{f"{name}_sigma_um": value for name, value in zip(MODES, point.sigma_um, strict=True)},
                            "rest_um": point.rest_um,
                            "score": point.score,
                            "sum": point.total,
                            "alarm": point.alarm,
                        }
                        for point in trend.points
                    ],
                }
            )
            return Exit.OK
        if not measured:
            say(f"uncalibrated: the calibration in use ({calibration.method}) was never measured in water; no trend")
            return Exit.OK
        say(f"calibration {calibration.hash[:16]}, {calibration.method}; {trend.judged} scans judged")
        say(f"reference   {taught} of {LEARNT_SCANS} scans")
        say(f"alarm       {trend.alarm or 'none'}")
        for answer in trend.answers:
            say(f"accepted    {answer}")
        for one in trend.overlaps:
            say(
                f"overlaps    object {one.object}, {one.scans} scans: bent by {one.bend_um:.0f} ± {one.sigma_um:.0f} µm, score {one.score:.1f}"
                f"{'  ALARM' if one.alarm else ''}"
            )
        if trend.points:
            say(_points(trend))
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptHealth(WithRoot):
    """Take an alarm back, as the length check in ``report`` (of ``kingfisher evaluate``) found the lengths right."""

    kernels: ClassVar[bool] = False

    report: Path = operand("REPORT", "the .json that `kingfisher evaluate` wrote", parse=Path)
    at_most_percent: float = option(
        "--at-most-percent",
        f"largest length error that is accepted (default: {AT_MOST_PERCENT:g})",
        default=AT_MOST_PERCENT,
        parse=number_above(0.0, 10.0),
        metavar="E_L",
    )

    def run(self) -> Exit:
        """Raises UsageError for a report that does not show that, StorageError while the service runs."""
        rig = self.rooted_rig()
        root = rig.storage.root
        calibration = _in_use(rig)
        content = _content(self.report, calibration.hash)
        worst = _worst_percent(self.report, content)
        if worst > self.at_most_percent:
            raise UsageError(
                f"REPORT {self.report}: largest E_L of the ball bar is {worst:.3f} %; allowed are up to {self.at_most_percent:g} %: "
                "calibrate again, or state another limit with --at-most-percent"
            )
        from appliance.calibrate import HealthFile, answered
        from appliance.store import hold_lock

        # The running service keeps the trend in memory and would write it over this answer.
        with hold_lock(root):
            file = HealthFile(root, calibration.hash)
            trend = file.read()
            if trend.alarm is None:
                raise UsageError(f"REPORT {self.report}: there is no alarm to be taken back; nothing was changed")
            # Under the lock: the alarm that is answered is the one that stands now.
            _recorded_since(self.report, content, trend)
            said = f"{self.report.name}: largest E_L of the ball bar {worst:.3f} %, after: {trend.alarm}"
            file.write(answered(trend, said))
        if self.json:
            say_json({"accepted": said})
        else:
            say(f"accepted: {said}")
        return Exit.OK


def _in_use(rig: Rig) -> Calibration:
    from appliance.store import CALIBRATIONS, CURRENT_CALIBRATION, load_calibration

    return load_calibration(rig.storage.root / CALIBRATIONS / CURRENT_CALIBRATION)


def _content(report: Path, calibration_hash: str) -> dict[str, Any]:
    wanted = "give the .json that `kingfisher evaluate` wrote"
    try:
        with report.open("rb") as file:
            content: dict[str, Any] = json_form.loads(file.read(MAX_BYTES))
        used = content["about"]["calibration"]
        # Read and thrown away: what is missing is found here, under this error, and not by whoever needs it later.
        content["summary"]["e_l_ball_bar_percent"], [(one["scan"], one["artefact"]) for one in content["scans"]]
    except OSError as error:
        raise UsageError(f"REPORT {report}: cannot be read ({error.strerror}); {wanted}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"REPORT {report}: is no report of an evaluation; {wanted}") from error
    # A length that is right with another calibration says nothing about the one the alarm is about.
    if used != calibration_hash:
        raise UsageError(f"REPORT {report}: it was made with calibration {used!s:.16}; evaluate with the one in use")
    return content


def _worst_percent(report: Path, content: dict[str, Any]) -> float:
    worst = content["summary"]["e_l_ball_bar_percent"]
    # JSON's true is a bool, which Python counts among the integers: it would pass as an error of 1 %.
    if isinstance(worst, bool) or not isinstance(worst, int | float) or content.get("complete") is not True:
        raise UsageError(f"REPORT {report}: no ball bar was measured in it; scan the ball bar and evaluate again")
    return float(worst)


def _recorded_since(report: Path, content: dict[str, Any], trend: HealthTrend) -> None:
    """Raise UsageError for lengths of before the alarm: they say nothing about the instrument of now."""
    from appliance.measure import Artefact

    # Scans are numbered in the order of recording, and the clock may be wrong: before and after go by the number.
    first = next((point.scan for point in trend.points if point.alarm and point.scan is not None), None)
    bars = [str(one["scan"]) for one in content["scans"] if one["artefact"] == Artefact.BALL_BAR.value]
    old = [scan for scan in bars if first is not None and not (scan.isdigit() and int(scan) >= int(first))]
    if old:
        raise UsageError(
            f"REPORT {report}: scan {', '.join(old)} was recorded before the alarm of scan {first}; scan the ball bar "
            "again and evaluate that"
        )


def _points(trend: HealthTrend) -> str:
    from appliance.measure import MODES

    rows = []
    for point in trend.points[-SHOWN:]:
        amplitudes = [
            f"{value:+.1f} ± {sigma:.1f}" for value, sigma in zip(point.amplitudes_um, point.sigma_um, strict=True)
        ]
        last = f"{point.total:.1f}{'  ALARM' if point.alarm else ''}"
        rows.append((point.scan or "?", *amplitudes, f"{point.rest_um:.1f}", f"{point.score:.1f}", last))
    return table(("SCAN", *(f"{name} µm" for name in MODES), "rest µm", "score", "sum"), rows)
