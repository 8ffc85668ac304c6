"""Numbers come out of their bytes again, and text cannot leave its place."""

import base64
import json
from typing import Any

import numpy as np
import pytest

from tactorch.report.figure_data import indices, packed, quantised, rows, script_json


def unpacked(told: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(told["data"]), np.dtype(told["dtype"]))


def test_moduli_keep_their_ratios_over_five_decades() -> None:
    youngs = np.geomspace(1e-3, 100.0, 999)
    told = quantised(youngs)
    share = unpacked(told) / 65_535
    back = np.exp(told["low"] + share * (told["high"] - told["low"]))
    np.testing.assert_allclose(back, youngs, rtol=1.01 * np.log(1e5) / 65_535 / 2)


def test_fields_with_zeros_are_in_equal_steps() -> None:
    values = np.array([0.0, -1.0, 3.0, 2.5])
    told = quantised(values)
    assert not told["ratio"]
    back = told["low"] + unpacked(told) / 65_535 * (told["high"] - told["low"])
    np.testing.assert_allclose(back, values, atol=4.0 / 65_535)


@pytest.mark.parametrize("value", [0.0, 0.2])
def test_a_uniform_field_is_no_trouble(value: float) -> None:
    told = quantised(np.full(5, value))
    assert not unpacked(told).any()
    assert (np.exp(told["low"]) if told["ratio"] else told["low"]) == pytest.approx(value)


def test_vectors_keep_what_is_missing() -> None:
    values = np.array([[1.0, np.nan, -2.0], [0.5, 0.0, 1e-3]])
    told = rows(values)
    whole = unpacked(told).astype(float)
    whole[whole == -32_768] = np.nan
    np.testing.assert_allclose(whole.reshape(2, 3) * told["step"], values, atol=told["step"])


@pytest.mark.parametrize(("count", "dtype"), [(65_536, "uint16"), (65_537, "uint32")])
def test_indices_take_the_bytes_they_need(count: int, dtype: str) -> None:
    told = indices(np.array([[0, count - 1]]), count)
    assert told["dtype"] == dtype
    assert unpacked(told).tolist() == [0, count - 1]


def test_bytes_are_little_endian() -> None:
    assert base64.b64decode(packed(np.array([1, 256]), "uint16")["data"]) == b"\x01\x00\x00\x01"


def test_json_cannot_end_its_script() -> None:
    value = {"a": "</script><!--&\u2028é"}
    told = script_json(value)
    assert not set("<>&") & set(told)
    assert told.isascii()
    assert json.loads(told) == value


def test_json_takes_no_nan() -> None:
    with pytest.raises(ValueError, match="JSON"):
        script_json([float("nan")])
