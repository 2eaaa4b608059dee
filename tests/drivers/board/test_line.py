"""Sentences of the board's line: literal bytes, checksums of an independent source, and garbage of all kinds."""

import binascii

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.board.line import MAX_LINE, Kind, LineSplitter, MalformedLine, Sentence, crc16, format_line, parse_line
from tests.support.damage import damaged

PING = b"$C,7,PING*B7B3\r\n"
ARM = b"$C,8,ARM,24,90124,500,12000*1E87\r\n"
PULSE = b"$R,311,PULSE,0,90124,1502733412*BCCF\r\n"


def test_sentences_are_the_documents_bytes() -> None:
    assert format_line(Sentence(Kind.COMMAND, 7, "PING")) == PING
    assert format_line(Sentence(Kind.COMMAND, 8, "ARM", ("24", "90124", "500", "12000"))) == ARM
    assert parse_line(PULSE) == Sentence(Kind.REPORT, 311, "PULSE", ("0", "90124", "1502733412"))
    assert crc16(b"123456789") == 0x29B1, "the published check value"


def checked(body: bytes) -> bytes:
    return b"$" + body + b"*%04X\r\n" % binascii.crc_hqx(body, 0xFFFF)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (PULSE.replace(b"90124", b"90125"), "checksum"),
        (PULSE.replace(b"BCCF", b"bccf"), "upper-case"),
        (PULSE[:-2] + b"\n", "framed"),
        (PULSE[1:], "framed"),
        (b"$R,311,PULSE\r\n", "no checksum"),
        (checked(b"X,1,PING"), "kind 'X'"),
        (checked(b"R,65536,PING"), "65536"),
        (checked(b"R,-1,PING"), "'-1'"),
        (checked(b"R, 1,PING"), "' 1'"),
        (checked(b"R,1"), "not all there"),
        (checked(b"R,1,P\x07NG"), "printable"),
        (checked(b"R,1,A*B"), "within"),
    ],
)
def test_a_wrong_line_is_named(line: bytes, reason: str) -> None:
    with pytest.raises(MalformedLine, match=reason):
        parse_line(line)


@pytest.mark.parametrize("field", ["a,b", "a$", "a*", "ü", "\r"])
def test_a_field_that_would_break_the_line_is_not_sent(field: str) -> None:
    with pytest.raises(ValueError, match="allowed is printable ASCII"):
        format_line(Sentence(Kind.COMMAND, 1, "X", (field,)))


@pytest.mark.parametrize(
    ("before", "garbage_bytes", "broken_lines"),
    [(b"", 0, 0), (PULSE[9:], len(PULSE) - 9, 0), (PULSE[:20], 20, 1), (b"$" + b"A" * 100_000, None, 1)],
    ids=["nothing", "joined late", "half a line", "an endless line"],
)
def test_a_whole_line_is_found_behind_a_part_of_one(
    before: bytes, garbage_bytes: int | None, broken_lines: int
) -> None:
    splitter = LineSplitter()
    assert splitter.feed(before) == []
    assert splitter.feed(PING) == [PING]
    assert splitter.garbage_bytes == garbage_bytes or garbage_bytes is None
    assert splitter.broken_lines == broken_lines


@given(st.lists(st.binary(max_size=60) | damaged([PING, ARM, PULSE]), max_size=8), st.integers(1, 50))
def test_a_line_after_any_garbage_is_found(garbage: list[bytes], piece: int) -> None:
    splitter = LineSplitter()
    data = b"".join(garbage) + b"\n" + PING
    found = [line for i in range(0, len(data), piece) for line in splitter.feed(data[i : i + piece])]
    assert found[-1] == PING
    for line in found:
        try:
            sentence = parse_line(line)
        except MalformedLine:
            continue
        assert format_line(sentence).startswith(b"$")


printable = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters=",$*"), max_size=12)


@given(st.sampled_from(Kind), st.integers(0, 65535), printable, st.lists(printable, max_size=6))
def test_what_is_sent_is_what_is_read(kind: Kind, sequence: int, verb: str, fields: list[str]) -> None:
    sentence = Sentence(kind, sequence, verb, tuple(fields))
    assert parse_line(format_line(sentence)) == sentence


def test_a_line_of_the_greatest_length_is_read_and_one_byte_more_is_not() -> None:
    fits = Sentence(Kind.REPORT, 1, "X", ("a" * (MAX_LINE - len(format_line(Sentence(Kind.REPORT, 1, "X", ("",))))),))
    assert len(format_line(fits)) == MAX_LINE
    assert LineSplitter().feed(format_line(fits)) == [format_line(fits)]
    assert parse_line(format_line(fits)) == fits
    with pytest.raises(MalformedLine, match=f"{MAX_LINE + 1} bytes"):
        parse_line(checked(b"R,1,X," + b"a" * (len(fits.fields[0]) + 1)))
