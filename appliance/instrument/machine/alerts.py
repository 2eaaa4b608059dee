"""The diver's text for every fault, in each language: one row each in ``RULES``.

    Rule        a row: severity, effects of the fault, headline and action
    Alert       one message as it is shown, made of a row and a fault's numbers
    lasting     the faults that last until they end or are repaired

A headline has at most 16 characters (in German 21), an action at most 32; both are read under water, in grey. Tests
measure whether they fit. ``leading.py`` decides which alert leads.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from types import MappingProxyType
from typing import assert_never

from appliance.instrument.machine.states import Machine, NoticeKind
from appliance.instrument.machine.words import Language, Words
from appliance.measure import Fault, FaultCode
from drivers.api import Key


class Severity(IntEnum):
    """Severity, shown as dive computers show it: white, solid yellow, flashing red."""

    INFO = 0
    WARNING = 1
    CRITICAL = 2


@dataclass(frozen=True, slots=True)
class Alert:
    """One message as it is shown. ``detail`` is for the log and for a technician."""

    code: FaultCode
    severity: Severity
    headline: str
    action: str
    detail: str = ""
    device: str | None = None
    german: tuple[str, str] | None = None
    """Headline and action in German; ``None``: only English is known."""
    lasts: bool = False
    """True if it is shown while its cause lasts (a condition, a lost device, a stuck key), not until the next key."""
    passing: bool = False
    """Same as ``passing`` of ``Rule``."""
    is_acknowledged: bool = False
    """True if the diver has acknowledged it: only a small mark is left."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A row of the table. ``headline`` is used when all its numbers are known, else ``plain``."""

    severity: Severity
    headline: Words
    action: Words
    plain: Words | None = None
    exchanged: Words | None = None
    """Text that replaces ``action``, with the camera's name, if the fault names a camera."""
    blocks_scan: bool = False
    """True if SCAN is refused while it lasts."""
    stops_capture: bool = False
    """True if it ends a capture."""
    forbids_light: bool = False
    """True if neither projector nor lasers may shine while it lasts."""
    doubts_lengths: bool = False
    """True if, while it lasts, shapes are right but lengths may be wrong; a good scan is shown with that warning."""
    passing: bool = False
    """True if it comes and goes with the live image.

    It is shown in the title and as a mark with the remedy, never in full: nothing moves on the screen, and no key is
    needed.
    """
    worsens: Mapping[str, float] = field(default_factory=dict, hash=False)
    """Change of each number, with its sign, after which an acknowledged alert is shown in full again."""


_I, _W, _C = Severity.INFO, Severity.WARNING, Severity.CRITICAL
_INCOMPLETE = Words("INCOMPLETE {received:.0f}/{expected:.0f}", "UNVOLLSTÄNDIG {received:.0f}/{expected:.0f}")
_REPEAT = Words("REPEAT", "NOCHMAL")
# What a diver can do about anything inside of the housing; what to look at ashore is in
# `appliance.instrument.machine.alerts`.
_SWITCH = Words("OFF AND ON, OR END DIVE", "AUS/EIN ODER AUFSTIEG")
_RESTART = Words("REPEAT; IF AGAIN: OFF AND ON", "NOCHMAL; SONST EINMAL AUS/EIN")
_UNCOVER = Words("LIGHT COVERED? ELSE OFF AND ON", "LICHT VERDECKT? SONST AUS/EIN")
_SERVICE = Words("END DIVE, NEEDS SERVICE", "AUFTAUCHEN, SERVICE NÖTIG")

