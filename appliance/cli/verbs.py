"""Owns the list of verbs: each one's words, its line of help, and the class that declares its arguments and does it.

The class is imported when its verb was typed, and no other's is.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass

from appliance.cli.arguments import Verb


@dataclass(frozen=True, slots=True)
class Listed:
    """One verb."""

    name: str
    text: str
    at: str
    """``module:class`` below ``appliance.cli``."""

    def load(self) -> type[Verb]:
        """Import the verb's class and return it."""
        # By its name as text, since an import at the head of this file would load every verb.
        module, _, name = self.at.partition(":")
        found: type[Verb] = getattr(importlib.import_module(f"appliance.cli.{module}"), name)
        return found


@dataclass(frozen=True, slots=True)
class Group:
    """Verbs that follow a word of their own."""

    name: str
    text: str
    verbs: tuple[Listed, ...]


VERBS: tuple[Listed | Group, ...] = (
    Listed("run", "run the instrument", "instrument:Run"),
    Listed("sim", "run the instrument in a simulated world", "sim:Sim"),
    Listed("check", "open every device once and report", "instrument:Check"),
    Group(
        "bringup",
        "measure a new instrument before its first scan",
        (
            Listed("guide", "from a box of parts to the first plane, in twelve steps", "bringup:BringupGuide"),
            Listed("trigger", "64 pulses, and what board and cameras make of them", "bringup:BringupTrigger"),
            Listed(
                "projector", "its light, latency, exposures, raster, by its own cameras", "bringup:BringupProjector"
            ),
        ),
    ),
    Group(
        "firmware",
        "lay out what goes onto the trigger board and the key pad",
        (
            Listed("board", "the trigger board's, for the instrument of the rig file", "firmware:BoardFirmware"),
            Listed("keys", "the key pad's, for the instrument of the rig file", "firmware:KeysFirmware"),
        ),
    ),
    Listed("reconstruct", "reconstruct a stored scan from its raw frames", "reconstruct:Reconstruct"),
    Listed("rescue", "an unchecked cloud of a recording that broke after its first direction", "rescue:Rescue"),
    Listed("export", "a stored scan's points or mesh as a file for other programs", "export:Export"),
    Listed("compare", "how far a scan's points lie from a CAD model or an object", "compare:CompareScan"),
    Listed("import", "points of images that another rig took, by a description of them", "foreign:Import"),
    Listed("evaluate", "measure artefacts in stored scans, after VDI/VDE 2634", "evaluate:Evaluate"),
    Group(
        "scans",
        "look at stored scans",
        (
            Listed("list", "all scans", "scans:ListScans"),
            Listed("show", "one scan's manifest", "scans:ShowScan"),
            Listed("verify", "compare every byte with its checksum", "scans:VerifyScans"),
            Listed("name", "call a scan something", "shelves:NameScan"),
            Listed("note", "write a note about a scan", "shelves:NoteScan"),
            Listed("trash", "put scans away; nothing is deleted, and numbers stay taken", "shelves:TrashScans"),
            Listed("restore", "take scans out of the trash", "shelves:RestoreScans"),
            Listed(
                "merge",
                "one cloud of two scans that were taken with different exposures from the same place",
                "reconstruct:MergeScans",
            ),
        ),
    ),
    Group(
        "object",
        "many scans as one object",
        (
            Listed("new", "begin an object with some scans, or none", "object:NewObject"),
            Listed("add", "add scans to an object", "object:AddToObject"),
            Listed("show", "where its scans lie, how certain that is, what was refused", "object:ShowObject"),
            Listed("solve", "find where its scans lie relative to each other", "object:SolveObject"),
            Listed("export", "its surface, mesh, scans or page as files, without solving again", "object:ExportObject"),
            Listed("compare", "how far its surface lies from a CAD model or another object", "compare:CompareObject"),
        ),
    ),
    Listed("report", "one page about the scans of a dive", "report:DiveReport"),
    Listed("pull", "scans off an instrument: what is not here, compared, nothing deleted", "pull:Pull"),
    Group(
        "archive",
        "keep scans in a third of the space, lossless",
        (
            Listed(
                "pack", "pack the scans of a storage root; none is removed that was not compared", "archive:PackArchive"
            ),
            Listed("verify", "decode every frame and compare its bytes", "archive:VerifyArchive"),
            Listed("unpack", "bring scans back, byte for byte", "archive:UnpackArchive"),
            Listed("frame", "one frame of a scan as a picture; no other is decoded", "archive:ReadFrame"),
        ),
    ),
    Listed("reprocess", "reprocess the scans of an archive, on this computer or on many", "reprocess:Reprocess"),
    Listed("season", "one page about a table of reprocessed scans", "reprocess:Season"),
    Group(
        "calibration",
        "look at calibrations",
        (
            Listed("show", "the calibration in use, or that of a file", "calibrations:ShowCalibration"),
            Listed(
                "nominal",
                "write the calibration that follows from the rig file's design",
                "calibrations:NominalCalibration",
            ),
        ),
    ),
    Group(
        "measure",
        "measure the instrument itself in a stored scan",
        (
            Listed("response", "the projector's light by code, from a scan of a plane", "measure:MeasureResponse"),
            Listed(
                "exposures",
                "which leave this projector's fringes straight, from a scan at each",
                "measure:MeasureExposures",
            ),
            Listed("noise", "both cameras' noise, beside what their data sheets make expect", "measure:MeasureNoise"),
        ),
    ),
    Group(
        "health",
        "whether the calibration still holds",
        (
            Listed("show", "the trend of the ray gaps", "health:ShowHealth"),
            Listed("accept", "take an alarm back after a length check", "health:AcceptHealth"),
        ),
    ),
    Group(
        "calibrate",
        "make calibrations",
        (
            Listed("air", "lenses and stereo pose, from pictures of a board in air", "calibrate_air:CalibrateAir"),
            Listed(
                "pair", "any two cameras in air, from anybody's pictures of a board", "calibrate_pair:CalibratePair"
            ),
            Listed("water", "calibrate from scans of ball bars and planes in water", "calibrate:CalibrateWater"),
            Listed(
                "restore",
                "use the calibration of before again; a second time undoes it",
                "calibrate:RestoreCalibration",
            ),
        ),
    ),
    Listed("warm", "compile the kernels for this processor (an installation does)", "installation:Warm"),
    Listed("version", "print the version", "installation:Version"),
)
"""All verbs and groups."""
SECTIONS = {
    "the instrument": ("run", "sim", "check", "bringup", "firmware"),
    "scans": ("scans", "pull", "archive"),
    "points, meshes, deviations": (
        "reconstruct", "export", "compare", "object", "report", "evaluate", "import", "rescue",
    ),
    "calibration": ("calibrate", "calibration", "measure", "health"),
    "a whole archive": ("reprocess", "season"),
    "this program": ("warm", "version"),
}  # fmt: skip
"""Headings of ``kingfisher --help`` with the verbs and groups below them, in that order."""
