"""Three camera personalities: initial values, limits and rules of FLIR, Basler and Allied Vision cameras.

They imitate behaviour, not electronics. A value with a source has it beside it; "estimate" marks common behaviour of
such cameras, chosen so that a careless host fails.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass

from hw_sim.devices.features import (
    AnyFeature,
    BooleanFeature,
    CommandFeature,
    EnumerationFeature,
    FloatFeature,
    IntegerFeature,
    ReadOnlyInteger,
    Value,
    numbered,
    split_key,
)
from hw_sim.devices.u3v_stream import StreamRules

PIXEL_FORMATS = {
    "Mono8": 0x01080001,
    "Mono10": 0x01100003,
    "Mono10p": 0x010A0046,
    "Mono12": 0x01100005,
    "Mono12p": 0x010C0047,
    "Mono16": 0x01100007,
}
"""Numbers of the pixel format naming convention (PFNC 2.0), grey formats."""
DEVICE, IMAGE, ACQUISITION, ANALOG = "DeviceControl", "ImageFormatControl", "AcquisitionControl", "AnalogControl"
DIGITAL_IO, CHUNK, USER_SET, TRANSPORT = (
    "DigitalIOControl",
    "ChunkDataControl",
    "UserSetControl",
    "TransportLayerControl",
)
LUT = "LUTControl"
DEFAULT_SET, OWNERS_SET = "Default", "UserSet1"
FRAME_START = "FrameStart"


@dataclass(frozen=True, slots=True)
class Maker:
    """The camera of a maker: data only; ``feature_book.py`` implements the behaviour."""

    vendor: str
    model: str
    family: str
    vendor_id: int
    """USB vendor number of Point Grey/FLIR, Basler or Allied Vision, from the USB implementers' list."""
    product_id: int
    border_px: tuple[int, int]
    """Columns and rows of the sensor beyond the world's image, half of them on each side."""
    readout_ns: int
    """Time to read the whole sensor: the reciprocal of the highest frame rate."""
    trigger_line: str
    """The input with the trigger board's pulse."""
    overlap: tuple[str, str] | None
    """Feature and value that allow an exposure to begin during readout; ``None``: it always may."""
    black_dn: float
    """Grey values of 8 bits for one unit of BlackLevel."""
    width_offset_us: int
    """Exposure time beyond the width of the pulse in exposure mode TriggerWidth."""
    mode_after_source: bool
    """ExposureMode takes effect only if TriggerMode and TriggerSource were set before."""
    stream: StreamRules
    features: tuple[AnyFeature, ...]

    def settable(self) -> dict[str, EnumerationFeature | IntegerFeature | FloatFeature | BooleanFeature]:
        """Return the features that have a value, by name."""
        return {f.name: f for f in self.features if not isinstance(f, CommandFeature | ReadOnlyInteger)}


