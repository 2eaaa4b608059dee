"""Owns how carefully instruments and artefacts of the world ``outside`` were made: tolerances that nobody may take as known.

In the other sets of true rigs the standard deviations are constants; here each rig comes from a workshop of its own.
"""

from __future__ import annotations

import numpy as np

from hw_sim.ranges import Range, drawn_strengths

STREAM = 0x0578
RANGES = {
    "mount_deg": Range(0.06, 0.28, "seats milled to 0.05 to 0.2 mm over 40 mm (ISO 2768 fine to medium)"),
    "mount_mm": Range(0.15, 0.75, "positions of bores over 230 mm (ISO 2768 fine to coarse)"),
    "focal": Range(1e-3, 4.5e-3, "focal lengths of series lenses: 0.1 to 0.5 % after focusing (makers' data)"),
    "centre_px": Range(
        3.0, 11.0, "sensor placement of ±13 to ±50 µm in C-mount cameras (EMVA 1288 data sheets, JIIA LER-004)"
    ),
    "n_g": Range(0.0015, 0.0065, "index of sapphire between its two axes: 0.008 (Malitson 1962)"),
    "artefact_mm": Range(0.0010, 0.0065, "calibration of ball bars: 1 to 5 µm (VDI/VDE 2634-2; ISO 10360-13)"),
    "board_mm": Range(0.004, 0.035, "flatness of boards as in objects.bent"),
    "board_scale": Range(
        4e-6, 4.5e-5, "aluminium and glass: 8e-6 to 23e-6 per K, up to 2 K from the temperature of the certificate"
    ),
    "moved_deg": Range(0.002, 0.013, "reseating of a clamped camera: 1 to 5 µm over 25 mm"),
    "moved_mm": Range(0.003, 0.026, "the same, as a shift"),
    "refocus": Range(4e-5, 2.8e-4, "principal distance over 3 to 12 K of glass and aluminium, as in optics.mounts"),
}
"""Ranges of the standard deviations of ``truth``; those that are not here are as in the realistic set."""


def drawn_tolerances(seed: int) -> dict[str, float]:
    """Return the standard deviations of the workshop that made the rig of ``seed``."""
    return drawn_strengths(RANGES, np.random.default_rng([seed, STREAM]))
