"""Tolerances of instruments and artefacts in the world ``outside``.

In the other sets of true rigs the standard deviations are constants; here each rig has drawn ones, which the product
cannot know.
"""

from __future__ import annotations

import numpy as np

from hw_sim.ranges import Range, drawn_strengths

STREAM = 0x0578
RANGES = {
    "mount_deg": Range(
        0.06,
        0.28,
        "estimate: seats milled to 0.05 to 0.2 mm over 40 mm, about the general tolerances of ISO 2768-1 (not checked against its text)",
    ),
    "mount_mm": Range(
        0.15,
        0.75,
        "estimate: bores over 230 mm, about the general tolerances of ISO 2768-1 (not checked against its text)",
    ),
    "focal": Range(1e-3, 4.5e-3, "estimate: series lenses after focusing; no maker's tolerance was found"),
    "centre_px": Range(
        3.0,
        11.0,
        "estimate: 13 to 50 µm; makers allow more, ±0.25 mm (technical manuals of Allied Vision's Prosilica GT and Basler's pilot)",
    ),
    "n_g": Range(
        0.0015,
        0.0065,
        "sapphire's two rays differ by 0.0081 at 530 nm (Sellmeier equations of M. J. Dodge, see light_engine.sapphire_index)",
    ),
    "artefact_mm": Range(
        0.0010,
        0.0065,
        "estimate: calibration of ball bars to 1 to 5 µm, which VDI/VDE 2634-2 and ISO 10360-13 ask for without a number",
    ),
    "board_mm": Range(0.004, 0.035, "estimate: flatness of boards as in objects.bent"),
    "board_scale": Range(
        4e-6,
        4.5e-5,
        "estimate: 8e-6 (glass) to 23e-6 per K (aluminium), up to 2 K from the temperature of the certificate",
    ),
    "moved_deg": Range(0.002, 0.013, "estimate: reseating of a clamped camera by 1 to 5 µm over 25 mm"),
    "moved_mm": Range(0.003, 0.026, "estimate: the same, as a shift"),
    "refocus": Range(
        4e-5, 2.8e-4, "estimate: principal distance over 3 to 12 K of glass and aluminium, as in optics.mounts"
    ),
}
"""Ranges of the standard deviations of ``truth``; the others are as in the realistic set."""


def drawn_tolerances(seed: int) -> dict[str, float]:
    """Return the standard deviations for the rig of ``seed``."""
    return drawn_strengths(RANGES, np.random.default_rng([seed, STREAM]))
