"""The batched solver in torch against the CPU's factorisations; on CUDA where there is one."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import MATERIALS, SoftBody, Supports, make_material
from tactorch.fem.batched_cg import solve_batch
from tactorch.fem.device import DeviceBody, DeviceOptions
from tactorch.mesh import TetMesh, box_mesh

CUDA = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
DEVICES = ["cpu", pytest.param("cuda", marks=CUDA)]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Tiny products are slower on several threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return box_mesh(10.0, 2, tets_per_cell=5)


@pytest.fixture(scope="module")
def youngs(mesh: TetMesh) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.1, 0.6, mesh.n_tets)


@pytest.fixture(scope="module")
def supports(mesh: TetMesh) -> Supports:
    springs = np.zeros((mesh.n_points, 3))
    springs[mesh.points[:, 2] == 0.0] = 1.0
    return Supports(springs=springs)


def loads_of(body: SoftBody) -> np.ndarray:
    """Two cases, one of them with a slant."""
    straight = body.pressure("z+", 0.02).numpy()
    return np.stack([straight, 0.5 * straight + 0.2 * straight[:, [2, 0, 1]]])


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("element", "material"), [*(("tet4", name) for name in MATERIALS), ("tet10", "neo_hookean")]
)
def test_equilibria_are_those_of_the_cpu(
    mesh: TetMesh, youngs: np.ndarray, supports: Supports, device: str, element: str, material: str
) -> None:
    body = SoftBody(mesh, make_material(material, 0.45), element=element)
    loads = loads_of(body)
    found = DeviceBody(body, device).equilibrate(youngs, loads, supports).cpu().numpy()
    for u, load in zip(found, loads, strict=True):
        expected = body.equilibrate(youngs, load, supports).require().displacement
        np.testing.assert_allclose(u, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("device", DEVICES)
def test_the_adjoint_is_the_autograd_function_s(
    mesh: TetMesh, youngs: np.ndarray, supports: Supports, device: str
) -> None:
    body = SoftBody(mesh, make_material("neo_hookean", 0.45))
    loads = loads_of(body)
    on_device = DeviceBody(body, device)
    u = on_device.equilibrate(youngs, loads, supports)
    weights = torch.from_numpy(np.random.default_rng(1).standard_normal(u.shape))
    gradient = on_device.adjoint(u, weights.to(device)).cpu()
    moduli = torch.tensor(youngs, requires_grad=True)
    (body.solve(moduli, torch.from_numpy(loads), supports) * weights).sum().backward()
    assert moduli.grad is not None
    scale = float(moduli.grad.abs().max())
    torch.testing.assert_close(gradient, moduli.grad, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize("device", DEVICES)
def test_prescribed_motion_is_kept(mesh: TetMesh, youngs: np.ndarray, device: str) -> None:
    bottom, top = mesh.points[:, 2] == 0.0, mesh.points[:, 2] == 10.0
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[bottom], fixed[top, 2] = True, True
    prescribed = np.zeros((mesh.n_points, 3))
    prescribed[top, 2] = -0.8
    held = Supports(fixed=fixed, prescribed=prescribed)
    body = SoftBody(mesh, make_material("neo_hookean", 0.45))
    nothing = np.zeros((1, mesh.n_points, 3))
    u = DeviceBody(body, device).equilibrate(youngs, nothing, held)[0].cpu().numpy()
    expected = body.equilibrate(youngs, nothing[0], held).require().displacement
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-7)
    np.testing.assert_allclose(u[top, 2], -0.8)


def test_a_load_without_equilibrium_is_named(
    mesh: TetMesh, youngs: np.ndarray, supports: Supports
) -> None:
    body = SoftBody(mesh, make_material("neo_hookean", 0.45))
    loads = loads_of(body)
    loads[1] *= 1e4
    with pytest.raises(ConvergenceError, match=r"Load cases \[1\] have no equilibrium after 8"):
        DeviceBody(body, "cpu", DeviceOptions(max_iterations=8)).equilibrate(
            youngs, loads, supports
        )


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device here")
def test_a_device_that_is_not_there_is_refused(mesh: TetMesh) -> None:
    with pytest.raises(ConfigError, match="device=cuda: there is no CUDA device here"):
        DeviceBody(SoftBody(mesh, make_material("neo_hookean", 0.45)), "cuda")


def test_conjugate_gradients_solve_each_case_to_its_accuracy() -> None:
    rng = np.random.default_rng(0)
    roots = torch.from_numpy(rng.standard_normal((3, 12, 12)))
    matrices = roots @ roots.mT + torch.eye(12, dtype=torch.float64)
    rhs = torch.from_numpy(rng.standard_normal((3, 4, 3)))

    def times(v: torch.Tensor) -> torch.Tensor:
        return (matrices @ v.reshape(3, 12, 1)).reshape(v.shape)

    accuracy = torch.tensor([1e-12, 1e-12, 1e-1], dtype=torch.float64)
    x = solve_batch(times, rhs, lambda r: r, accuracy, 200)
    off = (times(x) - rhs).flatten(1).norm(dim=1) / rhs.flatten(1).norm(dim=1)
    assert off[0] < 1e-10
    assert off[1] < 1e-10
    assert 1e-8 < off[2] < 0.2


def test_negative_curvature_ends_a_case_with_a_way_down() -> None:
    def times(v: torch.Tensor) -> torch.Tensor:
        return -v

    rhs = torch.ones(1, 2, 3, dtype=torch.float64)
    x = solve_batch(times, rhs, lambda r: r, torch.tensor([1e-8], dtype=torch.float64), 50)
    torch.testing.assert_close(x, rhs)