RULES: Mapping[FaultCode, Rule] = MappingProxyType(
    {
        FaultCode.FRAME_MISSING: Rule(_W, _INCOMPLETE, _REPEAT, Words("INCOMPLETE", "UNVOLLSTÄNDIG")),
        FaultCode.FRAME_REPEATED: Rule(_W, _INCOMPLETE, _REPEAT, Words("FRAME REPEATED", "BILD DOPPELT")),
        FaultCode.FRAME_ORDER: Rule(_W, _INCOMPLETE, _REPEAT, Words("FRAME ORDER", "BILDFOLGE FALSCH")),
        FaultCode.FRAME_TRUNCATED: Rule(_W, _INCOMPLETE, _REPEAT, Words("FRAME CUT SHORT", "BILD ABGESCHNITTEN")),
        FaultCode.FRAME_CORRUPT: Rule(_W, _INCOMPLETE, _REPEAT, Words("FRAME DAMAGED", "BILD BESCHÄDIGT")),
        FaultCode.CAMERA_TOO_SLOW: Rule(
            _W, Words("{side}CAM SLOW", "{side}KAMERA TRÄGE"), _SWITCH, Words("CAMERA SLOW", "KAMERA TRÄGE")
        ),
        FaultCode.CAMERA_SILENT: Rule(
            _W, Words("{side}CAM SILENT", "{side}KAMERA STUMM"), _RESTART, Words("CAMERA SILENT", "KAMERA STUMM")
        ),
        FaultCode.CAMERA_STUCK: Rule(
            _W, Words("{side}CAM STUCK", "{side}KAMERA HÄNGT"), _REPEAT, Words("CAMERA STUCK", "KAMERA HÄNGT")
        ),
        FaultCode.PATTERN_WRONG: Rule(_W, Words("WRONG PATTERN", "FALSCHES MUSTER"), _REPEAT),
        FaultCode.PICTURE_MIRRORED: Rule(
            _W,
            Words("{side}CAM MIRROR", "{side}GESPIEGELT"),
            _SERVICE,
            Words("PICTURE MIRRORED", "BILD GESPIEGELT"),
        ),
        FaultCode.SYNC_LOST: Rule(_W, Words("SYNC LOST", "SYNC VERLOREN"), _RESTART),
        FaultCode.LATE_FLIP: Rule(_W, Words("PROJECTOR LATE", "PROJEKTOR SPÄT"), _REPEAT),
        FaultCode.PROJECTOR_TIMING: Rule(_W, Words("PROJECTOR TIMING", "PROJEKTORTAKT"), _RESTART),
        FaultCode.PROJECTOR_DARK: Rule(_W, Words("PROJECTOR DARK", "PROJEKTOR DUNKEL"), _UNCOVER),
        FaultCode.PULSE_MISSING: Rule(
            _W,
            Words("PULSES {received:.0f}/{expected:.0f}", "PULSE {received:.0f}/{expected:.0f}"),
            _REPEAT,
            Words("PULSE MISSING", "PULS FEHLT"),
        ),
        FaultCode.CAPTURE_TIMEOUT: Rule(_W, Words("SCAN TIMED OUT", "SCAN ZU LANGSAM"), _REPEAT),
        FaultCode.MOVED: Rule(
            _W,
            Words("MOVED {shift_px:.1f} px", "BEWEGT {shift_px:.1f} px"),
            _REPEAT,
            Words("MOVED", "BEWEGT"),
        ),
        # The only INFO of the table: the diver need not act. If a part was lost, there is also PART_MISSING.
        FaultCode.COMPENSATED: Rule(
            _I,
            Words("MOTION CORRECTED", "BEWEGUNG BEHOBEN"),
            Words("POINTS ARE RIGHT: KEEP", "PUNKTE STIMMEN: BEHALTEN"),
        ),
        FaultCode.PART_MISSING: Rule(
            _W, Words("PART MISSING", "TEIL FEHLT"), Words("HOLD STILL, REPEAT", "STILL HALTEN, NOCHMAL")
        ),
        FaultCode.TOO_BRIGHT: Rule(
            _W, Words("TOO BRIGHT", "ZU HELL"), Words("SHORTEN EXPOSURE, REPEAT", "KÜRZER BELICHTEN, NOCHMAL")
        ),
        FaultCode.TOO_DARK: Rule(
            _W, Words("TOO DARK", "ZU DUNKEL"), Words("GO CLOSER OR LENGTHEN EXPOSURE", "NÄHER HERAN, LÄNGER BELICHTEN")
        ),
        FaultCode.WATER_DIRTY: Rule(
            _W,
            Words("SIGHT ONLY {sight_m:.1f} m", "SICHT NUR {sight_m:.1f} m"),
            Words("LET IT SETTLE OR GO CLOSER", "WARTEN ODER NÄHER HERAN"),
            Words("WATER DIRTY", "WASSER TRÜB"),
        ),
        FaultCode.SCAN_NEAR: Rule(
            _W,
            Words("NEAR {distance_mm:.0f} mm", "NAH {distance_mm:.0f} mm"),
            Words("BACK, REPEAT", "ZURÜCK, NOCHMAL"),
            Words("TOO NEAR", "ZU NAH"),
        ),
        FaultCode.SCAN_FAR: Rule(
            _W,
            Words("FAR {distance_mm:.0f} mm", "WEIT {distance_mm:.0f} mm"),
            Words("GO CLOSER, REPEAT", "NÄHER HERAN, NOCHMAL"),
            Words("TOO FAR", "ZU WEIT"),
        ),
        FaultCode.NOTHING_SEEN: Rule(
            _W,
            Words("NOTHING SEEN", "NICHTS ZU SEHEN"),
            Words("GO CLOSER; IS LIGHT COVERED?", "NÄHER HERAN; LICHT VERDECKT?"),
        ),
        FaultCode.SIDES_EXCHANGED: Rule(
            _W,
            Words("CAMERAS SWAPPED", "KAMERAS VERTAUSCHT"),
            _SERVICE,
        ),
        FaultCode.NOT_IN_WATER: Rule(
            _W, Words("NOT IN WATER?", "NICHT IM WASSER?"), Words("SCAN UNDER WATER ONLY", "NUR UNTER WASSER SCANNEN")
        ),
        FaultCode.SCAN_POOR: Rule(
            _W,
            Words("POOR, CAUSE ?", "SCHLECHT, WARUM?"),
            Words("GO CLOSER, HOLD STILL, REPEAT", "NÄHER, STILL HALTEN, NOCHMAL"),
        ),
        FaultCode.LIGHT_FLICKERS: Rule(
            _W,
            Words("LIGHT FLICKERS", "LICHT FLACKERT"),
            Words("SHADE OR MOVE AWAY, REPEAT", "ABSCHATTEN, WEG DAVON, NOCHMAL"),
        ),
        FaultCode.FRINGES_BENT: Rule(
            _W, Words("FRINGES BENT", "STREIFEN KRUMM"), Words("TRY ANOTHER EXPOSURE", "ANDERE BELICHTUNG")
        ),
        FaultCode.GREY_BENT: Rule(
            _W,
            Words("{side}CAM GAMMA", "{side}KAMERA GAMMA"),
            Words("GO ON; NEEDS SERVICE ASHORE", "WEITER; AN LAND ZUM SERVICE"),
            Words("CAMERA GAMMA", "KAMERA-GAMMA"),
        ),
        FaultCode.AMBIENT: Rule(
            _W,
            Words("TOO MUCH LIGHT", "ZU VIEL LICHT"),
            Words("TURN TORCHES AWAY, SHADE IT", "LAMPEN WEGDREHEN, ABSCHATTEN"),
        ),
        FaultCode.CAMERA_LOST: Rule(
            _W,
            Words("{side}CAM LOST", "{side}KAMERA FEHLT"),
            _SWITCH,
            Words("CAMERA LOST", "KAMERA FEHLT"),
            blocks_scan=True,
            stops_capture=True,
        ),
        FaultCode.CAMERA_SLOW_LINK: Rule(
            _W, Words("CAMERA LINK SLOW", "KAMERA LANGSAM"), _SWITCH, blocks_scan=True, stops_capture=True
        ),
        FaultCode.CAMERA_REFUSED: Rule(
            _W,
            Words("{side}CAM REFUSED", "{side}KAMERA GESTÖRT"),
            _SWITCH,
            Words("CAMERA REFUSED", "KAMERA GESTÖRT"),
            blocks_scan=True,
            stops_capture=True,
        ),
        FaultCode.PROJECTOR_LOST: Rule(
            _W, Words("PROJECTOR LOST", "PROJEKTOR FEHLT"), _SWITCH, blocks_scan=True, stops_capture=True
        ),
        FaultCode.DISPLAY_LOST: Rule(_W, Words("DISPLAY LOST", "ANZEIGE FEHLT"), _SWITCH),
        FaultCode.BOARD_LOST: Rule(
            _W, Words("BOARD LOST", "PLATINE FEHLT"), _SWITCH, blocks_scan=True, stops_capture=True
        ),
        # No `stops_capture`: a reset is an event, not a condition. `safety.board_reset` ends the recording by
        # itself.
        FaultCode.BOARD_RESET: Rule(
            _W,
            Words("BOARD RESET", "PLATINE NEU GESTARTET"),
            Words("REPEAT IF A SCAN WAS RUNNING", "LIEF EIN SCAN: NOCHMAL"),
        ),
        FaultCode.VSYNC_LOST: Rule(
            _W,
            Words("NO VIDEO SIGNAL", "KEIN VIDEOSIGNAL"),
            _SWITCH,
            blocks_scan=True,
            stops_capture=True,
        ),
        FaultCode.LASER_ON: Rule(
            _C,
            Words("LASER ON", "LASER AN"),
            Words("SCAN BLOCKED", "SCAN GESPERRT"),
            blocks_scan=True,
            stops_capture=True,
        ),
        FaultCode.LASER_FAILED: Rule(
            _W, Words("LASER OUT", "LASER FEHLT"), Words("DISTANCE FROM ONE DOT", "ABSTAND AUS EINEM PUNKT")
        ),
        FaultCode.KEYS_LOST: Rule(
            _W,
            Words("KEYS LOST", "TASTEN FEHLEN"),
            Words("WAIT, OR END DIVE", "WARTEN ODER AUFTAUCHEN"),
        ),
        FaultCode.KEY_STUCK: Rule(
            _W, Words("KEY STUCK", "TASTE KLEMMT"), Words("USE THE KEY WITH ITS LABEL", "BESCHRIFTETE TASTE NEHMEN")
        ),
        # These two precede a scan, and a second press overrides them; SCAN_NEAR and SCAN_FAR follow it, from its points.
        FaultCode.TOO_NEAR: Rule(
            _W,
            Words("NEAR {distance_mm:.0f} mm", "NAH {distance_mm:.0f} mm"),
            Words("BACK, OR SCAN AGAIN TO RECORD", "ZURÜCK, ODER NOCHMAL DRÜCKEN"),
            Words("TOO NEAR", "ZU NAH"),
        ),
        FaultCode.TOO_FAR: Rule(
            _W,
            Words("FAR {distance_mm:.0f} mm", "WEIT {distance_mm:.0f} mm"),
            Words("CLOSER, OR SCAN AGAIN TO RECORD", "NÄHER, ODER NOCHMAL DRÜCKEN"),
            Words("TOO FAR", "ZU WEIT"),
        ),
        FaultCode.AIM_LIGHT: Rule(
            _W,
            Words("TOO MUCH LIGHT", "ZU VIEL LICHT"),
            Words("TURN TORCHES AWAY, SHADE IT", "LAMPEN WEGDREHEN, ABSCHATTEN"),
            passing=True,
        ),
        FaultCode.AIM_DARK: Rule(
            _W,
            Words("TOO DARK TO SCAN", "ZU DUNKEL"),
            Words("GO CLOSER OR LENGTHEN EXPOSURE", "NÄHER HERAN, LÄNGER BELICHTEN"),
            passing=True,
        ),
        FaultCode.AIM_TURBID: Rule(
            _W,
            Words("WATER TOO TURBID", "WASSER ZU TRÜB"),
            Words("GO CLOSER OR LET IT SETTLE", "NÄHER HERAN ODER WARTEN"),
            passing=True,
        ),
        FaultCode.AIM_FAST: Rule(
            _W,
            Words("MOVING TOO FAST", "ZU UNRUHIG"),
            Words("HOLD STILL, THEN SCAN", "STILL HALTEN, DANN SCANNEN"),
            passing=True,
        ),
        FaultCode.STORAGE_FULL: Rule(
            _W,
            Words("STORAGE FULL", "SPEICHER VOLL"),
            Words("END DIVE, COPY SCANS ASHORE", "AUFTAUCHEN, SCANS KOPIEREN"),
            blocks_scan=True,
        ),
        FaultCode.DISK_READ_ONLY: Rule(
            _W,
            Words("DISK READ-ONLY", "SPEICHER NUR LESBAR"),
            Words("END DIVE, DISK NEEDS SERVICE", "AUFTAUCHEN, SPEICHER DEFEKT"),
            blocks_scan=True,
        ),
        FaultCode.DISK_REFUSES: Rule(
            _W,
            Words("DISK ERROR", "SPEICHERFEHLER"),
            Words("END DIVE, DISK NEEDS SERVICE", "AUFTAUCHEN, SPEICHER DEFEKT"),
            blocks_scan=True,
        ),
        # Critical, and yet it blocks nothing: the scan is still in memory, and OK or time tries again (`saving`).
        FaultCode.NOT_SAVED: Rule(
            _C, Words("NOT SAVED", "NICHT GESPEICHERT"), Words("TRY AGAIN OR REPEAT", "ERNEUT SPEICHERN ODER NOCHMAL")
        ),
        FaultCode.RESTARTED: Rule(
            _W,
            Words("RESTARTED", "NEU GESTARTET"),
            Words("GO ON; SAVED SCANS ARE THERE", "WEITER; GESPEICHERTES IST DA"),
        ),
        FaultCode.SCAN_RECOVERED: Rule(
            _W, Words("SCAN RECOVERED", "SCAN GERETTET"), Words("IT IS IN THE GALLERY", "ER IST IN DER GALERIE")
        ),
        FaultCode.UPDATE_UNDONE: Rule(
            _W,
            Words("UPDATE UNDONE", "UPDATE VERWORFEN"),
            Words("THE OLD VERSION GOES ON", "ALTE VERSION LÄUFT WEITER"),
        ),
        FaultCode.SETTINGS_LOST: Rule(
            _W, Words("SETTINGS LOST", "EINSTELLUNG VERLOREN"), Words("CHECK THEM IN THE MENU", "IM MENÜ PRÜFEN")
        ),
        FaultCode.UNCALIBRATED: Rule(
            _W,
            Words("UNCALIBRATED", "UNKALIBRIERT"),
            Words("LENGTHS NOT TRUSTED", "LÄNGEN NICHT VERLÄSSLICH"),
            doubts_lengths=True,
            exchanged=Words("{camera} EXCHANGED", "{camera} GETAUSCHT"),
        ),
        FaultCode.LENGTH_ERROR: Rule(
            _W,
            Words("LENGTH ERR {error_percent:.1f} %", "LÄNGENFEHLER {error_percent:.1f} %"),
            Words("CHECK WATER, THEN CALIBRATE", "WASSER PRÜFEN, KALIBRIEREN"),
            Words("LENGTH ERROR", "LÄNGENFEHLER"),
            doubts_lengths=True,
            worsens={"error_percent": 0.2},
        ),
        FaultCode.VERIFY_CALIBRATION: Rule(
            _W,
            Words("VERIFY CALIBR.", "KALIBRIERUNG PRÜFEN"),
            Words("CHECK WATER AND BALL BAR", "WASSER UND KUGELSTAB PRÜFEN"),
            doubts_lengths=True,
        ),
        FaultCode.RECONSTRUCTION_FAILED: Rule(
            _W,
            Words("PROCESS LATER", "SPÄTER RECHNEN"),
            Words("KEEP RAW FRAMES OR REPEAT", "ROHBILDER BEHALTEN ODER NOCHMAL"),
        ),
        FaultCode.WINDOW: Rule(
            _W,
            Words("{window_side}WINDOW?", "{window_side}FENSTER?"),
            Words("WIPE IT; FOG STAYS: END DIVE", "ABWISCHEN; BLEIBT ES: AUFTAUCHEN"),
            Words("WINDOW?", "FENSTER?"),
        ),
        FaultCode.WARM: Rule(
            _W,
            Words("WARM {temperature_c:.0f} °C", "WARM {temperature_c:.0f} °C"),
            Words("LET IT COOL SOON", "BALD ABKÜHLEN LASSEN"),
            Words("WARM", "WARM"),
            worsens={"temperature_c": 2.0},
        ),
        FaultCode.HOT: Rule(
            _C,
            Words("HOT {temperature_c:.0f} °C", "HEISS {temperature_c:.0f} °C"),
            Words("COOLING, SCAN BLOCKED", "KÜHLT AB, SCAN GESPERRT"),
            Words("HOT", "HEISS"),
            blocks_scan=True,
            forbids_light=True,
        ),
        FaultCode.TOO_HOT: Rule(
            _C,
            Words("TOO HOT {temperature_c:.0f}°C", "ZU HEISS {temperature_c:.0f} °C"),
            Words("SWITCHING OFF", "SCHALTET SICH AUS"),
            Words("TOO HOT", "ZU HEISS"),
            blocks_scan=True,
            forbids_light=True,
        ),
        # Neither forbids light nor blocks a scan: `thermal` rations the light, and `conditions` refuses when
        # none is left.
        FaultCode.TEMPERATURE_UNKNOWN: Rule(
            _W, Words("TEMP ?", "TEMPERATUR ?"), Words("LIGHT TIME IS LIMITED", "LICHTZEIT BEGRENZT")
        ),
        # Blocks new scans but stops none under way: a sequence takes 0.4 s, and a low supply is borne for longer
        # than that.
        FaultCode.SUPPLY_LOW: Rule(
            _W,
            Words("SUPPLY LOW {supply_v:.1f}V", "SPANNUNG NUR {supply_v:.1f} V"),
            Words("END DIVE", "TAUCHGANG BEENDEN"),
            Words("SUPPLY LOW", "SPANNUNG NIEDRIG"),
            blocks_scan=True,
            worsens={"supply_v": -0.3},
        ),
        FaultCode.LEAK: Rule(
            _C,
            Words("LEAK: ASCEND", "LECK: AUFTAUCHEN"),
            Words("LIGHT IS OFF, SCANS ARE SAFE", "LICHT IST AUS, SCANS SIND SICHER"),
            blocks_scan=True,
            forbids_light=True,
        ),
        FaultCode.INTERNAL: Rule(_W, Words("INTERNAL FAULT", "INTERNER FEHLER"), _RESTART),
    }
)

