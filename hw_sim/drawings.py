"""The designs of the housings in which the simulated world can be built.

Their numbers are stated here and not read from a rig file of the product: a rig file that contradicts its housing must
give wrong results.
"""

from __future__ import annotations

from dataclasses import dataclass

from hw_sim.objects.shapes import BALL_DISTANCE_MM, DEFAULT_POSE

Pose = tuple[float, float, float, float, float, float]

USUAL, COMPACT = "usual", "compact"


@dataclass(frozen=True, slots=True)
class Drawing:
    """One housing as designed; by default the usual one. Lengths in mm, in the rig frame."""

    centre_mm: float = 522.5
    """Distance at which the two axes cross, and the projector is in focus."""
    toe_in_deg: float = 12.41
    half_baseline_mm: float = 115.0
    focal_mm: float = 11.5
    pixel_mm: float = 0.0045
    camera_px: float = 1600.0
    """Width of the sensor; smaller images bin it."""
    projector_focal_mm: float = 16.9
    projector_pixel_mm: float = 0.0108
    projector_px: tuple[int, int] = (1024, 768)
    port_mm: float = 30.0
    """Distance of each port from the projection centre behind it."""
    laser_mm: tuple[float, float, float] = (40.0, 0.0, 30.0)
    """Point at which the right laser's beam leaves its port; the left one is its mirror image."""
    laser_aim_x_mm: float = 20.0
    """Distance from the axis at which the beams meet the plane in the middle of the volume, at the axis's height."""
    ball_distance_mm: float = BALL_DISTANCE_MM
    """Ball bar that comes with it."""

    def pose(self, thing: str) -> Pose:
        """Return the default pose of an object before this housing: the usual pose, scaled with the distance."""
        x, y, z, *turns = DEFAULT_POSE[thing]
        nearer = self.centre_mm / Drawing().centre_mm
        return (nearer * x, nearer * y, nearer * z, turns[0], turns[1], turns[2])


DRAWINGS = {
    USUAL: Drawing(),
    COMPACT: Drawing(
        centre_mm=313.0,
        toe_in_deg=10.852,
        half_baseline_mm=60.0,
        focal_mm=10.5,
        pixel_mm=0.00345,
        camera_px=1920.0,
        projector_focal_mm=10.6,
        projector_pixel_mm=0.0054,
        projector_px=(1280, 720),
        port_mm=22.0,
        laser_mm=(26.0, 0.0, 22.0),
        laser_aim_x_mm=13.0,
        ball_distance_mm=70.0,
    ),
}
"""``compact``: for one hand, at 300 mm; cameras of 1920 × 1200 (IMX392) and a projector of 1280 × 720 (DLP3010)."""
