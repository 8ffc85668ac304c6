from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tactorch.errors import RecordingError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.recording import Press, Recording

DOWN = np.array([0.0, 0.0, -9810.0])  # mm/s^2
Make = Callable[..., Recording]


def test_defaults(record: Make) -> None:
    recording = record()
    assert recording.truth is None
    assert recording.provenance == {}
    assert recording.density is None
    np.testing.assert_array_equal(recording.gravity, 0)


def test_summary_says_what_is_in_it(record: Make, box: TetMesh) -> None:
    truth = np.full(box.n_tets, 0.2)
    truth[0] = 1.0
    assert record({"noise_mm": 0.01}, truth=truth).summary().splitlines() == [
        "object: 10 x 10 x 10 mm, 27 nodes, 48 tetrahedra",
        "presses: 1, force 0.9 N, largest displacement 0.51 mm",
        "observed: 27 degrees of freedom a press, noise 0.01 mm",
        "held by: springs",
        "material: neo_hookean, Poisson's ratio 0.45",
        "truth: 0.2 to 1 MPa",
    ]


def test_summary_of_weight_and_reference(record: Make, box: TetMesh) -> None:
    text = record(density=1e-9, gravity=DOWN, reference=np.full(box.n_tets, 0.3)).summary()
    assert "truth: unknown\nreference: 0.3 MPa\nweight: 1e-09 tonne/mm^3 under 9.81 m/s^2" in text


def test_select_takes_presses_in_order(record: Make, fields: dict[str, Any]) -> None:
    presses = tuple(Press(**{**fields, "name": name}) for name in "abc")
    chosen = record(presses=presses).select([2, 0])
    assert [press.name for press in chosen.presses] == ["c", "a"]


