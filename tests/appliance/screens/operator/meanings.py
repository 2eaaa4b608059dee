"""Owns what each alert means, in a sentence for who holds the instrument: (English, German)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from appliance.scan.fault import FaultCode as F

_FRAMES = (
    "Frames are missing, doubled or damaged; the scan is not used.",
    "Bilder fehlen, sind doppelt oder beschädigt; der Scan wird nicht verwendet.",
)
MEANINGS: Mapping[F, tuple[str, str]] = MappingProxyType(
    {
        F.FRAME_MISSING: _FRAMES,
        F.FRAME_REPEATED: _FRAMES,
        F.FRAME_ORDER: _FRAMES,
        F.FRAME_TRUNCATED: _FRAMES,
        F.FRAME_CORRUPT: _FRAMES,
        F.CAMERA_STUCK: ("A camera repeats one picture.", "Eine Kamera wiederholt ein Bild."),
        F.PATTERN_WRONG: ("A picture shows another pattern than it should.", "Ein Bild zeigt ein anderes Muster als es soll."),
        F.SYNC_LOST: ("The cameras did not expose together.", "Die Kameras haben nicht gleichzeitig belichtet."),
        F.LATE_FLIP: ("A pattern was shown too late.", "Ein Muster kam zu spät."),
        F.PROJECTOR_TIMING: ("The projector shows every pattern one picture late.", "Der Projektor zeigt jedes Muster ein Bild zu spät."),
        F.PROJECTOR_DARK: ("The projector's light did not reach the object.", "Das Licht des Projektors erreichte das Objekt nicht."),
        F.PULSE_MISSING: ("The board fired fewer pulses than wanted.", "Die Platine gab weniger Pulse als verlangt."),
        F.CAPTURE_TIMEOUT: ("The sequence did not end in its time.", "Die Aufnahme wurde nicht rechtzeitig fertig."),
        F.MOVED: ("Instrument or object moved; points are wrong.", "Gerät oder Objekt hat sich bewegt; Punkte sind falsch."),
        F.COMPENSATED: ("A motion was found and taken out.", "Eine Bewegung wurde erkannt und herausgerechnet."),
        F.TOO_BRIGHT: ("Much of the object is overexposed.", "Vieles am Objekt ist überbelichtet."),
        F.TOO_DARK: ("Too little light comes back.", "Es kommt zu wenig Licht zurück."),
        F.WATER_DIRTY: ("Particles or backscatter hide much of the object.", "Schwebstoffe oder Trübung verdecken vieles."),
        F.SCAN_NEAR: ("What was scanned is nearer than is measured.", "Was gescannt wurde, ist näher, als gemessen wird."),
        F.SCAN_FAR: ("What was scanned is farther than is measured.", "Was gescannt wurde, ist ferner, als gemessen wird."),
        F.NOTHING_SEEN: ("The projector's light met nothing.", "Das Licht des Projektors traf auf nichts."),
        F.SIDES_EXCHANGED: ("The left camera's pictures are the right one's.", "Die Bilder der linken Kamera sind die der rechten."),
        F.SCAN_POOR: ("Too few points, and no cause was found.", "Zu wenige Punkte, und kein Grund wurde gefunden."),
        F.LIGHT_FLICKERS: ("Other light changes and makes points wrong.", "Fremdes Licht flackert und verfälscht Punkte."),
        F.FRINGES_BENT: ("This exposure bends the fringes; points are noisier.", "Diese Belichtung biegt die Streifen; mehr Rauschen."),
        F.AMBIENT: ("Daylight or a torch outshines the projector.", "Tageslicht oder eine Lampe überstrahlt den Projektor."),
        F.CAMERA_LOST: ("A camera does not answer; it is tried again.", "Eine Kamera antwortet nicht; sie wird weiter gesucht."),
        F.CAMERA_SLOW_LINK: ("A camera's cable is not making full contact.", "Das Kabel einer Kamera hat keinen vollen Kontakt."),
        F.CAMERA_REFUSED: ("A camera does not take its settings.", "Eine Kamera nimmt ihre Einstellungen nicht an."),
        F.PROJECTOR_LOST: ("The projector cannot be driven.", "Der Projektor lässt sich nicht ansteuern."),
        F.DISPLAY_LOST: ("The display cannot be driven.", "Die Anzeige lässt sich nicht ansteuern."),
        F.BOARD_LOST: ("The trigger board is silent.", "Die Triggerplatine schweigt."),
        F.BOARD_RESET: ("The trigger board started anew; all is set again.", "Die Triggerplatine ist neu gestartet; alles ist wieder gesetzt."),
        F.VSYNC_LOST: ("The board sees no video for the projector.", "Die Platine sieht kein Videosignal zum Projektor."),
        F.LASER_ON: ("A laser shines although it is switched off.", "Ein Laser leuchtet, obwohl er aus sein soll."),
        F.LASER_FAILED: ("A laser stays dark; the other dot gives the distance.", "Ein Laser bleibt dunkel; der andere Punkt gibt den Abstand."),
        F.KEYS_LOST: ("The key pad is silent.", "Das Tastenfeld schweigt."),
        F.KEY_STUCK: ("A key hangs and is ignored; another takes over.", "Eine Taste klemmt und zählt nicht; eine andere übernimmt."),
        F.AIM_DARK: ("Too little is seen for a scan to measure.", "Zu wenig ist zu sehen, um es zu messen."),
        F.AIM_TURBID: ("The water shines, and nothing is seen through it.", "Das Wasser leuchtet, und nichts ist durch es zu sehen."),
        F.AIM_FAST: ("Faster than a scan can undo.", "Schneller, als ein Scan es ausgleichen kann."),
        F.TOO_NEAR: ("The object is nearer than can be measured well.", "Das Objekt ist näher, als gut zu messen ist."),
        F.TOO_FAR: ("The object is farther than can be measured well.", "Das Objekt ist ferner, als gut zu messen ist."),
        F.STORAGE_FULL: ("No room for another scan; none is deleted.", "Kein Platz für einen weiteren Scan; keiner wird gelöscht."),
        F.DISK_READ_ONLY: ("The disk takes nothing more; what is saved is safe.", "Der Speicher nimmt nichts mehr an; Gespeichertes ist sicher."),
        F.DISK_REFUSES: ("The disk gives no space for a scan.", "Der Speicher gibt keinen Platz für einen Scan."),
        F.NOT_SAVED: ("The disk refused the scan; it is still in memory.", "Der Speicher nahm den Scan nicht; er ist noch im Gerät."),
        F.RESTARTED: ("The program hung or ended by itself, and runs again.", "Das Programm hing oder endete und läuft wieder."),
        F.SCAN_RECOVERED: ("Cut off while it was being saved; its frames are whole.", "Beim Speichern unterbrochen; seine Bilder sind ganz."),
        F.UPDATE_UNDONE: ("A new version failed; the old one is back.", "Eine neue Version taugte nicht; die alte ist zurück."),
        F.SETTINGS_LOST: ("What was chosen in the menu could not be read.", "Was im Menü gewählt war, ließ sich nicht lesen."),
        F.UNCALIBRATED: ("No valid calibration: shapes yes, sizes no.", "Keine gültige Kalibrierung: Formen ja, Längen nein."),
        F.LENGTH_ERROR: (
            "The ball bar came out too long or too short: other water than was set, or the instrument has changed.",
            "Der Kugelstab kam zu lang oder zu kurz heraus: anderes Wasser als eingestellt, oder das Gerät ist verändert.",
        ),
        F.VERIFY_CALIBRATION: ("Knocked, or another water than was set.", "Angestoßen, oder anderes Wasser als eingestellt."),
        F.RECONSTRUCTION_FAILED: ("No cloud now; it can be computed on the desk.", "Jetzt keine Punkte; am Schreibtisch berechenbar."),
        F.WINDOW: ("Fogged, dirty or scratched: soft at one place.", "Beschlagen, schmutzig oder zerkratzt: an einer Stelle unscharf."),
        F.WARM: ("The housing gets warm.", "Das Gehäuse wird warm."),
        F.HOT: ("Too hot: dark until it has cooled down.", "Zu heiß: dunkel, bis es abgekühlt ist."),
        F.TOO_HOT: ("So hot that it switches itself off.", "So heiß, dass es sich ausschaltet."),
        F.TEMPERATURE_UNKNOWN: ("A temperature sensor is silent; light is rationed.", "Ein Temperaturfühler schweigt; Licht wird rationiert."),
        F.SUPPLY_LOW: ("The supply sags; scans are saved first.", "Die Versorgung bricht ein; Scans werden zuerst gespeichert."),
        F.LEAK: ("Water in the housing.", "Wasser im Gehäuse."),
        F.INTERNAL: ("The software contradicted itself.", "Die Software widersprach sich."),
    }
)  # fmt: skip