def _common(
    *,
    step_px: tuple[int, int, int, int],
    formats: tuple[str, ...],
    selectors: tuple[str, ...],
    selector: str,
    lines: tuple[str, ...],
    line_modes: Mapping[str, str],
    source: str,
    activations: tuple[str, ...],
    autos: str,
    black: tuple[float, float, float],
    gamma: float,
    exposure_us: float,
    most_gain_db: float,
    throughput: tuple[int, int],
    decimates: bool,
) -> tuple[AnyFeature, ...]:
    """Return the features that all three have, with the names of the SFNC; the arguments are their differences.

    ``step_px``: of width, height and both offsets. ``throughput``: factory value and highest, bytes per second.
    """
    width, height, x, y = step_px
    lowest, start, highest = black
    mono8 = PIXEL_FORMATS["Mono8"]
    return (
        IntegerFeature(
            name="DeviceLinkThroughputLimit",
            category=DEVICE,
            tip="Bytes per second that the camera sends at most; the sensor is read no faster.",
            factory=throughput[0],
            low=1_000_000,
            high=throughput[1],
            unit="Bps",
        ),
        ReadOnlyInteger(name="SensorWidth", category=IMAGE, tip="Columns of the sensor.", unit="px"),
        ReadOnlyInteger(name="SensorHeight", category=IMAGE, tip="Rows of the sensor.", unit="px"),
        ReadOnlyInteger(name="WidthMax", category=IMAGE, tip="Columns after binning and decimation.", unit="px"),
        ReadOnlyInteger(name="HeightMax", category=IMAGE, tip="Rows after binning and decimation.", unit="px"),
        *(
            IntegerFeature(
                name=name,
                category=IMAGE,
                tip=tip,
                factory=8192 if low else 0,
                low=low,
                high=8192,
                step=step,
                unit="px",
                shapes=True,
                computed=True,
            )
            for name, tip, step, low in (
                ("Width", "Columns of the image.", width, 16),
                ("Height", "Rows of the image.", height, height),
                ("OffsetX", "First column.", x, 0),
                ("OffsetY", "First row.", y, 0),
            )
        ),
        *(
            IntegerFeature(name=name, category=IMAGE, tip=f"{verb} as many.", factory=1, low=1, high=4, shapes=True)
            for name, verb in (
                ("BinningHorizontal", "Joins columns,"),
                ("BinningVertical", "Joins rows,"),
                *(
                    (("DecimationHorizontal", "Keeps one column of"), ("DecimationVertical", "Keeps one row of"))
                    if decimates
                    else ()
                ),
            )
        ),
        BooleanFeature(name="ReverseX", category=IMAGE, tip="Mirrors left and right.", factory=False, shapes=True),
        BooleanFeature(name="ReverseY", category=IMAGE, tip="Mirrors top and bottom.", factory=False, shapes=True),
        EnumerationFeature(
            name="PixelFormat",
            category=IMAGE,
            tip="Format of a pixel on the wire.",
            codes={"Mono8": mono8, **{word: PIXEL_FORMATS[word] for word in formats}},
            factory="Mono8",
            shapes=True,
        ),
        EnumerationFeature(
            name="TestPattern",
            category=IMAGE,
            tip="Sends a drawn picture instead of the sensor's.",
            codes=numbered("Off", "GreyHorizontalRamp", "GreyVerticalRamp"),
            factory="Off",
        ),
        EnumerationFeature(
            name="AcquisitionMode",
            category=ACQUISITION,
            tip="How many frames an acquisition has.",
            codes=numbered("Continuous", "SingleFrame", "MultiFrame"),
            factory="Continuous",
            shapes=True,
        ),
        IntegerFeature(
            name="AcquisitionFrameCount",
            category=ACQUISITION,
            tip="Frames in mode MultiFrame.",
            factory=1,
            low=1,
            high=65_535,
        ),
        IntegerFeature(
            name="AcquisitionBurstFrameCount",
            category=ACQUISITION,
            tip="Frames that a FrameBurstStart trigger allows.",
            factory=1,
            low=1,
            high=1023,
        ),
        CommandFeature(name="AcquisitionStart", category=ACQUISITION, tip="Starts the acquisition."),
        CommandFeature(name="AcquisitionStop", category=ACQUISITION, tip="Ends the acquisition."),
        BooleanFeature(
            name="AcquisitionFrameRateEnable",
            category=ACQUISITION,
            tip="No two frames come sooner than AcquisitionFrameRate says, triggered ones neither.",
            factory=False,
        ),
        FloatFeature(
            name="AcquisitionFrameRate",
            category=ACQUISITION,
            tip="Rate of a free-running acquisition, and limit of a triggered one.",
            factory=30.0,
            low=1.0,
            high=200.0,
            unit="Hz",
        ),
        EnumerationFeature(
            name="TriggerSelector",
            category=ACQUISITION,
            tip="Which trigger the trigger features are about.",
            codes=numbered(*selectors),
            factory=selector,
        ),
        EnumerationFeature(
            name="TriggerMode",
            category=ACQUISITION,
            tip="Whether that trigger is waited for.",
            selector="TriggerSelector",
            codes=numbered("Off", "On"),
            factory="Off",
        ),
        EnumerationFeature(
            name="TriggerSource",
            category=ACQUISITION,
            tip="Where the trigger comes from.",
            selector="TriggerSelector",
            codes={**numbered(*lines), "Software": 16},
            factory=source,
        ),
        EnumerationFeature(
            name="TriggerActivation",
            category=ACQUISITION,
            tip="Edge of the line that triggers.",
            selector="TriggerSelector",
            codes=numbered(*activations),
            factory="RisingEdge",
        ),
        FloatFeature(
            name="TriggerDelay",
            category=ACQUISITION,
            tip="Time from the trigger to what it starts.",
            selector="TriggerSelector",
            factory=0.0,
            low=0.0,
            high=1_000_000.0,
            unit="us",
        ),
        CommandFeature(
            name="TriggerSoftware",
            category=ACQUISITION,
            tip="Triggers, if the source is Software.",
            selector="TriggerSelector",
        ),
        EnumerationFeature(
            name="ExposureMode",
            category=ACQUISITION,
            tip="What ends an exposure.",
            codes=numbered("Timed", "TriggerWidth"),
            factory="Timed",
        ),
        EnumerationFeature(
            name="ExposureAuto",
            category=ACQUISITION,
            tip="Whether the camera chooses the exposure time.",
            codes=numbered("Off", "Once", "Continuous"),
            factory=autos,
        ),
        FloatFeature(
            name="ExposureTime",
            category=ACQUISITION,
            tip="Duration of an exposure in mode Timed.",
            factory=exposure_us,
            low=20.0,
            high=1_000_000.0,
            unit="us",
            auto="ExposureAuto",
        ),
        EnumerationFeature(
            name="GainSelector",
            category=ANALOG,
            tip="Which gain the gain features are about.",
            codes=numbered("All"),
            factory="All",
        ),
        EnumerationFeature(
            name="GainAuto",
            category=ANALOG,
            tip="Whether the camera chooses the gain.",
            codes=numbered("Off", "Once", "Continuous"),
            factory=autos,
        ),
        FloatFeature(
            name="Gain",
            category=ANALOG,
            tip="Amplification.",
            selector="GainSelector",
            factory=0.0,
            low=0.0,
            high=most_gain_db,
            unit="dB",
            auto="GainAuto",
        ),
        EnumerationFeature(
            name="BlackLevelSelector",
            category=ANALOG,
            tip="Which black level is meant.",
            codes=numbered("All"),
            factory="All",
        ),
        FloatFeature(
            name="BlackLevel",
            category=ANALOG,
            tip="Added to every pixel.",
            selector="BlackLevelSelector",
            factory=start,
            low=lowest,
            high=highest,
        ),
        FloatFeature(
            name="Gamma", category=ANALOG, tip="Exponent of the grey values.", factory=gamma, low=0.25, high=4.0
        ),
        EnumerationFeature(
            name="LineSelector",
            category=DIGITAL_IO,
            tip="Which line the line features are about.",
            codes=numbered(*lines),
            factory=lines[0],
        ),
        EnumerationFeature(
            name="LineMode",
            category=DIGITAL_IO,
            tip="Whether the line is an input or an output.",
            selector="LineSelector",
            codes=numbered("Input", "Output"),
            factory="Input",
            differing=line_modes,
        ),
        BooleanFeature(
            name="LineInverter",
            category=DIGITAL_IO,
            tip="A rising edge counts as a falling one.",
            selector="LineSelector",
            factory=False,
        ),
        BooleanFeature(
            name="ChunkModeActive",
            category=CHUNK,
            tip="Appends data to the pixels of each payload.",
            factory=False,
            shapes=True,
        ),
        EnumerationFeature(
            name="UserSetSelector",
            category=USER_SET,
            tip="Which set of values the commands are about.",
            codes=numbered(DEFAULT_SET, OWNERS_SET),
            factory=DEFAULT_SET,
        ),
        CommandFeature(name="UserSetLoad", category=USER_SET, tip="Takes over all values of the set."),
        ReadOnlyInteger(name="PayloadSize", category=TRANSPORT, tip="Bytes of a payload.", unit="B"),
        IntegerFeature(
            name="TLParamsLocked",
            category=TRANSPORT,
            tip="Set by the host while the stream runs: locks what changes the payload.",
            factory=0,
            low=0,
            high=1,
        ),
    )