@pytest.mark.parametrize(("indices", "says"), [([3], "press 3"), ([-1], "press -1"), ([], "empty")])
def test_select_refuses(record: Make, indices: list[int], says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        record().select(indices)


def test_needs_a_press(record: Make) -> None:
    with pytest.raises(RecordingError, match="presses is empty"):
        record(presses=())


def test_refuses_a_press_on_another_mesh(record: Make) -> None:
    with pytest.raises(RecordingError, match="mesh has 64"):
        record(mesh=box_mesh(10.0, 3))


def test_refuses_a_press_without_load(record: Make) -> None:
    with pytest.raises(RecordingError, match="nothing presses the object"):
        record({"forces": np.zeros((27, 3))})


def test_weight_is_a_load(record: Make) -> None:
    assert record({"forces": np.zeros((27, 3))}, density=1e-9, gravity=DOWN)


@pytest.mark.parametrize(
    ("held", "says"),
    [
        ([], "it can move freely"),
        ([(0, 0), (0, 1), (0, 2)], "it can turn about"),
        ([(i, 2) for i in range(27)], "it can (slide along [xy]|turn about z)"),
        ([(i, j) for i in range(27) for j in (0, 1)], "it can slide along z"),
        # Opposite corners of the box, where no motion is parallel to an axis.
        ([(0, 0), (0, 1), (0, 2), (26, 0), (26, 1), (26, 2)], "it can turn about"),
        # Two nodes on the z axis of the box leave the turn about it.
        ([(0, 0), (0, 1), (0, 2), (2, 0), (2, 1), (2, 2)], "it can turn about z"),
    ],
)
def test_refuses_a_loose_object(
    record: Make, box: TetMesh, held: list[tuple[int, int]], says: str
) -> None:
    springs = np.zeros((27, 3))
    for node, axis in held:
        springs[node, axis] = 1.0
    with pytest.raises(RecordingError, match=f"nothing holds the object; {says}"):
        record({"springs": springs})


def test_six_well_placed_supports_hold(record: Make, box: TetMesh) -> None:
    fixed = np.zeros((27, 3), dtype=bool)
    along_x, along_y = 18, 6
    np.testing.assert_array_equal(box.points[[along_x, along_y]], [[10, 0, 0], [0, 10, 0]])
    fixed[0] = True
    fixed[along_x, 1:] = True
    fixed[along_y, 2] = True
    assert record({"springs": np.zeros((27, 3)), "fixed": fixed})


def test_refuses_truth_that_does_not_fit(record: Make) -> None:
    with pytest.raises(RecordingError, match=r"truth .* has shape \(3,\); \(48\) is needed"):
        record(truth=np.ones(3))
    with pytest.raises(RecordingError, match="truth is 0 MPa at element 47"):
        record(truth=np.r_[np.ones(47), 0.0])
    with pytest.raises(RecordingError, match="reference holds 48 values that are NaN"):
        record(reference=np.full(48, np.nan))


def test_refuses_provenance_that_json_cannot_hold(record: Make) -> None:
    with pytest.raises(RecordingError, match="provenance"):
        record(provenance={"when": object()})
    with pytest.raises(RecordingError, match="provenance"):
        record(provenance={"value": float("nan")})


def test_provenance_is_plain_from_the_start(record: Make) -> None:
    assert record(provenance={"a": (1, 2)}).provenance == {"a": [1, 2]}


def test_refuses_gravity_without_density_and_odd_density(record: Make) -> None:
    with pytest.raises(RecordingError, match="gravity is given without density"):
        record(gravity=DOWN)
    with pytest.raises(RecordingError, match="kg/m\\^3"):
        record(density=1000.0)


@pytest.mark.parametrize(
    ("press", "changes", "says"),
    [
        ({}, {"mesh": box_mesh(0.01, 2)}, "mesh: its diagonal is 0.0173 mm; metres"),
        ({}, {"mesh": box_mesh(5e4, 2)}, "mesh: .* micrometres"),
        ({"displacement": 1e-3}, {}, "presses: no displacement exceeds .* metres"),
        ({"displacement": 1e3}, {}, "press 'top': displacement reaches .* micrometres"),
        ({"forces": 1e6}, {}, "press 'top': forces reach 1e\\+05 N"),
        ({"forces": 1e4}, {}, "press 'top': forces of 9e\\+03 N .* mN"),
        ({"forces": 1e-6}, {}, "press 'top': .* kN"),
        ({}, {"truth": np.full(48, 200.0)}, "truth: its median is 200 MPa; kPa"),
        ({}, {"truth": np.full(48, 2e5)}, "truth: its median is 2e\\+05 MPa; Pa"),
        ({}, {"truth": np.full(48, 2e-10)}, "truth: .* GPa"),
    ],
)
def test_suspects_units(
    record: Make,
    fields: dict[str, Any],
    press: dict[str, float],
    changes: dict[str, Any],
    says: str,
) -> None:
    scaled = {name: fields[name] * factor for name, factor in press.items()}
    with pytest.raises(RecordingError, match=f"{says}.*check_units=False"):
        record(scaled, **changes)
    assert record(scaled, **changes, check_units=False)


def test_does_not_suspect_what_is_possible(record: Make, fields: dict[str, Any]) -> None:
    """A tenth and ten times the ordinary is no reason to refuse."""
    for factor in (0.1, 10.0):
        assert record({"displacement": fields["displacement"] * factor})
        assert record({"forces": fields["forces"] * factor})
        assert record(truth=np.full(48, 0.2 * factor))


@pytest.mark.parametrize(
    ("frames", "says"),
    [
        (np.zeros((1, 27, 3)), "unloaded has one frame"),
        (np.full((3, 27, 3), np.nan), "unloaded has no value that is finite"),
        (np.zeros((2, 26, 3)), "unloaded"),
    ],
)
def test_unloaded_frames_that_tell_nothing_are_refused(
    record: Callable[..., Recording], frames: np.ndarray, says: str
) -> None:
    with pytest.raises(RecordingError, match=says):
        record(unloaded=frames)
