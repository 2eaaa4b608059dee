"""Owns every word that the screens themselves write, in each language. Alerts bring their own words."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, unique


class Language(Enum):
    ENGLISH = "en"
    GERMAN = "de"


@unique
class Text(Enum):
    """One entry per word or phrase; its value is (English, German)."""

    # Labels of keys: one word, at most eleven letters
    SCAN = ("SCAN", "SCAN")
    OK = ("OK", "OK")
    KEEP = ("KEEP", "BEHALTEN")
    REPEAT = ("REPEAT", "NOCHMAL")
    BACK = ("BACK", "ZURÜCK")
    OFF = ("OFF", "AUS")
    BRIGHTER = ("BRIGHTER", "HELLER")
    DARKER = ("DARKER", "DUNKLER")
    HOLD_OFF = ("HOLD: OFF", "LANG: AUS")
    STOP = ("STOP", "STOPP")
    TURN = ("TURN", "DREHEN")
    TURN_LEFT = ("‹ TURN", "‹ DREHEN")
    TURN_RIGHT = ("TURN ›", "DREHEN ›")
    DEPTH = ("DEPTH", "TIEFE")
    NOISE = ("NOISE", "RAUSCHEN")
    CANCEL = ("CANCEL", "ABBRUCH")
    RETRY = ("RETRY", "NEU")

    # Titles
    STARTING = ("STARTING", "STARTET")
    READY = ("READY", "BEREIT")
    NOT_READY = ("NOT READY", "NICHT BEREIT")
    HOLD_STILL = ("HOLD STILL", "STILLHALTEN")
    COMPUTING = ("COMPUTING", "RECHNET")
    SAVING = ("SAVING", "SPEICHERT")
    SAVED = ("SAVED", "GESPEICHERT")
    POWERING_OFF = ("POWERING OFF", "SCHALTET AB")

    # Beside numbers
    TAKEN = ("SCANS", "SCANS")
    LEFT_OVER = ("LEFT", "FREI")
    POINTS = ("POINTS", "PUNKTE")
    COVERAGE = ("COVERAGE", "ABDECKUNG")
    DISTANCE = ("DISTANCE", "ABSTAND")
    TIME = ("TIME", "DAUER")
    FRAME = ("FRAME", "BILD")
    MORE = ("MORE", "WEITERE")

    # Sentences
    LEFT_CAMERA = ("LEFT CAMERA", "LINKE KAMERA")
    RIGHT_CAMERA = ("RIGHT CAMERA", "RECHTE KAMERA")
    NO_IMAGE = ("NO IMAGE", "KEIN BILD")
    NO_POINTS = ("NO POINTS", "KEINE PUNKTE")
    COARSE = ("COARSE VIEW", "GROBANSICHT")
    CLOSER = ("CLOSER", "NÄHER")
    FARTHER = ("FARTHER", "WEITER WEG")
    LIGHT_IS_ON = ("DO NOT MOVE UNTIL THE LIGHT IS OFF", "RUHIG BIS DAS LICHT AUS IST")
    SAFE_ON_DISK = ("SAFE ON DISK", "SICHER GESPEICHERT")
    WAIT_FOR_DARK = ("KEEP POWER CONNECTED", "NICHT VOM STROM TRENNEN")

    # Verdicts on a scan, in a word
    GOOD = ("GOOD", "GUT")
    USABLE = ("USABLE", "BRAUCHBAR")
    BAD = ("BAD", "SCHLECHT")

    # Results of the self-test
    WAITING = ("…", "…")
    FAILED = ("FAILED", "FEHLT")

    # Devices, by their names in the rig file
    CAMERA_LEFT = ("Left camera", "Linke Kamera")
    CAMERA_RIGHT = ("Right camera", "Rechte Kamera")
    BOARD = ("Trigger board", "Triggerplatine")
    KEYS = ("Keys", "Tasten")
    PROJECTOR = ("Projector", "Projektor")
    DISPLAY = ("Display", "Anzeige")
    STORAGE = ("Storage", "Speicher")
    CALIBRATION = ("Calibration", "Kalibrierung")
    WORKER = ("Computing", "Rechenkern")

    def __init__(self, english: str, german: str) -> None:
        self.english = english
        self.german = german

    def in_language(self, language: Language) -> str:
        return self.german if language is Language.GERMAN else self.english


DEVICE_NAMES: Mapping[str, Text] = {
    "camera.left": Text.CAMERA_LEFT,
    "camera.right": Text.CAMERA_RIGHT,
    "board": Text.BOARD,
    "keys": Text.KEYS,
    "projector": Text.PROJECTOR,
    "display": Text.DISPLAY,
    "storage": Text.STORAGE,
    "calibration": Text.CALIBRATION,
    "worker": Text.WORKER,
}
"""What a device of the rig file is called; a device not listed is shown by its own name."""

_BY_ENGLISH = {text.english: text for text in Text}


def worded(label: Text | str, language: Language) -> str:
    """A label in a language; English words that the table holds are translated, others stay as they are."""
    text = label if isinstance(label, Text) else _BY_ENGLISH.get(label)
    return text.in_language(language) if text is not None else str(label)
