"""The package ``fringes`` on one camera's eight sine images: ``python fringes_package.py FRAMES.npz``; prints JSON.

Wrapped phase, brightness and modulation of two directions with one frequency each; it has no Gray code.
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
    cpu_ms = []
    for _ in range(3):
        begun = time.process_time()
        coder.decode(sines, unwrap=False)
        cpu_ms.append((time.process_time() - begun) * 1e3)
    print(json.dumps({"cpu_ms": float(np.median(cpu_ms)), "version": fringes.__version__}))


main()
