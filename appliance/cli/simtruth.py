"""The calibration of ``kingfisher sim truth=nominal``: the true rig as the simulator states it.

Other sets of true rigs have to be calibrated. The simulator is found by name, as in ``simrig``; it returns the JSON of
``docs/protocols/world.md``, in the rig frame. An existing calibration in the storage root is never changed.
"""

from __future__ import annotations

import importlib
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.cli.output import UsageError
from appliance.cli.simrig import SIMULATOR
from appliance.measure import (
    Calibration,
    CalibrationError,
    HousedCamera,
    Lens,
    Port,
    StereoRig,
    Water,
    encode_calibration,
)
from appliance.store import Instrument, LocalFileSystem, Rig, load_calibration

METHOD = "truth"
KNOWN_SET = "nominal"
"""Name of the true rig that equals the nominal one."""

log = logging.getLogger("kingfisher")


def bring_calibration(rig: Rig) -> None:
    """Write the calibration of a simulated ``rig`` whose true rig is nominal, if its storage root has none.

    Raises UsageError if an existing one was written for another true rig, StorageError.
    """
    path = Instrument(rig).calibration_file
    options = rig.rig.wires_options
    # In air the ports refract differently, so that the true rig in air is no calibration for water.
    nominal = options.get("truth") == KNOWN_SET and options.get("medium", "water") == "water"
    if nominal and not _calibrated_before(Instrument(rig)):
        # Written like any calibration, before the service starts, so that the product does not know that it is the
        # truth.
        LocalFileSystem().make_folders(path.parent)
        LocalFileSystem().replace_file(path, encode_calibration(true_calibration(rig)))
        log.info("calibration: that of the nominal simulated instrument, in %s", path)
    elif not nominal and path.is_file():
        _refuse_nominal(rig)


def true_calibration(rig: Rig) -> Calibration:
    """Return the calibration that equals the true rig of a simulated ``rig``; exact without wedge and lens field."""
    truth: Mapping[str, Any] = importlib.import_module(f"{SIMULATOR}.world").true_rig(rig.rig.wires_options).as_dict()
    left, right = truth["cameras"]["left"], truth["cameras"]["right"]
    return Calibration(
        rig_serial=rig.rig.serial,
        method=METHOD,
        made_at="unknown",
        made_from=(f"the simulated true rig: {truth['set']}",),
        water=Water(rig.water.temperature_c, rig.water.salinity_psu, rig.water.wavelength_nm),
        rig=StereoRig(_camera(left, left), _camera(right, left), Instrument(rig).volume),
        camera_serials=(rig.camera.left.serial, rig.camera.right.serial),
    )


def _calibrated_before(instrument: Instrument) -> bool:
    """Tell whether the instrument has been calibrated, or a calibration was begun."""
    measured = (instrument.response_file, instrument.noise_file)
    return instrument.kept_folder.exists() or any(
        path not in measured for path in instrument.calibration_file.parent.glob("*.json")
    )


def _refuse_nominal(rig: Rig) -> None:
    """Raise UsageError if the calibration is that of the nominal rig, which differs from the true one.

    Lengths would be wrong without a sign.
    """
    path = Instrument(rig).calibration_file
    try:
        calibration = load_calibration(path)
    except CalibrationError:
        return  # the service says what is wrong with it
    if calibration.method == METHOD and any(source.endswith(f"rig: {KNOWN_SET}") for source in calibration.made_from):
        raise UsageError(
            f"--root {rig.storage.root}: its calibration is for truth={KNOWN_SET}; the simulated rig of this start "
            "differs "
            f"and would measure wrong lengths; give another folder, truth={KNOWN_SET}, or remove {path}"
        )


def _camera(eye: Mapping[str, Any], left: Mapping[str, Any]) -> HousedCamera:
    """Return camera ``eye`` in the left camera frame, lengths in mm.

    R and then t_mm transform a camera's points into the rig frame.
    """
    to_left: NDArray[np.float64] = np.array(left["R"]).T
    rotation = to_left @ np.array(eye["R"])
    t_mm = to_left @ (np.array(eye["t_mm"]) - np.array(left["t_mm"]))
    # Plain floats: a calibration's hash is that of its JSON.
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in rotation)
    port = eye["port"]
    return HousedCamera(
        eye["width_px"],
        eye["height_px"],
        Lens(tuple(eye["f_px"]), tuple(eye["c_px"]), tuple(eye["distortion"])),
        Port(tuple(port["normal"]), port["d_mm"], port["th_mm"], port["n_g"]),
        (a, b, c),
        (float(t_mm[0]), float(t_mm[1]), float(t_mm[2])),
    )
