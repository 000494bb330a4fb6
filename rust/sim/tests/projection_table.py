"""Prints the table pinned in projection.rs: pixels of points by OpenCV, which shares no code with boxline.

The distortion runs from distorted to ideal coordinates, the opposite way to OpenCV's, so it is inverted here by bisection
and cv2.projectPoints gets distorted coordinates and K alone. Needs numpy and opencv-python.
"""

import cv2
import numpy as np

K = np.array([[2431.5, 0.0, 1301.25], [0.0, 2440.25, 968.5], [0.0, 0.0, 1.0]])
K1, K2 = -0.0412, 0.2875
POINTS = [(0, 0, 1000), (120, -80, 350), (-310.5, 205.25, 884), (700, 500, 2400), (-1020, 640, 2015.5), (160, 118, 331),
          (-1200, -900, 2450)]


def distorted(x: float, y: float) -> tuple[float, float]:
    radius = float(np.hypot(x, y))
    low, high = 0.0, radius + 0.2
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle * (1 + K1 * middle**2 + K2 * middle**4) < radius:
            low = middle
        else:
            high = middle
    share = low / radius if radius else 1.0
    return x * share, y * share


for point in POINTS:
    x, y = distorted(point[0] / point[2], point[1] / point[2])
    px, _ = cv2.projectPoints(np.array([[x, y, 1.0]]), np.zeros(3), np.zeros(3), K, None)
    print(f"    ({[float(c) for c in point]}, [{px[0, 0, 0]:.7f}, {px[0, 0, 1]:.7f}]),")
