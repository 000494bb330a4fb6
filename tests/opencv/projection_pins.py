"""The referee of rust/core/tests/camera_pins.rs: projections by OpenCV, which shares no code with boxline.

    pip install opencv-python-headless==5.0.0.* numpy
    python tests/opencv/projection_pins.py          # prints the tables of camera_pins.rs

boxline's distortion polynomial goes from the distorted to the ideal coordinate, OpenCV's the other way. So OpenCV's
projectPoints (K = I, coefficients k1, k2, p1, p2, k3), fed with the *distorted* coordinate, returns boxline's ideal ray, and
OpenCV's undistortPoints takes an ideal ray back to the distorted coordinate. K itself is applied as a homography, because
OpenCV's cameras have no skew.
"""

import cv2
import numpy as np

VERSION = "5.0.0.93"  # of opencv-python-headless when the tables were made

# The paper's Table 2 (tests/data/calibration_set/calibration.json), and a made-up one with skew and barrel distortion.
CAMERAS = {
    "HEAD": dict(fx=2458.9172, fy=2453.81, skew=0.0, cx=1239.5188, cy=1032.559, k1=-0.03415937, k2=0.321070446),
    "SKEWED": dict(fx=2310.25, fy=2295.5, skew=3.75, cx=1311.0, cy=950.25, k1=0.11, k2=0.043),
    "DECENTRED": dict(fx=2401.5, fy=2399.25, skew=0.0, cx=1288.75, cy=990.5, k1=-0.08, k2=0.21, p1=0.0078, p2=-0.0043, k3=-0.12),
}
LASERS = [
    (0.0079291, -0.00817394, 0.00018065),
    (0.01078476, -0.01121147, 0.00223845),
    (0.01037354, 0.00959161, 0.00170705),
    (0.00799885, 0.00730513, -0.00038506),
]
PIXELS = [(-0.5, -0.5), (2591.5, 1943.5), (2591.5, -0.5), (-0.5, 1943.5), (0, 0), (1239.5188, 1032.559), (1295.5, 971.5),
          (12.25, 1000.75), (2570.5, 1010.125), (1250.0, 3.5), (640.125, 480.875), (1900.6, 1500.3)]
RAYS = [(0.0, 0.0), (0.51, 0.37), (-0.52, -0.41), (-0.3, 0.2), (0.25, -0.35), (1e-7, -2e-7), (0.05, 0.4), (-0.5, 0.01)]
I = np.eye(3)


def k_of(c):
    return np.array([[c["fx"], c["skew"], c["cx"]], [0, c["fy"], c["cy"]], [0, 0, 1.0]])


def homography(matrix, points):
    return cv2.perspectiveTransform(np.asarray(points, float).reshape(-1, 1, 2), matrix).reshape(-1, 2)


def coefficients_of(c):
    return np.array([c["k1"], c["k2"], c.get("p1", 0.0), c.get("p2", 0.0), c.get("k3", 0.0)])


def rays_from_px(c, px):
    distorted = homography(np.linalg.inv(k_of(c)), px)
    coefficients = coefficients_of(c)
    points = np.column_stack([distorted, np.ones(len(distorted))])
    ideal, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), I, coefficients)
    return ideal.reshape(-1, 2)


def px_from_rays(c, rays):
    coefficients = coefficients_of(c)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-16)
    points = np.asarray(rays, float).reshape(-1, 1, 2)
    distorted = cv2.undistortPoints(points, I, coefficients, criteria=criteria)
    return homography(k_of(c), distorted)


def table(name, kind, rows):
    print(f"const {name}: [{kind}; {len(rows)}] = [")
    for row in rows:
        print("    [" + ", ".join(repr(float(x)) for x in row) + "],")
    print("];")


def main():
    print(f"// OpenCV {cv2.__version__}, numpy {np.__version__}")
    for name, c in CAMERAS.items():
        table(f"{name}_RAYS", "[f64; 4]", np.hstack([PIXELS, rays_from_px(c, PIXELS)]))
        table(f"{name}_PIXELS", "[f64; 4]", np.hstack([RAYS, px_from_rays(c, RAYS)]))

    # The whole chain on the head: a 600 x 400 mm face, tilted and rolled; its corners and centre, and two points of each
    # stripe on it (the laser's plane X . p = 1 meets the face's plane in a line).
    c = CAMERAS["HEAD"]
    rvec, tvec = np.array([0.35, -0.25, 0.8]), np.array([20.0, -35.0, 1100.0])
    in_face = np.array([(x, y, 0.0) for x, y in [(-300, -200), (300, -200), (300, 200), (-300, 200), (0, 0)]])
    rotation, _ = cv2.Rodrigues(rvec)
    in_cam = in_face @ rotation.T + tvec
    ideal, _ = cv2.projectPoints(in_face, rvec, tvec, I, np.zeros(4))
    px = px_from_rays(c, ideal)
    normal = rotation[:, 2]
    table("FACE_PLANE", "[f64; 3]", [normal / (normal @ tvec)])
    table("FACE_POINTS", "[f64; 5]", np.hstack([in_cam, px]))
    rows = []
    for number, p in enumerate(LASERS, 1):
        for x in (-150.0, 150.0):
            # (R (x, y, 0) + t) . p = 1 for y; stripes that run closer to y than to x are cut at y instead.
            a, b = rotation[:, 0] @ p, rotation[:, 1] @ p
            at = np.array([x, (1 - tvec @ p - a * x) / b, 0.0])
            if abs(b) < abs(a):
                at = np.array([(1 - tvec @ p - b * x) / a, x, 0.0])
            ideal, _ = cv2.projectPoints(at.reshape(1, 3), rvec, tvec, I, np.zeros(4))
            rows.append([number, *(rotation @ at + tvec), *px_from_rays(c, ideal)[0]])
    table("STRIPE_POINTS", "[f64; 6]", rows)


if __name__ == "__main__":
    main()
