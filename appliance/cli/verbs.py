"""List of the verbs: name, line of help, and the class that declares the arguments and does the work.

Only the class of the typed verb is imported.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass

from appliance.cli.arguments import Verb


@dataclass(frozen=True, slots=True)
class VerbEntry:
    """Entry of one verb in the list."""

    name: str
    text: str
    location: str
    """``module:class`` below ``appliance.cli``."""

    def load(self) -> type[Verb]:
        """Import the class of the verb and return it."""
        # By name, because an import at the head of this file would load every verb.
        module, _, name = self.location.partition(":")
        verb: type[Verb] = getattr(importlib.import_module(f"appliance.cli.{module}"), name)
        return verb


@dataclass(frozen=True, slots=True)
class Group:
    """Verbs below a common first word."""

    name: str
    text: str
    verbs: tuple[VerbEntry, ...]


VERBS: tuple[VerbEntry | Group, ...] = (
    VerbEntry("run", "run the instrument", "instrument:Run"),
    VerbEntry("sim", "run the instrument in a simulated world", "sim:Sim"),
    VerbEntry("check", "open every device once and report", "instrument:Check"),
    Group(
        "scans",
        "look at stored scans, label them, put them away",
        (
            VerbEntry("list", "all scans", "scans:ListScans"),
            VerbEntry("show", "one scan's manifest, or one of its frames as a picture", "scans:ShowScan"),
            VerbEntry("verify", "compare every byte with its checksum, packed or not", "scans:VerifyScans"),
            VerbEntry("label", "call a scan something, write a note about it", "scans:LabelScan"),
            VerbEntry("trash", "put scans away; nothing is deleted, and numbers stay taken", "scans:TrashScans"),
            VerbEntry("restore", "take scans out of the trash", "scans:RestoreScans"),
        ),
    ),
    VerbEntry(
        "cloud", "points or a mesh of scans or an object, as files for this and other programs", "cloud:MakeCloud"
    ),
    VerbEntry("import", "points of images that another rig took, by a description of them", "foreign:Import"),
    Group(
        "object",
        "many scans as one object",
        (
            VerbEntry("add", "begin an object, or add scans to one", "object:AddToObject"),
            VerbEntry("solve", "find where its scans lie relative to each other", "object:SolveObject"),
            VerbEntry("show", "where its scans lie, how certain that is, what was refused", "object:ShowObject"),
        ),
    ),
    VerbEntry("compare", "how far a scan or an object lies from a CAD model or another object", "compare:Compare"),
    VerbEntry("report", "one page about a dive, a table of reprocessed scans or an object", "report:MakeReport"),
    VerbEntry("evaluate", "measure artefacts in stored scans, after VDI/VDE 2634", "evaluate:Evaluate"),
    Group(
        "calibration",
        "show, make, use and check calibrations, measure the instrument itself",
        (
            VerbEntry("show", "a calibration, and whether it still holds", "calibration:ShowCalibration"),
            VerbEntry("air", "lenses and stereo pose, from pictures of a board in air", "calibrate_air:CalibrateAir"),
            VerbEntry(
                "water", "calibrate from scans of ball bars and planes in water", "calibrate_water:CalibrateWater"
            ),
            VerbEntry("use", "use a calibration of before, or that of a file", "calibration:UseCalibration"),
            VerbEntry(
                "measure", "the cameras' noise, the projector's response, its exposures", "measure:MeasureInstrument"
            ),
            VerbEntry("accept", "take an alarm back after a length check", "calibration:AcceptHealth"),
        ),
    ),
    Group(
        "archive",
        "scans off an instrument, kept in a third of the space, reprocessed",
        (
            VerbEntry("pull", "scans off an instrument: what is not here, compared, nothing deleted", "pull:Pull"),
            VerbEntry(
                "pack", "pack the scans of a storage root; none is removed that was not compared", "archive:PackArchive"
            ),
            VerbEntry("unpack", "bring scans back, byte for byte", "archive:UnpackArchive"),
            VerbEntry(
                "reprocess", "reprocess the scans of an archive, on this computer or on many", "reprocess:Reprocess"
            ),
        ),
    ),
    Group(
        "setup",
        "build a new instrument, install this program",
        (
            VerbEntry("guide", "from a box of parts to the first plane, in twelve steps", "setup:SetupGuide"),
            VerbEntry("measure", "the projector by its own cameras, or the trigger lines", "setup:SetupMeasure"),
            VerbEntry("firmware", "what goes onto trigger board or key pad", "setup:LayOutFirmware"),
            VerbEntry(
                "compile", "compile the kernels for this processor (an installation does)", "kernels:CompileKernels"
            ),
        ),
    ),
)
"""All verbs and groups."""
SECTIONS = {
    "the instrument": ("run", "sim", "check", "setup", "calibration"),
    "scans": ("scans", "archive"),
    "points, meshes, deviations": ("cloud", "object", "compare", "report", "evaluate", "import"),
}
"""Headings of ``kingfisher --help`` with the verbs and groups below them, in that order."""
SOUGHT = {
    "reconstruct": "cloud", "export": "cloud", "merge": "cloud SCAN+SCAN", "rescue": "cloud incomplete:N",
    "season": "report TABLE", "pull": "archive pull", "reprocess": "archive reprocess", "calibrate": "calibration",
    "measure": "calibration measure", "health": "calibration show", "bringup": "setup", "firmware": "setup firmware",
    "warm": "setup compile", "version": "--version", "scans merge": "cloud SCAN+SCAN", "scans name": "scans label",
    "scans note": "scans label", "object new": "object add", "object export": "cloud object:NAME",
    "object compare": "compare object:NAME", "archive verify": "scans verify",
    "archive frame": "scans show SCAN SIDE PATTERN", "calibration nominal": "calibration show nominal",
}  # fmt: skip
"""Verb that does the work of each word that people also type."""
