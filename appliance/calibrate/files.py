"""Description of a calibration file for people."""

from __future__ import annotations

import math
from typing import Any

from appliance.measure import Calibration, of_side


def describe_calibration(calibration: Calibration) -> dict[str, Any]:
    """Return the content of a calibration file as names and values for people."""
    left, right = calibration.rig.left, calibration.rig.right
    # A lens that was calibrated in water includes the effect of its port: distance and tilt have no meaning then.
    has_ports = not (left.lens_in_water or right.lens_in_water)
    return {
        "rig_serial": calibration.rig_serial,
        "camera_serials": " / ".join(calibration.camera_serials) if calibration.camera_serials else None,
        "method": calibration.method,
        "made_at": calibration.made_at,
        "made_from": "; ".join(calibration.made_from),
        "residual_px": calibration.residual_px,
        "water_index": calibration.water.index,
        "size_px": f"{left.width_px}x{left.height_px}",
        "principal_distance_px": f"{left.lens.f_px[0]:.2f} / {right.lens.f_px[0]:.2f}",
        "interface_distance_mm": f"{left.port.distance_mm:.3f} / {right.port.distance_mm:.3f}" if has_ports else None,
        "port_tilt_deg": (
            f"{_tilt_deg(calibration, 'left'):.3f} / {_tilt_deg(calibration, 'right'):.3f}" if has_ports else None
        ),
        "baseline_mm": sum(x * x for x in right.translation_mm) ** 0.5,
        "hash": calibration.hash,
    }


def _tilt_deg(calibration: Calibration, side: str) -> float:
    port = of_side(calibration.rig, side).port
    return math.degrees(math.acos(min(1.0, port.normal[2])))