_REFUSED = Words("SCAN REFUSED", "SCAN ABGELEHNT")
"""The action of any fault that SCAN was refused for."""
_FAILED, _AGAIN = Words("SCAN FAILED", "SCAN MISSLUNGEN"), Words("{fault}: REPEAT", "{fault}: NOCHMAL")
"""The headline over any fault that ended a scan; its own goes into the action."""
_NOT_ADDED, _FIRST_KEPT = Words("NOT ADDED", "NICHT ERGÄNZT"), Words("{fault}: FIRST KEPT", "{fault}: ERSTER BLEIBT")
"""The same, of a second exposure."""
_CAMERAS = {
    "camera.left": Words("LEFT CAMERA", "LINKE KAMERA"),
    "camera.right": Words("RIGHT CAMERA", "RECHTE KAMERA"),
    "cameras": Words("CAMERAS", "KAMERAS"),
}
LONGEST: Mapping[Language, int] = MappingProxyType({Language.ENGLISH: 16, Language.GERMAN: 21})
"""Letters of a headline; ``plain`` has no more either."""
_SIDES: Mapping[str, Mapping[str, Words]] = MappingProxyType(
    {
        "side": {"camera.left": Words("LEFT ", "LINKE "), "camera.right": Words("RIGHT ", "RECHTE ")},
        "window_side": {"camera.left": Words("LEFT ", "LINKES "), "camera.right": Words("RIGHT ", "RECHTES ")},
    }
)
"""Words for a side, by the placeholder of a headline and the device.

German needs the gender of the noun that follows.
"""


