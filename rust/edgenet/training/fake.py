"""Crude scenes for tests of the training code: a cuboid with a face, four lines across it, clutter. Numpy only.

    python fake.py --seed 1 --frames 64 > stream

They are not meant to teach anything that holds outside this folder.
"""

import argparse
import sys

import numpy as np

from stream import Format, Frame, write_frame

LASER_COLOURS = np.array([[255, 40, 40], [255, 90, 20], [255, 30, 120], [230, 60, 200]], np.float32)
LABEL_SIGMA_PX = 0.8  # of a line in the label raster


def segment_distance(x: np.ndarray, y: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of each pixel to the segment a-b."""
    along = b - a
    t = np.clip(((x - a[0]) * along[0] + (y - a[1]) * along[1]) / max(float(along @ along), 1e-6), 0, 1)
    return np.hypot(x - a[0] - t * along[0], y - a[1] - t * along[1])


def inside_quad(x: np.ndarray, y: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Whether each pixel lies in a convex quadrilateral (clockwise on the screen, y down)."""
    within = np.ones(np.broadcast(x, y).shape, bool)
    for a, b in zip(quad, np.roll(quad, -1, axis=0)):
        within &= (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0
    return within


def clip_to_quad(a: np.ndarray, b: np.ndarray, quad: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The part of the segment a-b inside a convex quadrilateral."""
    low, high = 0.0, 1.0
    for c, d in zip(quad, np.roll(quad, -1, axis=0)):
        normal = np.array([-(d[1] - c[1]), d[0] - c[0]])
        start, slope = float(normal @ (a - c)), float(normal @ (b - a))
        if abs(slope) < 1e-9:
            if start < 0:
                return None
        elif slope > 0:
            low = max(low, -start / slope)
        else:
            high = min(high, -start / slope)
    return (a + low * (b - a), a + high * (b - a)) if high - low > 0.05 else None


def scene(seed: int, fmt: Format) -> Frame:
    """One scene; everything is placed in units of the image, then drawn once on each raster."""
    rng = np.random.default_rng(seed)
    size = np.array([fmt.w, fmt.h], float)
    x, y = np.arange(fmt.w, dtype=np.float32)[None], np.arange(fmt.h, dtype=np.float32)[:, None]
    image = np.full((fmt.h, fmt.w, 3), rng.uniform(20, 160, 3), np.float32)
    others: list[tuple[np.ndarray, np.ndarray]] = []

    def fill(quad: np.ndarray, colour: np.ndarray) -> None:
        shade = 1 + rng.uniform(-0.3, 0.3) * (x / fmt.w - 0.5) + rng.uniform(-0.3, 0.3) * (y / fmt.h - 0.5)
        image[inside_quad(x, y, quad)] = (colour * shade[..., None])[inside_quad(x, y, quad)]

    for _ in range(rng.integers(1, 5)):
        centre, half = rng.uniform(0, 1, 2) * size, rng.uniform(0.05, 0.25, 2) * size
        quad = centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) + rng.uniform(-8, 8, (4, 2))
        fill(quad, rng.uniform(30, 220, 3))
        others += list(zip(quad, np.roll(quad, -1, axis=0)))
    centre, half = size * rng.uniform(0.42, 0.58, 2), size * rng.uniform(0.2, 0.3, 2)
    face = centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) + rng.uniform(-0.04, 0.04, (4, 2)) * size
    depth = np.array([rng.uniform(0.05, 0.12) * rng.choice([-1, 1]), -rng.uniform(0.05, 0.12)]) * size
    colour = rng.uniform(70, 200) * np.array([1, 0.82, 0.62])
    top = np.array([face[0] + depth, face[1] + depth, face[1], face[0]])
    side = np.array([face[1], face[1] + depth, face[2] + depth, face[2]])
    if depth[0] < 0:
        side = np.array([face[0] + depth, face[0], face[3], face[3] + depth])
    for quad, shade in ((top, 1.15), (side, 0.75), (face, 1.0)):
        fill(quad, colour * shade)
    others += list(zip(top[:2], top[1:3])) + list(zip(side, np.roll(side, -1, axis=0)))

    contrast, on_face, spill = [], [None] * 4, []
    offsets = np.array([-0.3, 0.3]) * half.min()
    for laser in range(4):
        angle = rng.uniform(-0.08, 0.08) + (np.pi / 2 if laser >= 2 else 0)
        along = np.array([np.cos(angle), np.sin(angle)])
        through = centre + offsets[laser % 2] * np.array([-along[1], along[0]])
        a, b = through - 2 * half.max() * along, through + 2 * half.max() * along
        peak = float(rng.uniform(25, 160))
        contrast.append(round(peak, 1))
        on_face[laser] = clip_to_quad(a, b, face)
        if on_face[laser] is None:
            continue
        c, d = on_face[laser]
        spill += [(c - 0.2 * (d - c), c), (d, d + 0.2 * (d - c))]
        glow = np.exp(-0.5 * (segment_distance(x, y, c - 0.2 * (d - c), d + 0.2 * (d - c)) / 1.2) ** 2)
        image += peak * glow[..., None] * LASER_COLOURS[laser] / 255
    image += rng.normal(0, 4, image.shape)

    labels = np.zeros((fmt.channels, fmt.lh, fmt.lw), np.float32)
    scale = np.array([fmt.lw / fmt.w, fmt.lh / fmt.h])
    lx, ly = np.arange(fmt.lw, dtype=np.float32)[None], np.arange(fmt.lh, dtype=np.float32)[:, None]
    to_label = lambda p: (p + 0.5) * scale - 0.5

    def draw(channel: int, a: np.ndarray, b: np.ndarray, sigma_px: float = LABEL_SIGMA_PX) -> None:
        distance = segment_distance(lx, ly, to_label(a), to_label(b))
        np.maximum(labels[channel], np.exp(-0.5 * (distance / sigma_px) ** 2), out=labels[channel])

    for laser, segment in enumerate(on_face):
        if segment:
            draw(laser, *segment)
    mask = inside_quad(lx, ly, to_label(face))
    for channel, segments in ((4, spill), (5, zip(face, np.roll(face, -1, axis=0))), (6, others)):
        for a, b in segments:
            draw(channel, a, b)
    labels[6] *= (1 - labels[5]) * ~mask
    labels[7] = mask
    for corner in face:
        draw(8, corner, corner, 1.5)
    meta = {"contrast": contrast, "measurable": all(s is not None for s in on_face), "fake": True}
    return Frame(seed, meta, np.clip(image, 0, 255).astype(np.uint8), np.round(labels * 255).astype(np.uint8))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=0, help="0: until the reader goes away")
    parser.add_argument("--size", default="512x384")
    arguments = parser.parse_args()
    w, h = map(int, arguments.size.split("x"))
    fmt = Format(w, h, w // 2, h // 2, 9)
    out = sys.stdout.buffer
    try:
        out.write(fmt.header())
        seed = arguments.seed
        while not arguments.frames or seed < arguments.seed + arguments.frames:
            write_frame(out, scene(seed, fmt))
            seed += 1
        out.flush()
    except BrokenPipeError:
        sys.stderr.close()  # the reader has had enough; nothing to say at exit


if __name__ == "__main__":
    main()
