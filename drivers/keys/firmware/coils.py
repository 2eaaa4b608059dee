"""The decision whether a coil's count is a press, by a rest value that follows drift and a threshold.

Counts come at a steady rate, some 80 a second; their unit depends on the chip, only ratios are used. Integers alone, in
256ths of a count.
"""

PRESS_PPM = 300
"""Change of the count at which a key is pressed: a wall of 1 mm bends by some micrometres under a gloved finger."""
RELEASE_PERCENT = 60
"""Part of the press threshold at which a key is released: a finger that trembles there does not bounce for ever."""
NOISE_FACTOR = 6
"""The threshold is at least so many mean differences of successive samples, which do not depend on drift."""
REST_SHIFT = 8
"""The resting value follows by 1/256 of the difference a sample, within 3 s: depth and warmth take longer, fingers
less.
"""
NOISE_SHIFT = 6
LONGEST_PRESS = 4800
"""Samples of the longest press, one minute: a longer one is drift, and its value the new rest."""
TURNED = 3
"""Samples beyond the threshold on the other side after which their value is the rest: the key was held at power-on."""
TRIES = 3
"""Samples in a row without a count, or with one, that make a coil faulty, or whole."""


class CoilFollower:
    """One coil: counts in, pressed and faulty out."""

    def __init__(self) -> None:
        self._rest: int | None = None
        self._before = 0
        self._noise = 0
        self._held = 0
        self._turned = 0
        self._odd = 0
        self.pressed = False
        self.faulty = False

    def follow(self, count: int | None, raises: bool) -> None:
        """Take the next sample, ``None`` where the coil gave none.

        ``raises``: True if a press raises the count, False if it lowers it.
        """
        if (count is None) == self.faulty:
            self._odd = 0
        else:
            self._odd += 1
            if self._odd == TRIES:
                self._odd = 0
                self.faulty = count is None
                # Earlier values do not apply to the coil that is there now.
                self._rest = None
                self.pressed = False
        if count is not None and not self.faulty:
            self._sample(count << 8, 1 if raises else -1)

    def threshold(self) -> int:
        """Return the press threshold in 256ths of a count."""
        if self._rest is None:
            return 0
        return max(self._rest // 1_000_000 * PRESS_PPM, self._noise * NOISE_FACTOR, 256)

    def _sample(self, value: int, sign: int) -> None:
        if self._rest is None:
            self._begin(value)
            return
        difference = abs(value - self._before)
        self._before = value
        shift = (value - self._rest) * sign
        threshold = self.threshold()
        if shift < -threshold:
            self._turned += 1
            if self._turned == TURNED:
                self._begin(value)
            return
        self._turned = 0
        self.pressed = shift >= (threshold * RELEASE_PERCENT // 100 if self.pressed else threshold)
        if self.pressed:
            # The rest stands still: a finger is no drift.
            self._held += 1
            if self._held == LONGEST_PRESS:
                self._begin(value)
            return
        self._held = 0
        self._rest += (value - self._rest) >> REST_SHIFT
        self._noise += (difference - self._noise) >> NOISE_SHIFT

    def _begin(self, value: int) -> None:
        """Take ``value`` as the rest value."""
        self._rest = self._before = value
        self._held = 0
        self._turned = 0
        self.pressed = False
