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
        "list and check stored scans, label them, put them aside",
        (
            VerbEntry("list", "all scans", "scans:ListScans"),
            VerbEntry("show", "the manifest of a scan, or one of its frames as an image", "scans:ShowScan"),
            VerbEntry("verify", "compare every byte with its checksum, packed or not", "scans:VerifyScans"),
            VerbEntry("label", "give a scan a name and a note", "scans:LabelScan"),
            VerbEntry(
                "trash", "put scans into the trash; nothing is deleted, numbers are not used again", "scans:TrashScans"
            ),
            VerbEntry("restore", "take scans out of the trash", "scans:RestoreScans"),
        ),
    ),
    VerbEntry(
        "cloud", "points or a mesh of scans or an object, as files for this and other programs", "cloud:MakeCloud"
    ),
    VerbEntry("import", "points from the images of another rig, with a description of them", "foreign:Import"),
    Group(
        "object",
        "many scans as one object",
        (
            VerbEntry("add", "make an object, or add scans to it", "object:AddToObject"),
            VerbEntry("solve", "find the scan poses of an object", "object:SolveObject"),
            VerbEntry(
                "show", "the scan poses of an object, their uncertainty, and rejected scan pairs", "object:ShowObject"
            ),
        ),
    ),
    VerbEntry("compare", "deviations of a scan or an object from a CAD model or another object", "compare:Compare"),
    VerbEntry("report", "one page about a dive, a table of reprocessed scans or an object", "report:MakeReport"),
    VerbEntry("evaluate", "measure artefacts in stored scans, after VDI/VDE 2634", "evaluate:Evaluate"),
    Group(
        "calibration",
        "show, make, use and check calibrations, measure the instrument itself",
        (
            VerbEntry("show", "a calibration, and whether it still holds", "calibration:ShowCalibration"),
            VerbEntry("air", "intrinsics and extrinsics, from images of a board in air", "calibrate_air:CalibrateAir"),
            VerbEntry(
                "water", "calibrate from scans of ball bars and planes in water", "calibrate_water:CalibrateWater"
            ),
            VerbEntry("use", "use an earlier calibration, or one from a file", "calibration:UseCalibration"),
            VerbEntry(
                "measure",
                "measure the cameras' noise, the projector's response or its exposures",
                "measure:MeasureInstrument",
            ),
            VerbEntry("accept", "withdraw an alarm after a length check", "calibration:AcceptHealth"),
        ),
    ),
    Group(
        "archive",
        "copy scans off an instrument, pack them to a third of the size, reprocess them",
        (
            VerbEntry("pull", "copy what is new on an instrument, and compare it; nothing is deleted", "pull:Pull"),
            VerbEntry(
                "pack",
                "pack the scans of a storage root; a scan is removed only after a comparison",
                "archive:PackArchive",
            ),
            VerbEntry("unpack", "unpack scans, byte for byte", "archive:UnpackArchive"),
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
            VerbEntry(
                "measure",
                "measure the projector with the instrument's cameras, or the trigger lines",
                "setup:SetupMeasure",
            ),
            VerbEntry(
                "firmware", "write the firmware of trigger board or keypad into a folder", "setup:LayOutFirmware"
            ),
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
