"""Weights as integers of a few bits in compressed archives."""

import io
from pathlib import Path
from typing import Any

import pytest
import torch

from tactorch.errors import FileError
from tactorch.learning.quantization import compress, decompress, dequantize, quantize
from tactorch.learning.training import read_checkpoint


@pytest.fixture
def state() -> dict[str, torch.Tensor]:
    random = torch.Generator().manual_seed(3)
    weights = torch.randn((6, 5, 3, 3, 3), generator=random)
    weights *= torch.tensor([1e-6, 0.1, 1.0, 10.0, 1e3, 0.0]).reshape(-1, 1, 1, 1, 1)
    return {"a.weight": weights, "a.bias": torch.randn(6, generator=random)}


@pytest.mark.parametrize(("bits", "error"), [(8, 0.012), (6, 0.045), (4, 0.15)])
def test_error_of_each_channel(state: dict[str, torch.Tensor], bits: int, error: float) -> None:
    """Channels of very different size have the same relative error; zeros remain zeros."""
    back = dequantize(*quantize(state, lambda name: bits))
    weights = state["a.weight"].flatten(1)
    difference = (back["a.weight"].flatten(1) - weights).norm(dim=1)
    assert (difference[1:5] < error * weights[1:5].norm(dim=1)).all()
    assert (back["a.weight"][5] == 0).all()
    torch.testing.assert_close(back["a.bias"], state["a.bias"], atol=1e-3, rtol=1e-3)


def test_clipped_range_is_better_than_full_range_at_four_bits() -> None:
    weights = torch.randn((4, 2000), generator=torch.Generator().manual_seed(0))
    back = dequantize(*quantize({"w": weights}, lambda name: 4))["w"]
    step = weights.abs().amax(dim=1, keepdim=True) / 7
    full = (weights / step).round() * step
    assert (back - weights).norm() < 0.9 * (full - weights).norm()


def test_archives(state: dict[str, torch.Tensor], tmp_path: Path) -> None:
    """Compressed and plain archives have the same content."""
    content = {"state_dict": {"w": torch.zeros(100_000, dtype=torch.int8)}}
    small = compress(content)
    assert len(small) < 5000
    (tmp_path / "small.pt").write_bytes(small)
    plain = decompress(io.BytesIO(small))
    (tmp_path / "plain.pt").write_bytes(plain.getvalue())
    assert decompress(plain) is plain
    for name in ("small.pt", "plain.pt"):
        read = read_checkpoint(tmp_path / name)["state_dict"]["w"]
        assert torch.equal(read, content["state_dict"]["w"])


def shared_lists() -> list[Any]:
    lists: list[Any] = ["x"] * 9
    for _ in range(9):
        lists = [lists] * 9
    return lists


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"scales": {"w": torch.zeros(1).half().expand(10**10)}}, "too large: its weights"),
        ({"scales": {"w": torch.full((4,), torch.nan)}}, "w has values that are not real and"),
        ({"scales": ["x"]}, "damaged or no checkpoint"),
        ({"hyper_parameters": {"rate": shared_lists()}}, "its setting rate is no value or short"),
        ({"state_dict": {"w": torch.ones(4, dtype=torch.complex64)}}, "w has values that are not"),
        ({"state_dict": {"w": torch.tensor([torch.inf])}}, "w has values that are not real and"),
        ({"state_dict": {"w": torch.eye(4).to_sparse()}}, "w has values that are not real and"),
    ],
)
def test_hostile_values_are_refused(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    content = {"state_dict": {"w": torch.zeros(4, 2)}, "hyper_parameters": {"rate": 0.1}}
    torch.save({**content, **changed}, tmp_path / "a.pt")
    with pytest.raises(FileError, match=message):
        read_checkpoint(tmp_path / "a.pt")


def test_scales_have_one_value_for_each_channel() -> None:
    with pytest.raises(RuntimeError):
        dequantize({"w": torch.ones(1, 3)}, {"w": torch.ones(1000)})
