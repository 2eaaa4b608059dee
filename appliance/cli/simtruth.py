"""The calibration that ``kingfisher sim truth=nominal`` brings: what the simulator says its true rig is.

The other sets of true rigs are there to be calibrated. The simulator is found by name, as in ``simrig``; what it says
is the JSON of ``docs/protocols/world.md``, in the rig frame. A calibration that lies in the storage root is never
touched."""

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
"""Name of the true rigs that are built as drawn."""

log = logging.getLogger("kingfisher")


def bring_calibration(rig: Rig) -> None:
    """Give the storage root of a simulated ``rig`` its calibration, if its true rig is the nominal one and there is
    none yet.

    Raises UsageError where the one that lies there was brought for a rig that is not the one of this start,
    StorageError."""
    path = Instrument(rig).calibration_file
    options = rig.rig.wires_options
    # In air the windows refract otherwise: what is true there is no calibration to measure in water with.
    nominal = options.get("truth") == KNOWN_SET and options.get("medium", "water") == "water"
    if nominal and not _calibrated_before(Instrument(rig)):
        # Written like any calibration, before the service starts: nothing in the product knows that it is the truth.
        LocalFileSystem().make_folders(path.parent)
        LocalFileSystem().replace_file(path, encode_calibration(true_calibration(rig)))
        log.info("calibration: that of the simulated instrument as drawn, in %s", path)
    elif not nominal and path.is_file():
        _refuse_nominal(rig)


def true_calibration(rig: Rig) -> Calibration:
    """Return the calibration that states the true rig of a simulated ``rig``; exact where that has neither wedge nor
    lens field."""
    told: Mapping[str, Any] = importlib.import_module(f"{SIMULATOR}.world").true_rig(rig.rig.wires_options).as_dict()
    left, right = told["cameras"]["left"], told["cameras"]["right"]
    return Calibration(
        rig_serial=rig.rig.serial,
        method=METHOD,
        made_at="unknown",
        made_from=(f"the simulated true rig: {told['set']}",),
        water=Water(rig.water.temperature_c, rig.water.salinity_psu, rig.water.wavelength_nm),
        rig=StereoRig(_camera(left, left), _camera(right, left), Instrument(rig).volume),
        camera_serials=(rig.camera.left.serial, rig.camera.right.serial),
    )


def _calibrated_before(instrument: Instrument) -> bool:
    """Tell whether somebody has calibrated, or begun to: what lies there is theirs."""
    measured = (instrument.response_file, instrument.noise_file)
    return instrument.kept_folder.exists() or any(
        path not in measured for path in instrument.calibration_file.parent.glob("*.json")
    )


def _refuse_nominal(rig: Rig) -> None:
    """A calibration that was brought for the nominal rig would give wrong lengths with another, without a word."""
    path = Instrument(rig).calibration_file
    try:
        found = load_calibration(path)
    except CalibrationError:
        return  # the service says what is wrong with it
    if found.method == METHOD and any(one.endswith(f"rig: {KNOWN_SET}") for one in found.made_from):
        raise UsageError(
            f"--root {rig.storage.root}: its calibration is that of truth={KNOWN_SET}, this start has another true rig "
            f"and would measure wrong lengths; give another folder, truth={KNOWN_SET}, or remove {path}"
        )


def _camera(eye: Mapping[str, Any], left: Mapping[str, Any]) -> HousedCamera:
    """Return ``eye`` in the left camera's frame, lengths in mm. R, then t_mm, turn a camera's points into the rig
    frame."""
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
