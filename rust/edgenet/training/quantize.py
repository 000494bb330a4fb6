"""Makes an 8-bit ONNX file (static quantization, QDQ) from a 32-bit one, calibrated on frames from the renderer.

    python quantize.py --model ../models/boxnet.onnx --output ../models/boxnet-int8.onnx --render COMMAND [--frames 200]

Compare both with score.py before using it.
"""

import argparse
import logging
import tempfile
from pathlib import Path
from typing import Iterator

import numpy as np
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from stream import DEFAULT_COMMAND, Frame, frames

CALIBRATION_SEED = 3 << 40  # not frames that are scored


class Calibration(CalibrationDataReader):
    def __init__(self, source: Iterator[Frame]):
        self.source = source

    def get_next(self) -> dict[str, np.ndarray] | None:
        frame = next(self.source, None)
        return frame and {"image": np.ascontiguousarray(frame.rgb.transpose(2, 0, 1)[None], np.float32) / 255}


def quantize(model: Path, output: Path, source: Iterator[Frame]) -> None:
    logging.getLogger().setLevel(logging.ERROR)
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder, "prepared.onnx")
        quant_pre_process(str(model), str(prepared), skip_symbolic_shape=True)
        quantize_static(
            str(prepared),
            str(output),
            Calibration(source),
            quant_format=QuantFormat.QDQ,
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            calibrate_method=CalibrationMethod.MinMax,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--render", default=DEFAULT_COMMAND)
    parser.add_argument("--seed", type=int, default=CALIBRATION_SEED)
    parser.add_argument("--frames", type=int, default=200)
    arguments = parser.parse_args()
    quantize(arguments.model, arguments.output, frames(arguments.render, arguments.seed, arguments.frames))
    print(f"quantize: {arguments.output}, {arguments.output.stat().st_size} bytes (from {arguments.model.stat().st_size})")


if __name__ == "__main__":
    main()
