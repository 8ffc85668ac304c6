"""Images and gradients of the differentiable camera on a CPU and a GPU, in the same process.

    python benchmarks/camera_device.py [--batch 16] [--out FOLDER]

Random smooth faces of 320 x 240 px with 140 markers, shadows and blur are drawn, and the gradient
of the images by heights and by all parameters of the light is computed. Both devices compute in
double precision, whose largest differences are printed, and the GPU in single precision as well.
Without a GPU only the CPU is measured. The last line printed is one JSON object.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from machine import write_results
from scipy.ndimage import gaussian_filter
from torch import Tensor

from tactorch.sensor.camera import GelCamera
from tactorch.sensor.render import Lamps

PACKAGES = ("tactorch", "torch", "kornia", "numpy")
SHAPE, MM_PER_PX = (240, 320), (0.05, 0.05)
_REPEATS = 5


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure; print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--batch", type=int, default=16, help="images drawn at once")
    parser.add_argument("--out", type=Path, help="folder for camera_device.md and .json")
    options = parser.parse_args(arguments)
    rows = {"cpu, float64": measured("cpu", torch.float64, options.batch)}
    if torch.cuda.is_available():
        name = torch.cuda.get_device_name()
        for dtype in (torch.float64, torch.float32):
            label = f"{name}, {str(dtype).removeprefix('torch.')}"
            rows[label] = measured("cuda", dtype, options.batch)
    first, *_ = rows.values()
    lines = [
        "| device | images a second | with gradients | over CPU | image differs by | gradient |",
        "|---|---|---|---|---|---|",
    ]
    results = {}
    for name, (images, gradient, drawn, back) in rows.items():
        apart = [float((a - b).abs().max() / b.abs().max()) for a, b in (
            (drawn, first[2]), (back, first[3])
        )]  # fmt: skip
        results[name] = {
            "images_per_s": images, "gradients_per_s": gradient,
            "images_ratio": images / first[0], "gradients_ratio": gradient / first[1],
            "image_difference": apart[0], "gradient_difference": apart[1],
        }  # fmt: skip
        lines.append(
            f"| {name} | {images:.1f} | {gradient:.1f} | {images / first[0]:.1f},"
            f" {gradient / first[1]:.1f} | {apart[0]:.1e} | {apart[1]:.1e} |"
        )
    print("\n".join(lines))
    if options.out is not None:
        write_results(options.out, "camera_device", lines, results, PACKAGES)
    print(json.dumps(results))


def measured(device: str, dtype: torch.dtype, batch: int) -> tuple[float, float, Tensor, Tensor]:
    """Images a second without and with gradients, the images, and the gradient by heights."""
    lamps = Lamps()
    camera = GelCamera(
        lamps.shading(), MM_PER_PX, shadow=lamps.shadow, blur_px=0.8, marker_diameter_mm=0.45
    ).to(device=device, dtype=dtype)
    height, markers = (x.to(device=device, dtype=dtype) for x in scene(batch))

    def draw() -> Tensor:
        with torch.no_grad():
            return camera(height, markers)

    def differentiate() -> Tensor:
        given = height.clone().requires_grad_()
        camera.zero_grad()
        (camera(given, markers) ** 2).mean().backward()
        assert given.grad is not None
        return given.grad

    images, gradient = (rate(work, batch, device) for work in (draw, differentiate))
    return images, gradient, draw().double().cpu(), differentiate().double().cpu()


def rate(work: Callable[[], Tensor], batch: int, device: str) -> float:
    """Images a second, the best of a few repeats after a first one."""
    seconds = []
    for _ in range(_REPEATS + 1):
        begin = time.perf_counter()
        work()
        if device != "cpu":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - begin)
    return batch / min(seconds[1:])


def scene(batch: int) -> tuple[Tensor, Tensor]:
    """Smooth faces, mm, and markers, px."""
    rng = np.random.default_rng(0)
    faces = np.stack([
        6.0 * gaussian_filter(rng.normal(size=SHAPE), 12.0, mode="nearest") for _ in range(batch)
    ])  # fmt: skip
    grid = np.stack(np.meshgrid(np.linspace(15, 305, 14), np.linspace(15, 225, 10)), axis=-1)
    markers = grid.reshape(1, -1, 2) + rng.normal(0.0, 1.0, (batch, 140, 2))
    return torch.from_numpy(faces), torch.from_numpy(markers)


if __name__ == "__main__":
    main()