def headline_of(fault: Fault, language: Language = Language.ENGLISH) -> str:
    """Return a headline of at most ``LONGEST`` letters, with the fault's numbers where they fit."""
    rule = RULES[fault.code]
    plain = (rule.plain or rule.headline).in_language(language)
    # If a number is missing, or the text would be cut, the plain headline is used: half a number is worse than none.
    values: dict[str, float | str] = dict(fault.numbers)
    for name, side_words in _SIDES.items():
        if fault.device is not None and fault.device in side_words:
            values[name] = side_words[fault.device].in_language(language)
    try:
        text = rule.headline.in_language(language).format(**values)
    except (KeyError, ValueError):
        return plain
    return text if len(text) <= LONGEST[language] else plain


def action_of(fault: Fault, language: Language = Language.ENGLISH) -> str:
    """Return the remedy, or the fault's consequence; it names the camera if one was exchanged."""
    rule = RULES[fault.code]
    camera = None if fault.device is None else _CAMERAS.get(fault.device)
    if rule.exchanged is None or camera is None:
        # UNCALIBRATED has no device if there is no calibration at all, and one if that camera was exchanged.
        return rule.action.in_language(language)
    return rule.exchanged.in_language(language).format(camera=camera.in_language(language))


def alert_of(fault: Fault) -> Alert:
    """Return the alert of a fault."""
    rule = RULES[fault.code]
    return Alert(
        fault.code,
        rule.severity,
        headline_of(fault),
        action_of(fault),
        fault.detail,
        fault.device,
        (headline_of(fault, Language.GERMAN), action_of(fault, Language.GERMAN)),
        passing=rule.passing,
    )