def _limit_mode() -> EnumerationFeature:
    return EnumerationFeature(
        name="DeviceLinkThroughputLimitMode",
        category=DEVICE,
        tip="Whether DeviceLinkThroughputLimit counts.",
        codes=numbered("Off", "On"),
        factory="On",
    )


BLACKFLY = Maker(
    vendor="FLIR",
    model="Blackfly S BFS-U3-19S4M",
    family="BFS",
    vendor_id=0x1E10,
    product_id=0x4000,
    border_px=(16, 40),  # 1616 x 1240, FLIR's page of the BFS-U3-19S4M
    readout_ns=7_630_000,  # 131 frames per second, the same page
    trigger_line="Line0",  # the opto-isolated input, the same page
    # Off in the factory: 40 Hz triggers gave 20 frames per second until ReadOut (reported of ROS' flir_camera_driver).
    overlap=("TriggerOverlap", "ReadOut"),
    black_dn=2.55,  # BlackLevel is in percent of the full scale
    width_offset_us=14,  # estimate: Pregius sensors add some lines' time
    mode_after_source=False,
    # An alignment field of 0 is legal, and Point Grey cameras say 0 for the sizes of leader and trailer until the stream was
    # enabled once (both reported of Aravis).
    stream=StreamRules(alignment_log2=0, sizes_once_enabled=True),
    features=(
        *_common(
            step_px=(4, 2, 4, 2),  # estimate
            formats=("Mono10p", "Mono12p", "Mono16"),
            selectors=("AcquisitionStart", FRAME_START, "FrameBurstStart"),
            selector=FRAME_START,
            lines=("Line0", "Line1", "Line2", "Line3"),
            line_modes={"Line1": "Output"},
            source="Line0",
            activations=("RisingEdge", "FallingEdge", "AnyEdge"),
            autos="Continuous",  # Blackfly S manual, as is GammaEnable
            black=(0.0, 0.0, 10.0),  # estimate
            gamma=0.8,  # estimate: what SpinView shows of a camera out of its box
            exposure_us=5_000.0,
            most_gain_db=47.0,
            throughput=(380_000_000, 380_000_000),
            decimates=True,
        ),
        EnumerationFeature(
            name="TriggerOverlap",
            category=ACQUISITION,
            tip="Whether a trigger is taken while the last frame is read out.",
            selector="TriggerSelector",
            codes=numbered("Off", "ReadOut"),
            factory="Off",
        ),
        BooleanFeature(name="GammaEnable", category=ANALOG, tip="Whether Gamma counts.", factory=True),
        BooleanFeature(
            name="LUTEnable",
            category=LUT,
            tip="Sends the values through a table, which brightens the dark ones.",
            factory=False,
        ),
    ),
)
"""A FLIR Blackfly S."""

