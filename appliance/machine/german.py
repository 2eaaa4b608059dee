"""Owns the German words of every alert: one row beside each row of ``appliance.machine.alerts.RULES``.

A headline has at most 21 characters, an action at most 32; whether they fit their room is measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from appliance.scan.fault import FaultCode


@dataclass(frozen=True, slots=True)
class German:
    """``headline`` is used when all its numbers are known, else ``plain``, as in a rule."""

    headline: str
    action: str
    plain: str = ""
    exchanged: str = ""


REFUSED = "SCAN ABGELEHNT"
"""The action of any fault that SCAN was refused for."""
FAILED = "SCAN MISSLUNGEN"
"""The headline over any fault that ended a scan; its own goes into the action."""
NOT_ADDED, FIRST_KEPT = "NICHT ERGÄNZT", "ERSTER BLEIBT"
"""The same, of a second exposure."""
AGAIN = "NOCHMAL"
CAMERAS = {"camera.left": "LINKE KAMERA", "camera.right": "RECHTE KAMERA", "cameras": "KAMERAS"}
LONGEST = 21
SIDES = {"camera.left": "LINKE ", "camera.right": "RECHTE "}
WINDOW_SIDES = {"camera.left": "LINKES ", "camera.right": "RECHTES "}

_INCOMPLETE = "UNVOLLSTÄNDIG {received:.0f}/{expected:.0f}"
_CONNECTOR = "STECKER PRÜFEN"

GERMAN: Mapping[FaultCode, German] = MappingProxyType(
    {
        FaultCode.FRAME_MISSING: German(_INCOMPLETE, AGAIN, "UNVOLLSTÄNDIG"),
        FaultCode.FRAME_REPEATED: German(_INCOMPLETE, AGAIN, "BILD DOPPELT"),
        FaultCode.FRAME_ORDER: German(_INCOMPLETE, AGAIN, "BILDFOLGE FALSCH"),
        FaultCode.FRAME_TRUNCATED: German(_INCOMPLETE, AGAIN, "BILD ABGESCHNITTEN"),
        FaultCode.FRAME_CORRUPT: German(_INCOMPLETE, AGAIN, "BILD BESCHÄDIGT"),
        FaultCode.CAMERA_STUCK: German("{side}KAMERA HÄNGT", AGAIN, "KAMERA HÄNGT"),
        FaultCode.PATTERN_WRONG: German("FALSCHES MUSTER", AGAIN),
        FaultCode.SYNC_LOST: German("KEIN GLEICHTAKT", "NOCHMAL; TRIGGERKABEL PRÜFEN"),
        FaultCode.LATE_FLIP: German("PROJEKTOR SPÄT", AGAIN),
        FaultCode.PROJECTOR_TIMING: German("PROJEKTORTAKT", "NOCHMAL; SONST NEU STARTEN"),
        FaultCode.PROJECTOR_DARK: German("PROJEKTOR DUNKEL", "LAMPE UND VIDEOKABEL PRÜFEN"),
        FaultCode.PULSE_MISSING: German("PULSE {received:.0f}/{expected:.0f}", AGAIN, "PULS FEHLT"),
        FaultCode.CAPTURE_TIMEOUT: German("SCAN ZU LANGSAM", AGAIN),
        FaultCode.MOVED: German("BEWEGT {shift_px:.1f} px", AGAIN, "BEWEGT"),
        FaultCode.COMPENSATED: German("BEWEGUNG BEHOBEN", "BEHALTEN, ODER NOCHMAL RUHIGER"),
        FaultCode.TOO_BRIGHT: German("ZU HELL", "KÜRZER BELICHTEN, NOCHMAL"),
        FaultCode.TOO_DARK: German("ZU DUNKEL", "NÄHER HERAN, LÄNGER BELICHTEN"),
        FaultCode.WATER_DIRTY: German("WASSER TRÜB {coverage_percent:.0f} %", "WARTEN ODER NÄHER HERAN", "WASSER TRÜB"),
        FaultCode.SCAN_NEAR: German("NAH {distance_mm:.0f} mm", "ZURÜCK, NOCHMAL", "ZU NAH"),
        FaultCode.SCAN_FAR: German("WEIT {distance_mm:.0f} mm", "NÄHER HERAN, NOCHMAL", "ZU WEIT"),
        FaultCode.NOTHING_SEEN: German("NICHTS ZU SEHEN", "NÄHER HERAN; LICHT VERDECKT?"),
        FaultCode.SCAN_POOR: German("SCHLECHT, WARUM?", "NÄHER, STILL HALTEN, NOCHMAL"),
        FaultCode.LIGHT_FLICKERS: German("LICHT FLACKERT", "ABSCHATTEN, WEG DAVON, NOCHMAL"),
        FaultCode.AMBIENT: German("ZU VIEL LICHT", "ABSCHATTEN, LAMPEN WEGDREHEN"),
        FaultCode.CAMERA_LOST: German("{side}KAMERA FEHLT", _CONNECTOR, "KAMERA FEHLT"),
        FaultCode.CAMERA_SLOW_LINK: German("KAMERA LANGSAM", _CONNECTOR),
        FaultCode.CAMERA_REFUSED: German("{side}KAMERA GESTÖRT", "AN LAND: EINSTELLUNG PRÜFEN", "KAMERA GESTÖRT"),
        FaultCode.PROJECTOR_LOST: German("PROJEKTOR FEHLT", _CONNECTOR),
        FaultCode.DISPLAY_LOST: German("ANZEIGE FEHLT", _CONNECTOR),
        FaultCode.BOARD_LOST: German("PLATINE FEHLT", _CONNECTOR),
        FaultCode.BOARD_RESET: German("PLATINE NEU GESTARTET", "LIEF EIN SCAN: NOCHMAL"),
        FaultCode.VSYNC_LOST: German("KEIN VIDEOSIGNAL", "VIDEOKABEL PRÜFEN"),
        FaultCode.LASER_ON: German("LASER AN", "SCAN GESPERRT"),
        FaultCode.LASER_FAILED: German("LASER FEHLT", "ABSTAND AUS EINEM PUNKT"),
        FaultCode.KEYS_LOST: German("TASTEN FEHLEN", _CONNECTOR),
        FaultCode.KEY_STUCK: German("TASTE KLEMMT", "BESCHRIFTETE TASTE NEHMEN"),
        FaultCode.STORAGE_FULL: German("SPEICHER VOLL", "SCANS KOPIEREN, PLATZ SCHAFFEN"),
        FaultCode.DISK_READ_ONLY: German("SPEICHER NUR LESBAR", "AUFTAUCHEN, SPEICHER PRÜFEN"),
        FaultCode.DISK_REFUSES: German("SPEICHER GESTÖRT", "AUFTAUCHEN, SPEICHER PRÜFEN"),
        FaultCode.NOT_SAVED: German("NICHT GESPEICHERT", "ERNEUT SPEICHERN ODER NOCHMAL"),
        FaultCode.AIM_DARK: German("ZU DUNKEL", "NÄHER HERAN, LÄNGER BELICHTEN"),
        FaultCode.AIM_TURBID: German("WASSER ZU TRÜB", "NÄHER HERAN ODER WARTEN"),
        FaultCode.AIM_FAST: German("ZU UNRUHIG", "STILL HALTEN, DANN SCANNEN"),
        FaultCode.TOO_NEAR: German("NAH {distance_mm:.0f} mm", "ZURÜCK, ODER NOCHMAL DRÜCKEN", "ZU NAH"),
        FaultCode.TOO_FAR: German("WEIT {distance_mm:.0f} mm", "NÄHER, ODER NOCHMAL DRÜCKEN", "ZU WEIT"),
        FaultCode.RESTARTED: German("NEU GESTARTET", "WEITER; GESPEICHERTES IST DA"),
        FaultCode.SCAN_RECOVERED: German("SCAN GERETTET", "ER IST IN DER GALERIE"),
        FaultCode.UPDATE_UNDONE: German("UPDATE VERWORFEN", "ALTE VERSION LÄUFT WEITER"),
        FaultCode.SETTINGS_LOST: German("EINSTELLUNG VERLOREN", "IM MENÜ PRÜFEN"),
        FaultCode.UNCALIBRATED: German("UNKALIBRIERT", "LÄNGEN NICHT VERLÄSSLICH", exchanged="{camera} GETAUSCHT"),
        FaultCode.LENGTH_ERROR: German(
            "LÄNGENFEHLER {error_percent:.1f} %", "WASSER PRÜFEN, KALIBRIEREN", "LÄNGENFEHLER"
        ),
        FaultCode.VERIFY_CALIBRATION: German("KALIBRIERUNG PRÜFEN", "WASSER UND KUGELSTAB PRÜFEN"),
        FaultCode.RECONSTRUCTION_FAILED: German("SPÄTER RECHNEN", "ROHBILDER BEHALTEN ODER NOCHMAL"),
        FaultCode.WINDOW: German("{window_side}FENSTER?", "ABWISCHEN; INNEN: TROCKNEN", "FENSTER?"),
        FaultCode.WARM: German("WARM {temperature_c:.0f} °C", "BALD ABKÜHLEN LASSEN", "WARM"),
        FaultCode.HOT: German("HEISS {temperature_c:.0f} °C", "KÜHLT AB, SCAN GESPERRT", "HEISS"),
        FaultCode.TOO_HOT: German("ZU HEISS {temperature_c:.0f} °C", "SCHALTET SICH AUS", "ZU HEISS"),
        FaultCode.TEMPERATURE_UNKNOWN: German("TEMPERATUR ?", "LICHT WIRD EINGETEILT"),
        FaultCode.SUPPLY_LOW: German("SPANNUNG NUR {supply_v:.1f} V", "TAUCHGANG BEENDEN", "SPANNUNG NIEDRIG"),
        FaultCode.LEAK: German("LECK: AUFTAUCHEN", "LICHT IST AUS, SCANS SIND SICHER"),
        FaultCode.INTERNAL: German("INTERNER FEHLER", "NOCHMAL; PROTOKOLL AN LAND LESEN"),
    }
)