def notice_of(machine: Machine) -> Alert | None:
    """Return the notice as an alert, worded by its kind; ``None``: there is none."""
    if machine.notice is None:
        return None
    fault = machine.notice.fault
    rule = RULES[fault.code]
    plain = alert_of(fault)
    english, german = (headline_of(fault, language) for language in (Language.ENGLISH, Language.GERMAN))
    match machine.notice.kind:
        case NoticeKind.REFUSAL:
            # A condition that lasts is acknowledged with the refusal, by one press of BACK (label SEEN).
            lasts = any(
                (condition.code, condition.device) == (fault.code, fault.device) for condition in lasting(machine)
            )
            return replace(plain, action=_REFUSED.english, german=(german, _REFUSED.german), lasts=lasts)
        case NoticeKind.NOT_ADDED:
            headline, action = _NOT_ADDED, _FIRST_KEPT
        case NoticeKind.FAILURE if rule.stops_capture or rule.forbids_light:
            # The condition that ended the scan is shown separately; this notice says that the scan failed.
            headline, action = _FAILED, _AGAIN
        case NoticeKind.FAILURE | NoticeKind.NEWS:
            return plain
        case unknown:
            assert_never(unknown)
    return replace(
        plain,
        headline=headline.english,
        action=action.english.format(fault=english),
        german=(headline.german, action.german.format(fault=german)),
    )


