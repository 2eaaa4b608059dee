"""Owns how the safe screen looks: rows of pixels, blue, green, red, unused, as displays take them."""

from __future__ import annotations

from dataclasses import dataclass

from kingfisher_safe import font

BLACK, WHITE, GREY = b"\x00\x00\x00\x00", b"\xff\xff\xff\x00", b"\xc0\xc0\xc0\x00"
RED, YELLOW = b"\x20\x20\xc8\x00", b"\x00\xd8\xff\x00"
DOTS_WIDE = 200
"""A display is so many of the smallest letters' dots wide, or a little more: 33 letters."""


@dataclass(frozen=True, slots=True)
class Notice:
    """What the diver is told."""

    title: str
    headline: str
    """In a few words what is wrong."""
    action: str
    detail: str
    """For the technician, word for word."""
    scans: str
    """What became of the scans."""
    keys: str
    """What a key does now and, in a line of its own, what happens without one."""


class Picture:
    """A drawing, ``rows`` from top to bottom."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self.width_px, self.height_px = width_px, height_px
        self.rows = [bytearray(BLACK * width_px) for _ in range(height_px)]

    def fill(self, x: int, y: int, width_px: int, height_px: int, colour: bytes) -> None:
        """A rectangle; what is outside is cut off."""
        left, right = max(0, x), min(self.width_px, x + width_px)
        if left >= right:
            return
        line = colour * (right - left)
        for row in self.rows[max(0, y) : max(0, y + height_px)]:
            row[4 * left : 4 * right] = line

    def text(self, x: int, y: int, text: str, dot_px: int, colour: bytes) -> None:
        """One line of letters whose dots are ``dot_px`` wide."""
        for place, character in enumerate(text):
            at = x + place * font.ADVANCE * dot_px
            for down, row in enumerate(font.letter(character)):
                for across, dot in enumerate(row):
                    if dot:
                        self.fill(at + across * dot_px, y + down * dot_px, dot_px, dot_px, colour)


def draw(notice: Notice, width_px: int, height_px: int) -> Picture:
    """The page for a display of this size."""
    picture = Picture(width_px, height_px)
    dot = max(1, width_px // DOTS_WIDE)
    margin = 4 * dot
    columns = (width_px - 2 * margin) // (font.ADVANCE * dot)
    large = max(dot, min(dot + dot // 2, (width_px - 2 * margin) // (font.ADVANCE * max(1, len(notice.title)))))
    band = (font.HEIGHT + 6) * large
    picture.fill(0, 0, width_px, band, RED)
    picture.text(margin, 3 * large, notice.title, large, WHITE)

    keys = [line for part in notice.keys.splitlines() for line in font.wrap(part, columns, 2)]
    foot = height_px - margin - len(keys) * font.LINE * dot
    for number, line in enumerate(keys):
        picture.text(margin, foot + number * font.LINE * dot, line, dot, WHITE)
    picture.fill(0, foot - 3 * dot, width_px, max(1, dot // 2), GREY)

    small = max(1, dot // 2)
    y = band + 4 * dot
    room = foot - 6 * dot
    for text, size, colour, lines in (
        (notice.headline, dot, YELLOW, 2),
        (notice.action, dot, WHITE, 3),
        (notice.scans, dot, WHITE, 2),
        (notice.detail, small, GREY, 99),
    ):
        step = font.LINE * size
        fitting = min(lines, max(0, (room - y) // step))
        if not fitting:
            break
        for line in font.wrap(text, (width_px - 2 * margin) // (font.ADVANCE * size), fitting):
            picture.text(margin, y, line, size, colour)
            y += step
        y += 3 * dot
    return picture
