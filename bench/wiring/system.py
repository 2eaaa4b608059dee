"""Plan of the entire instrument: cables between devices, supply and ground."""

from __future__ import annotations

from appliance.store.config import load_rig
from bench.wiring.sheet import COLOURS, Point, Sheet
from drivers.board.firmware import pins

VIDEO, USB3, USB2 = COLOURS["sync"], "#1565c0", "#00897b"


def system_plan() -> Sheet:
    """Draw the sheet, with modes and identities of the packaged rig file."""
    rig = load_rig()
    projector, display = rig.projector, rig.display
    sheet = Sheet(
        1560, 1130, "The whole instrument",
        "Cables between the parts. Made by ./dev run python -m bench.wiring; modes and identities are those of the packaged "
        "rig file.",
    )  # fmt: skip
    sheet.box(560, 380, 330, 300, "PC", ["x86 with AVX2, 4 GB, two video outputs", "two USB3 root ports, two USB2"])
    sheet.box(40, 150, 300, 110, "left camera", ["USB3 Vision", "a USB3 root port of its own"])
    sheet.box(40, 440, 300, 110, "right camera", ["USB3 Vision", "a USB3 root port of its own"])
    sheet.box(560, 100, 330, 100, "HDMI splitter", ["powered, with the projector's EDID"])
    mode = f"{projector.width_px}×{projector.height_px}, {projector.refresh_hz:g} Hz"
    sheet.box(1180, 84, 340, 120, "projector", [f"{mode}, its panel's own raster", "gamma, keystone, scaling off"])
    sheet.box(1180, 300, 340, 84, "sync tap", ["TFP401 receiver, VSYNC 3.3 V"])
    sheet.box(1180, 480, 340, 200, "trigger board", ["wiring-board.svg"])
    sheet.box(1180, 760, 340, 84, "key pad", ["wiring-keys.svg; behind the wall"])
    size = f"{display.width_px}×{display.height_px}, {display.refresh_hz:g} Hz"
    sheet.box(40, 640, 300, 84, "display", [size])
    sheet.box(40, 780, 300, 84, "two lasers", ["drivers with enable, 1 Ω in the return"])
    sheet.box(560, 760, 330, 84, "sensors and leak electrodes", [", ".join(chip.part for chip in pins.CHIPS)])

    _cable(sheet, [(340, 190), (480, 190), (480, 440), (560, 440)], USB3, "USB3, root port A", (486, 330))
    _cable(sheet, [(340, 480), (560, 480)], USB3, "USB3, root port B", (356, 474))
    _cable(sheet, [(725, 380), (725, 200)], VIDEO, f"HDMI: {projector.connector}", (735, 320))
    _cable(sheet, [(890, 130), (1180, 130)], VIDEO, "HDMI, output 1", (960, 124))
    _cable(sheet, [(890, 175), (1040, 175), (1040, 340), (1180, 340)], VIDEO, "HDMI, output 2", (1050, 334))
    _cable(sheet, [(1350, 384), (1350, 480)], VIDEO, "VSYNC and ground,", (1362, 426), dashed=True)
    sheet.text(1362, 442, "twisted, below 20 cm", colour=VIDEO)
    identity = f"{rig.board.vendor_id:04x}:{rig.board.product_id:04x}"
    _cable(sheet, [(890, 520), (1180, 520)], USB2, f"USB2: board, {identity}", (960, 514))
    identity = f"{rig.keys.vendor_id:04x}:{rig.keys.product_id:04x}"
    _cable(sheet, [(890, 620), (1000, 620), (1000, 800), (1180, 800)], USB2, f"USB2: keys, {identity}", (1010, 794))
    _cable(sheet, [(560, 640), (450, 640), (450, 682), (340, 682)], VIDEO, display.connector or "", (466, 634))
    orange, red = COLOURS["trigger"], COLOURS["laser"]
    sheet.begin("TRIGGER")
    _cable(
        sheet, [(1180, 570), (930, 570), (930, 240), (340, 240)], orange, "trigger: left, with opto return", (520, 234)
    )
    _cable(
        sheet,
        [(1180, 590), (940, 590), (940, 700), (400, 700), (400, 530), (340, 530)],
        orange,
        "trigger: right, with opto return",
        (560, 722),
    )
    sheet.end()
    _cable(
        sheet,
        [(1220, 680), (1220, 720), (960, 720), (960, 890), (190, 890), (190, 864)],
        red,
        "enables and currents of both lasers",
        (220, 884),
    )
    _cable(sheet, [(1300, 680), (1300, 736), (725, 736), (725, 760)], COLOURS["bus"], "I2C, leak wires", (1080, 752))

    sheet.box(
        40,
        960,
        300,
        110,
        "supply from the surface",
        ["or battery; floating from the housing", "fuse, reverse polarity, surge"],
    )
    sheet.box(
        560,
        960,
        330,
        110,
        "DC/DC",
        ["5 V: splitter, tap, display", "12 V: PC, projector", "board, pad, cameras: by USB"],
    )
    sheet.box(
        1180,
        960,
        340,
        110,
        "star point",
        ["at the DC/DC's output, and only there", "board, PC, projector: a wire each"],
    )
    _cable(sheet, [(340, 1015), (560, 1015)], COLOURS["5 V"], "supply, return", (356, 1008))
    _cable(sheet, [(890, 1000), (1180, 1000)], COLOURS["ground"], "ground", (1000, 994))
    sheet.ground(1350, 1070)
    sheet.begin("SUPPLY_SENSE")
    _cable(
        sheet,
        [(1520, 640), (1534, 640), (1534, 912), (725, 912), (725, 960)],
        COLOURS["analogue"],
        "SUPPLY_SENSE: the supply, through the divider on the board",
        (960, 906),
    )
    sheet.end()
    _cable(
        sheet,
        [(850, 960), (850, 932), (1546, 932), (1546, 150), (1520, 150)],
        COLOURS["5 V"],
        "12 V: projector",
        (1000, 948),
    )
    _cable(sheet, [(560, 1000), (530, 1000), (530, 655), (560, 655)], COLOURS["5 V"], "12 V: PC", (470, 952))
    sheet.lines(
        910, 1022,
        ["USB shields: to the chassis at the", "PC's end. Opto returns: to the board", "alone. Housing: no connection to", "the supply."],
        size=10.5,
    )  # fmt: skip
    for number, (name, colour) in enumerate(
        (
            ("USB3", USB3),
            ("USB2", USB2),
            ("video, sync", VIDEO),
            ("trigger", orange),
            ("laser", red),
            ("bus, leak", COLOURS["bus"]),
            ("analogue", COLOURS["analogue"]),
            ("supply", COLOURS["5 V"]),
            ("ground", COLOURS["ground"]),
        )
    ):
        sheet.wire((24 + 130 * number, 1100), (50 + 130 * number, 1100), colour=colour, thick=3.0)
        sheet.text(56 + 130 * number, 1104, name)
    return sheet


def _cable(
    sheet: Sheet, points: list[Point], colour: str, label: str, label_position: Point, *, dashed: bool = False
) -> None:  # fmt: skip
    sheet.wire(*points, colour=colour, thick=2.6, dashed=dashed)
    sheet.text(*label_position, label, size=11, colour=colour)