def lasting(machine: Machine) -> tuple[Fault, ...]:
    """Return the faults that last until they end or are repaired: lost devices, conditions, stuck keys."""
    stuck = (Fault(FaultCode.KEY_STUCK, f"{k.value} key", device=f"key.{k.value}") for k in Key if k in machine.stuck)
    return (*machine.lost.values(), *machine.conditions, *stuck)


def is_acknowledged(machine: Machine, fault: Fault) -> bool:
    """Return True if the diver has acknowledged the fault for its reason, and at its severity."""
    worsens = RULES[fault.code].worsens
    return any(
        # The same code can have another cause, which needs a new acknowledgement; numbers in the detail do not count.
        (earlier.code, earlier.device, _reason(earlier)) == (fault.code, fault.device, _reason(fault))
        and not any(_worse(earlier, fault, name, limit) for name, limit in worsens.items())
        for earlier in machine.acknowledged
    )


def _reason(fault: Fault) -> str:
    """Return the detail without its numbers, which change from one moment to the next."""
    return re.sub(r"[-+]?\d[\d.,]*", "#", fault.detail)


def _worse(earlier: Fault, now: Fault, name: str, limit: float) -> bool:
    if name not in earlier.numbers or name not in now.numbers:
        # A number that was not known before counts as worse; one that vanished does not.
        return name in now.numbers
    change = now.numbers[name] - earlier.numbers[name]
    return change >= limit if limit > 0.0 else change <= limit


def lengths_doubtful(machine: Machine) -> bool:
    """Return True if a condition makes lengths unreliable."""
    return any(RULES[fault.code].doubts_lengths for fault in machine.conditions)