ACE = Maker(
    vendor="Basler",
    model="a2A1920-160umBAS",
    family="ace 2",
    vendor_id=0x2676,
    product_id=0xBA02,
    border_px=(320, 0),  # 1920 x 1200, Basler's page of the a2A1920-160um
    readout_ns=6_250_000,  # about 160 frames per second, the same page
    trigger_line="Line1",  # the opto-isolated input, the same page
    # The dart overlaps by OverlapMode, the ace by itself (Basler's documentation, overlapping image acquisition).
    overlap=("OverlapMode", "On"),
    black_dn=1.0,  # BlackLevel is in grey values of 8 bits
    width_offset_us=28,  # "C4" of the ace's manual; its size here is an estimate
    mode_after_source=True,  # ace U3 manual, exposure mode
    stream=StreamRules(),
    features=(
        *_common(
            step_px=(8, 2, 4, 2),  # estimate
            formats=("Mono10", "Mono10p", "Mono12", "Mono12p"),
            selectors=("FrameBurstStart", FRAME_START),
            selector="FrameBurstStart",  # estimate: the harsher one; models differ
            lines=("Line1", "Line2", "Line3"),
            line_modes={"Line2": "Output"},
            source="Software",  # estimate: models differ
            activations=("RisingEdge", "FallingEdge", "AnyEdge"),
            autos="Off",
            black=(0.0, 0.0, 32.0),  # estimate
            gamma=1.0,
            exposure_us=5_000.0,
            most_gain_db=48.0,
            # The dart comes with 67 frames per second of 1936 x 1216, which are 158 MB/s (Basler's page of the daA1920-160um).
            throughput=(158_000_000, 400_000_000),
            decimates=True,
        ),
        _limit_mode(),
        EnumerationFeature(
            name="OverlapMode",
            category=ACQUISITION,
            tip="Whether an exposure may begin while the last frame is read out.",
            codes=numbered("Off", "On"),
            factory="On",
        ),
        FloatFeature(
            name="ExposureOverlapTimeMax",
            category=ACQUISITION,
            tip="In mode TriggerWidth an exposure begins no sooner than this before the end of the last readout.",
            factory=100_000.0,
            low=0.0,
            high=1_000_000.0,
            unit="us",
        ),
    ),
)
"""A Basler ace 2, with the dart's throughput limit and OverlapMode."""

