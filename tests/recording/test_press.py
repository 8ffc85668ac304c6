import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from tactorch.errors import RecordingError
from tactorch.fem.contact import Ball
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose


def test_fills_in_what_was_not_given(fields: dict[str, Any]) -> None:
    del fields["springs"]
    press = Press(**fields)
    assert not press.springs.any()
    assert not press.fixed.any()
    assert not press.prescribed.any()
    assert press.fixed.dtype == np.bool_
    assert press.noise_mm is None


def test_converts_single_precision(fields: dict[str, Any]) -> None:
    fields["forces"] = fields["forces"].astype(np.float32)
    assert Press(**fields).forces.dtype == np.float64


def test_copies_its_arrays(fields: dict[str, Any]) -> None:
    press = Press(**fields)
    fields["forces"][:] = 7.0
    assert press.forces.min() == -0.1


def test_hides_displacement_that_was_not_observed(fields: dict[str, Any]) -> None:
    fields["displacement"] = np.nan_to_num(fields["displacement"], nan=3.0)
    press = Press(**fields)
    assert np.isnan(press.displacement[~press.observed]).all()
    assert np.isfinite(press.displacement[press.observed]).all()


def test_held_and_data_follow_supports(fields: dict[str, Any]) -> None:
    fixed = np.zeros_like(fields["observed"])
    top = np.flatnonzero(fields["observed"][:, 0])
    fixed[top, 0] = True
    press = Press(**fields, fixed=fixed)
    assert press.held.sum() == (fields["springs"] > 0).sum() + len(top)
    assert press.data.sum() == 2 * len(top)
    np.testing.assert_allclose(press.total_force, (0, 0, -0.9))


def wrong(fields: dict[str, Any], field: str) -> dict[str, Any]:
    """Give a version of the fields with one of them spoilt."""
    n = len(fields["forces"])
    spoilt: dict[str, Any] = {
        "forces finite": np.full((n, 3), np.nan),
        "observed none": np.zeros((n, 3), dtype=bool),
        "displacement nan": np.full((n, 3), np.nan),
        "springs negative": np.full((n, 3), -1.0),
        "springs inf": np.full((n, 3), np.inf),
        "prescribed free": np.ones((n, 3)),
        "fixed all": fields["observed"],
        "noise_mm negative": -0.1,
        "noise_mm nan": float("nan"),
        "weights zero": np.zeros((n, 3)),
        "weights negative": -np.ones((n, 3)),
        "step negative": -1,
        "direction long": np.array([1.0, 1.0, 0.0]),
    }
    return {**fields, field.split()[0]: spoilt[field]}


@pytest.mark.parametrize(
    ("field", "says"),
    [
        ("forces finite", "forces holds 81 values that are NaN"),
        ("observed none", "observed is empty"),
        ("displacement nan", r"displacement \(where observed\) holds 27"),
        ("springs negative", "springs has a negative stiffness"),
        ("springs inf", "springs holds"),
        ("prescribed free", "prescribed moves degrees of freedom that are not fixed"),
        ("fixed all", "observed names only degrees of freedom that are fixed"),
        ("noise_mm negative", "noise_mm is -0.1"),
        ("noise_mm nan", "noise_mm is nan"),
        ("weights zero", "weights must be"),
        ("weights negative", "weights must be"),
        ("step negative", "step is -1"),
        ("direction long", "direction has length 1.41421"),
    ],
)
def test_refuses_by_press_and_field(fields: dict[str, Any], field: str, says: str) -> None:
    with pytest.raises(RecordingError, match=f"^press 'top': {says}"):
        Press(**wrong(fields, field))


def test_refuses_another_mesh(fields: dict[str, Any]) -> None:
    Press(**fields).validate(27)
    with pytest.raises(RecordingError, match="over 27 nodes but the mesh has 28"):
        Press(**fields).validate(28)


# What the annotations forbid never gets past the type checker that watches these tests, so it is
# tried where nobody watches, as a user would.
UNWATCHED = """
import numpy as np
from tactorch.errors import RecordingError
from tactorch.recording import Press

good = {
    "forces": [[0, 0, 1], [0, 0, 0]],
    "observed": [[True, True, True], [False, False, False]],
    "displacement": [[0, 0, 0.1], [0, 0, 0]],
    "name": "top",
}
assert Press(**good).forces.dtype == np.float64
for field, value in {
    "forces": [[1.0, 2.0]],
    "displacement": [["x", "y", "z"]] * 2,
    "observed": [[1, 0, 0], [0, 0, 0]],
    "springs": [[1.0, 2.0, 3.0]],
    "weights": [[1.0], [1.0, 2.0]],
    "direction": [1.0, 0.0],
}.items():
    try:
        Press(**{**good, field: value})
    except RecordingError as error:
        print(error)
"""


def test_refuses_other_types_and_shapes() -> None:
    run = subprocess.run(
        [sys.executable, "-c", UNWATCHED], capture_output=True, text=True, check=False
    )
    assert run.stderr == ""
    messages = run.stdout.splitlines()
    assert messages[:4] == [
        "press 'top': forces has shape (1, 2); (n, 3) is needed",
        "press 'top': displacement has dtype <U1; real numbers are needed",
        "press 'top': observed has dtype int64; it is a mask, one True or False per degree of "
        "freedom",
        "press 'top': springs has shape (1, 3); (2, 3) is needed",
    ]
    assert messages[4].startswith("press 'top': weights is not an array of numbers: ")
    assert messages[5] == "press 'top': direction has shape (2,); (3) is needed"


@pytest.mark.parametrize("poisson", [0.5, -1.0, 0.7, float("nan")])
def test_material_refuses_impossible_poisson(poisson: float) -> None:
    with pytest.raises(RecordingError, match="poisson"):
        MaterialSpec("neo_hookean", poisson)


def test_material_refuses_other_nonsense() -> None:
    with pytest.raises(RecordingError, match="name is empty"):
        MaterialSpec("", 0.3)
    with pytest.raises(RecordingError, match="lame_factor is inf"):
        MaterialSpec("neo_hookean", 0.3, {"lame_factor": float("inf")})


def test_a_press_with_shared_fields_is_still_checked_for_its_own() -> None:
    """Nodal fields of the press before are not checked again; what differs is."""
    held = np.zeros((4, 3), dtype=bool)
    held.setflags(write=False)
    pose = ProbePose(Ball(1.0), np.array([0.0, 0.0, 1.0]))
    force = ForceReading.along([0.0, 0.0, 1.0], 1.0, 0.1)
    fields = {**vars(Press.by_probe(pose, 4, force=force, fixed=held))}
    assert Press(**fields).fixed is held
    with pytest.raises(RecordingError, match="direction has length 2"):
        Press(**fields | {"direction": np.array([2.0, 0.0, 0.0])})
    with pytest.raises(RecordingError, match="observed is empty"):
        Press(**fields | {"force": None})
    with pytest.raises(RecordingError, match="no probe and no support"):
        Press(**fields | {"probe": None})
    with pytest.raises(RecordingError, match="weights must be at least 0"):
        Press(**fields | {"weights": -np.ones((4, 3))})
    stiff = -np.ones((4, 3))
    stiff.setflags(write=False)
    with pytest.raises(RecordingError, match="negative stiffness"):
        Press(**fields | {"springs": stiff})
