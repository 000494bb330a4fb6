"""Processor time of Pillow, which decodes by libjpeg-turbo, for the two JPEGs of a box: the first referee of rust/SPEED.md. `decode.c`
is without Pillow's memory and copies, which take most of the time.

    pip install pillow
    python tests/turbo/decode_referee.py tests/data/b02 [loops]

Pillow's wheels carry libjpeg-turbo with its SIMD code. Both files are read first; timed is the way from bytes in memory to RGB
pixels, on one thread. `cargo run --release -p boxline-edgenet --example pair_time -- tests/data/b02 15 gradient` is the other side: run them in
turn, the machine's mood changes both alike.
"""
import io, pathlib, statistics, sys, time
from PIL import Image, features

if not features.check_feature("libjpeg_turbo"):
    sys.exit("this Pillow was built without libjpeg-turbo")
folder = pathlib.Path(sys.argv[1])
loops = int(sys.argv[2]) if len(sys.argv) > 2 else 15
jpegs = [(folder / f"{name}.jpg").read_bytes() for name in "ab"]
times = []
for _ in range(loops):
    start = time.process_time()
    for jpeg in jpegs:
        Image.open(io.BytesIO(jpeg)).convert("RGB").load()
    times.append((time.process_time() - start) * 1e3)
print(f"decode both, libjpeg-turbo: median {statistics.median(times):.1f} ms, least {min(times):.1f} ms of {loops}")
