"""OpenCV's Gray-code decoder on both cameras' frames: ``python graycode.py FRAMES.npz``.

It takes each image and its inverse: the inverse of a Gray image is bright + dark − image. It numbers half periods,
gives whole numbers, and decodes and matches in one call. The program prints the version when it is ready, then decodes
once for each line of stdin and prints the time, as JSON.
"""

import json
import sys
import time

import cv2
import numpy as np


def images(frames: np.ndarray, gray: list[int]) -> list[np.ndarray]:
    total = frames[0].astype(np.int16) + frames[1]
    pairs = []
    for k in gray:
        pairs += [frames[k], np.clip(total - frames[k], 0, 255).astype(np.uint8)]
    return pairs


def main() -> None:
    stored = np.load(sys.argv[1])
    gray_x, gray_y = stored["gray_x"].tolist(), stored["gray_y"].tolist()
    decoder = cv2.structured_light.GrayCodePattern.create(1 << len(gray_x), 1 << len(gray_y))
    images_of_sides = [images(stored[side], gray_x + gray_y) for side in ("left", "right")]
    bright, dark = ([stored[side][k] for side in ("left", "right")] for k in (0, 1))
    decoder.decode(images_of_sides, None, dark, bright)
    print(json.dumps({"version": cv2.__version__}), flush=True)
    for _ in sys.stdin:
        begun = time.process_time()
        decoder.decode(images_of_sides, None, dark, bright)
        print(json.dumps({"cpu_ms": (time.process_time() - begun) * 1e3}), flush=True)


main()
