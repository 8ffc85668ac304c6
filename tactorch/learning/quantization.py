"""Small files of trained weights: integers of a few bits with a scale per channel, compressed."""

import io
from collections.abc import Callable, Mapping
from typing import Any
from zipfile import ZIP_LZMA, ZIP_STORED, ZipFile

import torch
from torch import Tensor

from tactorch.budget import unpack

_FACTORS = torch.linspace(0.5, 1.0, 11)  # of the largest weight, candidates for the range


def quantize(
    state: Mapping[str, Tensor], bits: Callable[[str], int]
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Return weights as integers, and the scale of each output channel.

    The range of each channel has the smallest sum of squared errors. Tensors with fewer than two
    dimensions (biases, normalisations, scales) are kept in half precision.

    Args:
        state: Tensors of a network, of any shapes.
        bits: Number of bits of the integers for the name of a tensor, 2 to 8.

    Returns:
        The tensors (int8, or half precision), and the scales (c,) by name.
    """
    values, scales = {}, {}
    for name, weights in state.items():
        if weights.ndim < 2:
            values[name] = weights.half()
        else:
            values[name], scales[name] = _integers(weights.float(), bits(name))
    return values, scales


def dequantize(state: Mapping[str, Tensor], scales: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return all tensors in single precision; those without a scale are only converted."""

    def restored(name: str, values: Tensor) -> Tensor:
        if name not in scales:
            return values.float()
        return values.float() * scales[name].float().reshape(len(values), *[1] * (values.ndim - 1))

    return {name: restored(name, values) for name, values in state.items()}


def compress(content: Mapping[str, Any]) -> bytes:
    """Return content of `torch.save` as a compressed archive."""
    memory = io.BytesIO()
    torch.save(dict(content), memory)
    return _with_compression(memory, ZIP_LZMA).getvalue()


def decompress(archive: io.BytesIO) -> io.BytesIO:
    """Return an archive of `torch.save` or `compress` in the form that `torch.load` reads.

    Checksums are verified, which torch does not.
    """
    with ZipFile(archive) as content:
        if all(entry.compress_type == ZIP_STORED for entry in content.infolist()):
            if (damaged := content.testzip()) is not None:
                raise ValueError(f"the checksum of {damaged} differs")
            archive.seek(0)
            return archive
    return _with_compression(archive, ZIP_STORED)


def _integers(weights: Tensor, bits: int) -> tuple[Tensor, Tensor]:
    largest = 2 ** (bits - 1) - 1
    flat = weights.flatten(1)
    scales = flat.abs().amax(dim=1) * _FACTORS[:, None] / largest  # (factors, c)
    scales = scales.clamp_min(torch.finfo(torch.float16).tiny).half().float()
    errors = torch.stack(
        [(_rounded(flat, one, largest) * one[:, None] - flat).square().sum(1) for one in scales]
    )
    best = scales[errors.argmin(dim=0), torch.arange(len(flat))]
    return _rounded(flat, best, largest).reshape(weights.shape).to(torch.int8), best.half()


def _rounded(flat: Tensor, scales: Tensor, largest: int) -> Tensor:
    return (flat / scales[:, None]).round().clamp(-largest, largest)


def _with_compression(archive: io.BytesIO, kind: int) -> io.BytesIO:
    changed = io.BytesIO()
    with ZipFile(archive) as old, ZipFile(changed, "w", kind) as new:
        for entry in old.infolist():
            new.writestr(entry.filename, unpack(old, entry))
    changed.seek(0)
    return changed
