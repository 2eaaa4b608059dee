"""The package ``fringes`` on one camera's eight sine images: ``python fringes_package.py FRAMES.npz``.

Wrapped phase, brightness and modulation of two directions with one frequency each; it has no Gray code. Says its version
when it is ready, then decodes once for each line it reads and says what that took, as JSON.
"""

import json
import sys
import time

import fringes
import numpy as np


def main() -> None:
    stored = np.load(sys.argv[1])
    sines = stored["left"][stored["sines"]]
    coder = fringes.Fringes()
    coder.D, coder.K, coder.N = 2, 1, 4
    coder.X, coder.Y = int(stored["width_px"]), int(stored["height_px"])
    coder.l = float(stored["period_px"])
    coder.decode(sines, unwrap=False)  # compiles
    print(json.dumps({"version": fringes.__version__}), flush=True)
    for _ in sys.stdin:
        begun = time.process_time()
        coder.decode(sines, unwrap=False)
        print(json.dumps({"cpu_ms": (time.process_time() - begun) * 1e3}), flush=True)


main()
