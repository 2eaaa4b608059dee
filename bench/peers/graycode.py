"""OpenCV's Gray-code decoder on both cameras' frames: ``python graycode.py FRAMES.npz``; prints JSON.

It wants each image and its inverse: the inverse of a Gray image is bright + dark − image. It numbers half periods, gives
whole numbers, and decodes and matches in one call.
"""

import json
import sys
import time

import cv2
import numpy as np


def images(frames: np.ndarray, gray: list[int]) -> list[np.ndarray]:
    total = frames[0].astype(np.int16) + frames[1]
    made = []
    for k in gray:
        made += [frames[k], np.clip(total - frames[k], 0, 255).astype(np.uint8)]
    return made


def main() -> None:
    stored = np.load(sys.argv[1])
    gray_x, gray_y = stored["gray_x"].tolist(), stored["gray_y"].tolist()
    decoder = cv2.structured_light.GrayCodePattern.create(1 << len(gray_x), 1 << len(gray_y))
    both = [images(stored[side], gray_x + gray_y) for side in ("left", "right")]
    bright, dark = ([stored[side][k] for side in ("left", "right")] for k in (0, 1))
    cpu_ms = []
    for _ in range(3):
        begun = time.process_time()
        decoder.decode(both, None, dark, bright)
        cpu_ms.append((time.process_time() - begun) * 1e3)
    print(json.dumps({"cpu_ms": float(np.median(cpu_ms)), "version": cv2.__version__}))


main()