ALVIUM = Maker(
    vendor="Allied Vision",
    model="1800 U-240m",
    family="Alvium",
    vendor_id=0x1AB2,
    product_id=0x0001,
    border_px=(336, 16),  # 1936 x 1216, Allied Vision's page of the 1800 U-240
    readout_ns=9_500_000,  # above 100 frames per second, the same page
    trigger_line="Line0",
    overlap=None,
    black_dn=0.0625,  # BlackLevel is in grey values of 12 bits
    width_offset_us=20,  # the Alvium's guide names an offset; its size here is an estimate
    mode_after_source=False,
    # SI_INFO 0x0a000000, and transfers that are no multiples are refused (reported of Aravis).
    stream=StreamRules(alignment_log2=10, aligned_leader=True),
    features=(
        *_common(
            step_px=(8, 2, 8, 2),  # estimate
            formats=("Mono10", "Mono10p", "Mono12", "Mono12p"),
            selectors=("AcquisitionStart", "AcquisitionEnd", FRAME_START, "ExposureStart", "ExposureActive"),
            selector="AcquisitionStart",  # Alvium features reference
            lines=("Line0", "Line1", "Line2", "Line3"),
            line_modes={"Line2": "Output", "Line3": "Output"},  # estimate
            source="Software",  # Alvium features reference
            activations=("RisingEdge", "FallingEdge", "AnyEdge"),
            autos="Off",
            black=(0.0, 0.0, 255.0),
            gamma=1.0,
            exposure_us=5_000.0,
            most_gain_db=24.0,
            throughput=(200_000_000, 450_000_000),  # Alvium features reference
            decimates=False,
        ),
        _limit_mode(),
    ),
)
"""An Allied Vision Alvium."""

MAKERS: Mapping[str, Maker] = {"blackfly": BLACKFLY, "ace": ACE, "alvium": ALVIUM}
"""The personalities by their names in the world's options."""


def check_saved(maker: Maker, saved: Mapping[str, Value]) -> None:
    """Check an owner's set of values. Raises ValueError with the feature and the allowed values."""
    settable = maker.settable()
    for key, value in saved.items():
        name, word = split_key(key)
        feature = settable.get(name)
        if feature is None:
            near = difflib.get_close_matches(name, settable, 1)
            remedy = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(sorted(settable))}"
            raise ValueError(f"saved: {maker.model} has no feature '{name}'; {remedy}")
        if word is not None:
            selector = None if feature.selector is None else settable[feature.selector]
            if not isinstance(selector, EnumerationFeature) or word not in selector.codes:
                allowed = ", ".join(selector.codes) if isinstance(selector, EnumerationFeature) else "none"
                raise ValueError(f"saved: {name}[{word}]; allowed in brackets are {allowed}")
        feature.code(value)
