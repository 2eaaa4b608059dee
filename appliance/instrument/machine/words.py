"""All texts of the screens by name, each with its translation.

The machine names the labels of its keys, the screens write them in the diver's language. Only the texts of faults are
elsewhere, in both languages, too: in the table of faults (``appliance.instrument.machine.alerts``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, unique

from appliance.calibrate import Step


class Language(Enum):
    ENGLISH = "en"
    GERMAN = "de"


@dataclass(frozen=True, slots=True)
class Words:
    """A phrase in each language, possibly with places for numbers (``str.format``)."""

    english: str
    german: str

    def in_language(self, language: Language) -> str:
        """Return the phrase in ``language``."""
        return self.german if language is Language.GERMAN else self.english


@unique
class Text(Enum):
    """One entry per word or phrase; its value is (English, German)."""

    # Labels of keys: one word, or HOLD: and one word
    SCAN = ("SCAN", "SCAN")
    OK = ("OK", "OK")
    KEEP = ("KEEP", "BEHALTEN")
    SEEN = ("SEEN", "GESEHEN")
    REPEAT = ("REPEAT", "NOCHMAL")
    BACK = ("BACK", "ZURÜCK")
    HOLD_OFF = ("HOLD: OFF", "HALTEN: AUS")
    STOP = ("STOP", "STOPP")
    TURN = ("TURN", "DREHEN")
    NOISE = ("NOISE", "RAUSCHEN")
    CANCEL = ("CANCEL", "ABBRUCH")
    RETRY = ("RETRY", "ERNEUT")
    MENU = ("MENU", "MENÜ")
    GALLERY = ("GALLERY", "GALERIE")
    GO_ON = ("GO ON", "WEITER")
    ANYWAY = ("ANYWAY", "TROTZDEM")
    CHANGE = ("CHANGE", "ÄNDERN")
    OPEN = ("OPEN", "ÖFFNEN")
    ARROW_UP = ("▲", "▲")
    ARROW_DOWN = ("▼", "▼")
    EXPOSE = ("EXPOSE", "BELICHTEN")
    GAIN = ("GAIN", "VERSTÄRKEN")
    NEWER = ("NEWER", "NEUER")
    OLDER = ("OLDER", "ÄLTER")
    HOLD_REDO = ("HOLD: REDO", "HALTEN: NOCHMAL")
    HOLD_ADD = ("HOLD: ADD", "HALTEN: DAZU")
    HOLD_NEW = ("HOLD: NEW", "HALTEN: NEU")
    REDO = ("REDO", "ERSETZEN")
    RESTORE = ("RESTORE", "ZURÜCKHOLEN")
    BAR_LYING = ("BAR LYING", "STAB LIEGEND")
    BAR_UPRIGHT = ("BAR UPRIGHT", "STAB STEHEND")
    PLANE_NEAR = ("PLANE NEAR", "EBENE NAH")
    PLANE_FAR = ("PLANE FAR", "EBENE FERN")
    SOLVE = ("SOLVE", "RECHNEN")
    VERIFY = ("VERIFY", "PRÜFEN")
    RESULT = ("RESULT", "ERGEBNIS")

    # Titles
    STARTING = ("STARTING", "STARTET")
    READY = ("READY", "BEREIT")
    NOT_READY = ("NOT READY", "NICHT BEREIT")
    HOLD_STILL = ("HOLD STILL", "STILLHALTEN")
    COMPUTING = ("COMPUTING", "RECHNET")
    SAVING = ("SAVING", "SPEICHERT")
    SAVED = ("SAVED", "GESPEICHERT")
    POWERING_OFF = ("POWERING OFF", "SCHALTET AUS")
    SELF_TEST = ("SELF-TEST", "SELBSTTEST")
    ALL_READY = ("ALL READY", "ALLES BEREIT")
    SEE_BELOW = ("SOMETHING FAILED", "ETWAS GEHT NICHT")
    GET_READY = ("GET READY", "ACHTUNG")
    CHECKING = ("CHECKING", "PRÜFT")
    COOLING = ("COOLING", "KÜHLT AB")
    NO_LIGHT = ("NO LIGHT, NO SCANS", "KEIN LICHT, KEINE SCANS")

    # The menu
    EXPOSURE = ("EXPOSURE", "BELICHTUNG")
    FRINGES = ("FRINGES", "STREIFEN")
    FINE = ("FINE", "FEIN")
    MEDIUM = ("MEDIUM", "MITTEL")
    COARSE_FRINGES = ("COARSE", "GROB")
    WATER = ("WATER", "WASSER")
    CALIBRATE = ("CALIBRATION", "KALIBRIERUNG")
    OBJECT = ("OBJECT", "OBJEKT")
    NO_OBJECT = ("NONE", "KEINS")
    TRANSFER = ("TRANSFER", "ÜBERTRAGUNG")
    ON = ("ON", "EIN")
    OFF = ("OFF", "AUS")
    ADDRESS = ("ADDRESS", "ADRESSE")
    TRANSFER_KEYS = ("KEYS", "SCHLÜSSEL")
    TRANSFER_FAILED = ("DOES NOT WORK", "GEHT NICHT")
    NO_NETWORK = ("NO CABLE", "KEIN KABEL")
    PLUG_STICK_IN = ("NONE, PLUG STICK IN", "KEINER, STICK EINSTECKEN")
    LANGUAGE = ("LANGUAGE", "SPRACHE")
    # Each in its own language, for a diver who cannot read the one that is set.
    ENGLISH = ("ENGLISH", "ENGLISH")
    GERMAN = ("DEUTSCH", "DEUTSCH")
    ABOUT = ("ABOUT", "ÜBER DAS GERÄT")
    POWER_OFF = ("POWER OFF", "AUSSCHALTEN")
    POWER_OFF_ASKED = ("POWER OFF?", "AUSSCHALTEN?")
    VERSION = ("VERSION", "VERSION")
    SERIAL_NUMBER = ("SERIAL NUMBER", "GERÄTENUMMER")
    CALIBRATED = ("CALIBRATED", "KALIBRIERT")
    FROM_DRAWING = ("NEVER, DESIGN VALUES", "NIE, ENTWURFSWERTE")
    SALINITY = ("SALINITY", "SALZGEHALT")
    DISK = ("DISK", "SPEICHER")
    STAY_ON = ("STAY ON", "ANBLEIBEN")
    SWITCH_OFF = ("SWITCH OFF", "AUSSCHALTEN")
    WATER_KIND = ("KIND OF WATER", "WASSERART")
    WATER_TEMPERATURE = ("WATER TEMPERATURE", "WASSERTEMPERATUR")
    FRESH = ("FRESH", "SÜSSWASSER")
    SALT = ("SALT", "SALZWASSER")

    # The gallery
    NO_SCANS = ("NO SCANS YET", "NOCH KEINE SCANS")
    NO_PICTURE = ("NO PICTURE", "KEIN BILD DA")
    DAMAGED = ("DAMAGED", "BESCHÄDIGT")
    DATE = ("TAKEN", "DATUM")

    # Many scans of one object
    OVERLAP = ("OVERLAP", "ÜBERLAPP")
    OVERLAP_UNSURE = ("OVERLAP NOT SURE", "ÜBERLAPP UNKLAR")
    NO_OVERLAP = ("NO OVERLAP:", "KEIN ÜBERLAPP:")
    GO_BACK = ("GO BACK", "ZURÜCK")
    TURN_BACK = ("GO BACK", "UMKEHREN")
    SCAN_NOW = ("SCAN NOW", "SCANNEN")

    # Beside numbers
    HOUSING = ("HOUSING", "GEHÄUSE")
    NEXT_SCAN = ("NEXT SCAN", "NÄCHSTER SCAN")
    TAKEN = ("SCANS", "SCANS")
    LEFT_OVER = ("LEFT", "FREI")
    POINTS = ("POINTS", "PUNKTE")
    COVERAGE = ("OF LIT AREA", "VOM HELLEN")
    DISTANCE = ("DISTANCE", "ABSTAND")
    TIME = ("TIME", "DAUER")

    # Sentences
    LEFT_CAMERA = ("LEFT CAMERA", "LINKE KAMERA")
    RIGHT_CAMERA = ("RIGHT CAMERA", "RECHTE KAMERA")
    NO_IMAGE = ("NO IMAGE", "KEIN BILD")
    NO_POINTS = ("NO POINTS", "KEINE PUNKTE")
    COARSE = ("COARSE VIEW", "GROBANSICHT")
    CLOSER = ("CLOSER", "NÄHER")
    NO_DOTS = ("DISTANCE ?", "ABSTAND ?")
    DOT_ON_IT = ("PUT A DOT ON IT", "PUNKT AUFS OBJEKT")
    MAY_MOVE = ("YOU MAY MOVE", "BEWEGEN ERLAUBT")
    LASERS_OFF = ("LASERS OFF, CAMERAS READY", "LASER AUS, KAMERAS BEREIT")
    UNTIL = ("READY BELOW", "BEREIT UNTER")
    SOME_MORE = ("STILL ABOUT", "NOCH ETWA")
    ALL_SAVED = ("ALL SCANS ARE SAVED", "ALLE SCANS GESPEICHERT")
    LIGHT_IS_ON = ("DO NOT MOVE UNTIL THE LIGHT IS OFF", "RUHIG HALTEN, BIS DAS LICHT AUS IST")
    SAFE_ON_DISK = ("SAFE ON DISK", "SICHER GESPEICHERT")
    WAIT_FOR_DARK = ("KEEP POWER CONNECTED", "NICHT VOM STROM TRENNEN")

    # Calibration: what to hold, and how
    BALL_BAR = ("BALL BAR", "KUGELSTAB")
    LYING = ("LYING, ONE END 35° NEARER", "LIEGEND, EIN ENDE 35° NÄHER")
    UPRIGHT = ("UPRIGHT, ONE END 35° NEARER", "STEHEND, EIN ENDE 35° NÄHER")
    PLANE_AWAY = ("{:.0f} mm AWAY, FILLS THE PICTURE", "{:.0f} mm VOR DEM GERÄT, BILDFÜLLEND")
    LEVEL = ("SLANTED, BOTH ENDS EQUALLY FAR", "SCHRÄG, BEIDE ENDEN GLEICH WEIT")
    FRONT = ("FRONT", "VORN")
    FROM_ABOVE = ("ABOVE", "VON OBEN")
    FROM_THE_SIDE = ("SIDE", "SEITE")

    # Calibration: what becomes of a recording
    STORING = ("STORING", "WIRD GESPEICHERT")
    LOOKING = ("LOOKING FOR IT", "WIRD GESUCHT")
    ENTERING = ("ENTERING", "WIRD EINGETRAGEN")
    SOLVING = ("SOLVING", "RECHNET AUS")
    SWITCHING = ("SWITCHING", "WECHSELT")
    ACCEPTED = ("FITS", "PASST")
    NO_BAR = ("NO BALL BAR", "KEIN KUGELSTAB")
    NO_PLANE = ("NO PLANE", "KEINE EBENE")
    FEW_POINTS = ("TOO FEW POINTS", "ZU WENIG PUNKTE")
    BAD_FIT = ("DOES NOT FIT", "PASST NICHT")
    WRONG_SIZE = ("WRONG SIZE", "FALSCHE GRÖSSE")
    LAY_DOWN = ("LAY IT DOWN", "STAB HINLEGEN")
    STAND_UP = ("STAND IT UP", "STAB AUFSTELLEN")
    TILT_MORE = ("TILT IT MORE", "MEHR NEIGEN")
    TILT_LESS = ("TILT IT LESS", "WENIGER NEIGEN")
    TOO_NEAR = ("GO FARTHER", "WEITER WEG GEHEN")
    TOO_FAR = ("GO CLOSER", "NÄHER HERAN")
    NOT_FILLED = ("FILL THE PICTURE", "BILD FÜLLEN")
    MOVED = ("MOVED", "BEWEGT")
    WRONG_PATTERN = ("WRONG PATTERN", "FALSCHES MUSTER")
    BOTH_BALLS_LIT = ("BOTH BALLS LIT AND IN VIEW", "BEIDE KUGELN IM LICHT UND IM BILD")
    ONLY_THE_PLANE = ("NOTHING BUT THE PLANE IN VIEW", "NUR DIE EBENE IM BILD")
    WIPE_AND_SHOW = ("WIPE IT, AVOID GLARE", "ABWISCHEN, GLANZ MEIDEN")
    STILL_AND_CLEAN = ("HOLD STILL, WIPE IT, REPEAT", "STILLHALTEN, ABWISCHEN, NOCHMAL")
    SEE_CERTIFICATE = ("CHECK BAR AND CERTIFICATE", "STAB UND ZERTIFIKAT PRÜFEN")
    AGAINST_LEVEL = ("AGAINST THE HORIZONTAL", "GEGEN DIE WAAGERECHTE")
    IN_DEPTH_20_50 = ("IN DEPTH; 20° TO 50° IS RIGHT", "IN DIE TIEFE; RICHTIG: 20° BIS 50°")
    IN_DEPTH_15 = ("IN DEPTH; UP TO 15° IS RIGHT", "IN DIE TIEFE; RICHTIG: BIS 15°")
    PLANE_35 = ("UP TO 35° IS RIGHT", "RICHTIG: BIS 35°")
    RIGHT_RANGE = ("{:.0f} TO {:.0f} mm IS RIGHT", "RICHTIG: {:.0f} BIS {:.0f} mm")
    FILL_45 = ("45 % IS NEEDED", "45 % NÖTIG")
    STILL_AND_AGAIN = ("HOLD STILL, RECORD AGAIN", "STILLHALTEN, NOCH EINMAL")
    RECORD_AGAIN = ("RECORD IT AGAIN", "NOCH EINMAL AUFNEHMEN")

    # Calibration: what came to nothing, and what to do about it
    NOT_USABLE = ("RECORDING NOT USABLE", "AUFNAHME UNBRAUCHBAR")
    NO_CERTIFICATE = ("CERTIFICATE MISSING", "ZERTIFIKAT FEHLT")
    OTHER_CAMERAS = ("OTHER CAMERAS", "ANDERE KAMERAS")
    NO_SOLUTION = ("NO SOLUTION FOUND", "KEINE LÖSUNG GEFUNDEN")
    FILES_DO_NOT_FIT = ("A FILE DOES NOT FIT", "EINE DATEI PASST NICHT")
    DISK_REFUSED = ("DISK REFUSED", "SPEICHER VERWEIGERT")
    BROKEN_OFF = ("BROKEN OFF", "ABGEBROCHEN")
    ANSWERED_LATE = ("NO ANSWER IN TIME", "KEINE ANTWORT")
    RECORD_ALL = ("CHECK BAR AND WATER, RECORD ALL AGAIN", "STAB UND WASSER PRÜFEN, ALLES NEU AUFNEHMEN")
    AT_THE_DESK = ("GO ON AT THE DESK", "WEITER AM SCHREIBTISCH")
    CALIBRATE_IN_AIR = ("CALIBRATE IN AIR AGAIN, AT THE DESK", "AN LAND NEU IN LUFT KALIBRIEREN")
    TRY_AGAIN = ("TRY AGAIN", "NOCH EINMAL VERSUCHEN")

    # Calibration: what it gave
    FOUR_READY = ("FOUR RECORDINGS READY", "VIER AUFNAHMEN BEREIT")
    SOME_SECONDS = ("TAKES SOME SECONDS", "DAUERT EINIGE SEKUNDEN")
    LENGTH_ERROR = ("LENGTH ERROR", "LÄNGENFEHLER")
    BEFORE = ("BEFORE", "BISHER")
    NEW = ("NEW", "NEU")
    BETTER = ("BETTER", "BESSER")
    WORSE = ("WORSE", "SCHLECHTER")
    RIGHT = ("RIGHT", "STIMMT")
    NOT_RIGHT = ("WRONG", "FALSCH")
    CHECK_WATER = ("CHECK WATER IN THE MENU, OR CALIBRATE", "WASSER IM MENÜ PRÜFEN, ODER KALIBRIEREN")
    NO_DIFFERENCE = ("NO DIFFERENCE", "KEIN UNTERSCHIED")
    IN_USE = ("IN USE", "IN GEBRAUCH")
    RESIDUAL = ("RESIDUAL", "RESTFEHLER")
    WARNINGS = ("WARNINGS", "WARNUNGEN")

    # Verdicts on a scan, in a word
    GOOD = ("GOOD", "GUT")
    USABLE = ("USABLE", "BRAUCHBAR")
    BAD = ("BAD", "SCHLECHT")
    LENGTHS_DOUBTFUL = ("LENGTHS UNSURE", "LÄNGEN UNSICHER")

    # Results of the self-test
    WAITING = ("…", "…")
    FAILED = ("FAILED", "FEHLT")
    NOT_MEASURED = ("not measured yet", "noch nicht gemessen")
    NO_ANSWER = ("no answer", "keine Antwort")
    COUNTED_ONLY = ("space is counted only", "Platz ist nur gezählt")
    REFUSES_FILES = ("takes no files", "nimmt keine Dateien an")
    GIVEN_UP = ("does not run", "läuft nicht")

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
        """Return the text in ``language``."""
        return self.german if language is Language.GERMAN else self.english

    def filled(self, language: Language, *numbers: float) -> str:
        """Return a text with places for numbers in ``language``, with ``numbers`` inserted."""
        return self.in_language(language).format(*numbers)


STEP_NAMES: Mapping[Step, Text] = {
    Step.M1: Text.BAR_LYING,
    Step.M2: Text.BAR_UPRIGHT,
    Step.M3: Text.PLANE_NEAR,
    Step.M4: Text.PLANE_FAR,
    Step.SOLVE: Text.SOLVE,
    Step.VERIFY: Text.VERIFY,
    Step.RESULT: Text.RESULT,
}
"""Name of each step of the calibration."""

Label = Text | Words | str | tuple[Text | str, ...]
"""Text that a screen writes in one place.

It is an entry, a text that is the same in every language (a number with its unit), or such parts with a space between
them: (EXPOSE, "8 ms").
"""

_DECIMAL = re.compile(r"(?<![\d.])(\d+)\.(\d+)(?![\d.])")
"""Pattern of one point between figures: a version like 0.1.0 has two."""


def worded(label: Label, language: Language = Language.ENGLISH) -> str:
    """Return a label in a language, with its decimal sign (0.31 % → 0,31 % in German).

    The log, the status file and the tests use English.
    """
    match label:
        case Text() | Words():
            return label.in_language(language)
        case str():
            return _DECIMAL.sub(r"\1,\2", label) if language is Language.GERMAN else label
        case _:
            return " ".join(worded(part, language) for part in label)
