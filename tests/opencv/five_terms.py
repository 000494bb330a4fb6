"""OpenCV with five terms of distortion on the very circles of `boxline calibrate`: rms and focal length side by side.

    pip install opencv-python-headless==4.* numpy
    cargo run --release -p boxline-sim --example circles -- FOLDER > circles.json
    python tests/opencv/five_terms.py circles.json

The circles' centres, frame by frame, with and without the correction for perspective: OpenCV gets both, so that only the models
differ. Its polynomial runs from the ideal to the distorted coordinate, boxline's the other way.
"""
import json, sys
import cv2
import numpy as np

told = json.load(open(sys.argv[1]))
print(f"boxline: terms {told['lens']}, circles {told['circles_rms_px'][0]:.4f}, {told['circles_rms_px'][1]:.4f} px rms, fx {told['fx']:.3f}, fy {told['fy']:.3f}, cx {told['cx']:.3f}, cy {told['cy']:.3f}")
for name in ("centres_px", "ellipses_px"):
    boards, seen = [], []
    for frame in told["frames"]:
        board = np.array(frame["board_mm"], np.float32)
        boards.append(np.concatenate([board, np.zeros((len(board), 1), np.float32)], 1))
        seen.append(np.array(frame[name], np.float32))
    for terms, flags in (("k1, k2", cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3), ("k1, k2, p1, p2, k3", 0)):
        rms, k, d, *_ = cv2.calibrateCamera(boards, seen, tuple(told["image_size"]), None, None, flags=flags)
        # OpenCV's rms is of the distance; boxline's of an axis.
        print(f"OpenCV, {name}, {terms}: {rms / 2**0.5:.4f} px rms an axis, fx {k[0, 0]:.3f}, fy {k[1, 1]:.3f}, cx {k[0, 2]:.3f}, cy {k[1, 2]:.3f}")
