"""Files as gmsh, Abaqus, CalculiX, SOFA, PyVista and scanners write them, and damaged headers."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyvista
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import FileError, MeshError, TactorchError
from tactorch.mesh import Box, Sphere, TetMesh, box_mesh, read_mesh, read_surface
from tactorch.mesh.checks import closed_surface
from tactorch.mesh.decimate import MAX_DISTANCE, decimated
from tactorch.mesh.formats import surfaces
from tactorch.mesh.formats.cells import SOLIDS, Cells, MeshFile, as_tets, split
from tactorch.mesh.formats.groups import regions_of_groups
from tactorch.mesh.geometry import enclosed_volume

CUBE = box_mesh(10.0, 2)
RIGHT = (CUBE.centroids[:, 0] > CUBE.points[:, 0].mean()).astype(int)
TETS = np.array(CUBE.tets)
TRIANGLE, TET4 = 2, 4  # gmsh's types
REGIONS = np.where(RIGHT, 20, 10)


def section(name: str, *lines: object) -> list[str]:
    return [f"${name}", *map(str, lines), f"$End{name}"]


def rows(table: np.ndarray) -> list[str]:
    return [" ".join(f"{x:.17g}" for x in row) for row in table]


def gmsh4(
    path: Path,
    groups: dict[int, list[int]],
    order: np.ndarray | None = None,
    binary: str = "",
    parametric: bool = False,
    surface: bool = False,
) -> Path:
    """Write format 4.1 with two volumes; `binary` is the order of bytes."""
    tags = np.arange(1, 28) if order is None else order
    volumes = [(tag + 1, TETS[tag == RIGHT]) for tag in (0, 1)]
    width = 5 if parametric else 3
    points = np.column_stack((CUBE.points, np.full((27, width - 3), 0.5)))
    faces = np.array(CUBE.surface.triangles) if surface else np.zeros((0, 3), int)

    def text(code: str, *values: float) -> bytes:
        if not binary:
            return (" ".join(f"{v:.17g}" for v in values) + "\n").encode()
        codes = {"i": f"{binary}i4", "n": f"{binary}u8", "d": f"{binary}f8"}
        return b"".join(
            np.array([v]).astype(codes[c]).tobytes() for c, v in zip(code, values, strict=True)
        )

    out = b"$MeshFormat\n" + f"4.1 {int(bool(binary))} 8\n".encode()
    out += np.array([1], f"{binary}i4").tobytes() + b"\n" if binary else b""
    out += b'$EndMeshFormat\n$PhysicalNames\n2\n3 10 "tissue"\n3 20 "lump"\n$EndPhysicalNames\n'
    out += b"$Entities\n" + text("nnnn", 0, 0, int(surface), 2)
    if surface:
        out += text("iddddddnn", 1, 0, 0, 0, 1, 1, 1, 0, 0)
    for tag in (1, 2):
        own = groups.get(tag, [])
        kinds = "iddddddn" + "i" * len(own) + "n"
        out += text(kinds, tag, 0, 0, 0, 1, 1, 1, len(own), *own, 0)
    out += b"\n$EndEntities\n$Nodes\n" + text("nnnn", 1, 27, tags.min(), tags.max())
    out += text("iiin", 2 if parametric else 3, 1, int(parametric), 27)
    out += b"".join(text("n", tag) for tag in tags)
    out += b"".join(text("d" * width, *point) for point in points)
    out += b"\n$EndNodes\n$Elements\n" + text("nnnn", 2 + surface, 48 + len(faces), 1, 999)
    if surface:
        out += text("iiin", 2, 1, TRIANGLE, len(faces))
        out += b"".join(text("nnnn", 500 + i, *tags[face]) for i, face in enumerate(faces))
    number = 0
    for tag, cells in volumes:
        out += text("iiin", 3, tag, TET4, len(cells))
        for cell in cells:
            number += 1
            out += text("nnnnn", number, *tags[cell])
    path.write_bytes(out + b"\n$EndElements\n$NodeData\nskipped\n$EndNodeData\n")
    return path


def gmsh2(path: Path, *, tags: Callable[[int], list[list[int]]], nodes: str = "Nodes") -> Path:
    """Write format 2.2; `tags` are those of each repetition of an element."""
    place = [f" 3 {i}" if i % 2 else f" 2 {i} 0.5 0.5" for i in range(27)]
    points = [
        f"{7 * i + 3} {row}{place[i] if nodes == 'ParametricNodes' else ''}"
        for i, row in enumerate(rows(CUBE.points))
    ]
    elements = [
        f"4 {len(own)} {' '.join(map(str, own))} {' '.join(str(7 * node + 3) for node in cell)}"
        for i, cell in enumerate(TETS)
        for own in tags(i)
    ]
    numbered = [f"{i} {line}" for i, line in enumerate(elements, start=1)]
    lines = ["// a comment", *section("Comments", "of $Nodes"), *section("MeshFormat", "2.2 0 8")]
    lines += [*section(nodes, 27, *points), *section("Periodic", 0)]
    path.write_text("\r\n".join([*lines, *section("Elements", len(numbered), *numbered)]) + "\r\n")
    return path


@pytest.mark.parametrize("binary", ["", "<", ">"])
@pytest.mark.parametrize(
    ("groups", "expected"),
    [
        ({1: [10], 2: [20]}, (10, 20)),
        ({1: [1, 10], 2: [1, 20]}, (10, 20)),
        ({1: [10, 1], 2: [20, 1]}, (10, 20)),
        ({1: [1], 2: [1, 20]}, (1, 20)),
        ({1: [5], 2: [5]}, (5, 5)),
    ],
)
def test_groups_of_gmsh(
    tmp_path: Path, binary: str, groups: dict[int, list[int]], expected: tuple[int, int]
) -> None:
    sparse = np.random.default_rng(0).choice(2_000_000_000, 27, replace=False) + 1
    path = gmsh4(tmp_path / "m.msh", groups, sparse, binary, parametric=True, surface=True)
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.points, CUBE.points)
    assert mesh.regions is not None
    of_right = mesh.centroids[:, 0] > CUBE.points[:, 0].mean()
    np.testing.assert_array_equal(mesh.regions, np.where(of_right, expected[1], expected[0]))


@pytest.mark.parametrize("nodes", ["Nodes", "ParametricNodes"])
def test_repeated_elements_of_gmsh_2_are_one(tmp_path: Path, nodes: str) -> None:
    path = gmsh2(tmp_path / "m.msh", tags=lambda i: [[1, 1], [REGIONS[i], 1]], nodes=nodes)
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.tets, CUBE.tets)
    np.testing.assert_array_equal(mesh.regions, REGIONS)


def test_any_number_of_tags_of_gmsh_2(tmp_path: Path) -> None:
    mesh = read_mesh(gmsh2(tmp_path / "m.msh", tags=lambda i: [[5] * (i % 4)]))
    np.testing.assert_array_equal(mesh.regions, np.where(np.arange(48) % 4, 5, 0))
    assert read_mesh(gmsh2(tmp_path / "n.msh", tags=lambda i: [[]])).regions is None


def test_gmsh_1(tmp_path: Path) -> None:
    """The format of SOFA's older meshes, with a node that nothing uses."""
    points = [f"{i} {row}" for i, row in enumerate(rows(np.vstack((CUBE.points, [99, 0, 0]))))]
    cells = [f"{i} 4 {REGIONS[i]} 1 4 {' '.join(map(str, t))}" for i, t in enumerate(TETS)]
    path = tmp_path / "m.msh"
    lines = ["$NOD", "28", *points, "$ENDNOD", "$ELM", "48", *cells, "$ENDELM"]
    path.write_text("\n".join(lines) + "\n")
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.tets, CUBE.tets)
    np.testing.assert_array_equal(mesh.regions, REGIONS)


def test_lost_groups_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert read_mesh(gmsh4(tmp_path / "m.msh", {})).regions is None
    assert "names groups of volumes (tissue, lump)" in caplog.text


def test_groups_that_overlap(caplog: pytest.LogCaptureFixture) -> None:
    """Of several groups those that divide the body, or a warning that names them."""
    every, one = np.arange(8), np.ones(8)
    names = {3: "touched"}
    groups = {1: every[:5], 2: every[5:], 3: every[3:7]}
    found = regions_of_groups(groups, one, names, "m.msh")
    np.testing.assert_array_equal(found, [1] * 5 + [2] * 3)
    assert "overlapping groups 1, 2, 3 (touched), regions are 1, 2" in caplog.text
    caplog.clear()
    regions_of_groups(groups | {4: every[:4], 5: every[4:]}, one, names, "m.msh")
    assert "not clear which divide the body" in caplog.text
    caplog.clear()
    found = regions_of_groups({1: every[:6], 2: every[4:]}, one, names, "m.msh")
    assert "not clear which divide the body" in caplog.text
    assert regions_of_groups({1: every[:0]}, one, names, "m.msh") is None
    with pytest.raises(MeshError, match="it has 100001 groups or sets; write 100000"):
        regions_of_groups(dict.fromkeys(range(100_001), every), one, names, "m.msh")
    nested = {1: every, 2: every[2:], 3: every[4:], 4: every}
    found = regions_of_groups(nested, one, names, "m.msh")
    np.testing.assert_array_equal(found, [1, 1, 2, 2, 3, 3, 3, 3])


@pytest.mark.parametrize("section", ["Nodes", "Elements", "Entities"])
def test_many_blocks_of_gmsh_are_refused(tmp_path: Path, section: str) -> None:
    text = f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n${section}\n200001 4 1 4\n$End{section}\n"
    (tmp_path / "m.msh").write_text(text)
    with pytest.raises(FileError, match="it has 200001 blocks"):
        read_mesh(tmp_path / "m.msh")


NODES = "$Nodes\n1\n1 0 0 0\n$EndNodes\n"


@pytest.mark.parametrize(
    ("version", "text"),
    [
        (2.2, "$Nodes\n1000000000\n1 0 0 0\n$EndNodes\n"),
        (2.2, NODES + "$Elements\n9999999999\n1 4 0 1 1 1 1\n$EndElements\n"),
        (2.2, NODES + "$Elements\n1\n1 4 -9 1 1 1 1\n$EndElements\n"),
        (2.2, NODES + "$Elements\n1\n1 4 0 1 1 1 8\n$EndElements\n"),
        (4.1, "$Nodes\n9999999999 9 1 9\n3 1 0 99999999999\n$EndNodes\n"),
        (4.1, "$Entities\n0 0 0 9999999999\n$EndEntities\n"),
        (4.1, "$Nodes\nnan 1 1 1\n$EndNodes\n"),
        (4.1, "$Nodes\n1 1 1 1\n3 1 0 1\n1\n0 0 0\n"),
        (4.1, "$Nodes\n1 1 1 1\n3 1 0 1\n1\n0 0 zero\n$EndNodes\n"),
    ],
)
def test_what_gmsh_files_may_not_state(tmp_path: Path, version: float, text: str) -> None:
    (tmp_path / "m.msh").write_text(f"$MeshFormat\n{version} 0 8\n$EndMeshFormat\n{text}")
    with pytest.raises(FileError, match=r"m\.msh' cannot be read as gmsh"):
        read_mesh(tmp_path / "m.msh")


# --- Elements of other shapes ----------------------------------------------------------------


def grid(shape: tuple[int, int, int], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points, slightly moved within and numbered at random, and hexahedra."""
    axes = [np.arange(n + 1.0) for n in shape]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = ((points > 0) & (points < shape)).all(axis=1)
    points[inside] += rng.uniform(-0.1, 0.1, (inside.sum(), 3))
    number = np.arange(len(points)).reshape([n + 1 for n in shape])
    corner = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    cells = np.stack(
        [
            number[i : i + shape[0], j : j + shape[1], k : k + shape[2]].ravel()
            for i, j, k in corner
        ],
        axis=1,
    )
    order = rng.permutation(len(points))
    moved = np.empty_like(points)
    moved[order] = points
    return moved, order[cells]


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.integers(1, 3)] * 3), st.integers(0, 2**32))
def test_elements_that_share_faces_are_divided_alike(
    shape: tuple[int, int, int], seed: int
) -> None:
    """Hexahedra, some of them as wedges or pyramids: a sound mesh of the same volume."""
    rng = np.random.default_rng(seed)
    points, hexahedra = grid(shape, rng)
    # Triangles of wedges meet those of other wedges, as in a column of them.
    wedge = np.repeat(rng.integers(2, size=shape[0] * shape[1]), shape[2])
    kind = np.where(wedge == 1, 1, 2 * rng.integers(2, size=len(hexahedra)))
    wedges = hexahedra[kind == 1][:, [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]]].reshape(-1, 6)
    centres = points[hexahedra[kind == 2]].mean(axis=1)
    apex = len(points) + np.arange(len(centres))
    faces = hexahedra[kind == 2][:, np.array(SOLIDS["hexahedron"][1])].reshape(-1, 4)
    pyramids = np.column_stack((faces, np.repeat(apex, 6)))
    cells = [Cells("hexahedron", hexahedra[kind == 0]), Cells("wedge", wedges)]
    cells.append(Cells("pyramid", pyramids))
    regions = np.concatenate([np.full(len(c.nodes), i) for i, c in enumerate(cells)])
    all_points = np.vstack((points, centres))
    tets, region = as_tets(MeshFile(all_points, cells, regions), "m")
    mesh = TetMesh.create(all_points, tets, regions=region)
    assert mesh.volumes.sum() == pytest.approx(np.prod(shape), rel=1e-12)
    np.testing.assert_array_equal(np.unique(region), np.unique(kind))


def test_a_collapsed_hexahedron_is_a_wedge() -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)], float)
    tets, parents = split("hexahedron", np.array([[0, 1, 2, 2, 3, 4, 5, 5]]))
    mesh = TetMesh.create(points, tets)
    assert mesh.n_tets == 3
    assert not parents.any()
    assert mesh.volumes.sum() == pytest.approx(0.5)


def test_elements_that_cannot_be_divided_are_named() -> None:
    cells = [Cells("hexa_prism", np.arange(12)[None])]
    with pytest.raises(MeshError, match=r"hexagonal prisms.*Tetrahedralize in ParaView"):
        as_tets(MeshFile(np.zeros((12, 3)), cells), "m")


def quadratic() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and 10-node tetrahedra of the cube, in the order of VTK and Abaqus."""
    ends = TETS[:, [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]]]
    edges, place = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    points = np.vstack((CUBE.points, CUBE.points[edges].mean(axis=1)))
    return points, np.column_stack((TETS, 27 + place.reshape(-1, 6)))


@pytest.mark.parametrize("curved", [False, True])
def test_quadratic_tetrahedra_of_gmsh(
    tmp_path: Path, curved: bool, caplog: pytest.LogCaptureFixture
) -> None:
    points, cells = quadratic()
    points[27:] += 0.2 * curved
    nodes = [f"{i} {row}" for i, row in enumerate(rows(points))]
    order = cells[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]
    lines = [f"{i} 11 2 {REGIONS[i]} 1 {' '.join(map(str, c))}" for i, c in enumerate(order)]
    parts = [section("MeshFormat", "2.2 0 8"), section("Nodes", len(points), *nodes)]
    parts.append(section("Elements", 48, *lines))
    path = tmp_path / "m.msh"
    path.write_text("\n".join(line for part in parts for line in part) + "\n")
    mesh = read_mesh(path)
    assert mesh.content_hash() == CUBE.content_hash()
    np.testing.assert_array_equal(mesh.regions, REGIONS)
    assert ("straight edges (0.35 " in caplog.text) is curved
    assert "read with their corner nodes" in caplog.text
    assert f"no tetrahedron uses {len(points) - 27} of {len(points)} nodes" in caplog.text


# --- Abaqus and CalculiX -------------------------------------------------------------------


def inp(path: Path, *lines: str, kind: str = "C3D4", head: tuple[str, ...] = ()) -> Path:
    points, cells = (CUBE.points, TETS) if "10" not in kind else quadratic()
    text = ["*HEADING", "cube", "** a comment", *head, "*Node, nset=all"]
    text += [f"{i}, " + ", ".join(map(str, p)) for i, p in enumerate(points.tolist(), start=1)]
    text.append(f"*Element, type={kind}")
    for number, cell in enumerate((cells + 1).tolist(), start=1):
        words = [str(number), *map(str, cell)]
        text += [", ".join(words[:8]) + ("," if words[8:] else ""), ", ".join(words[8:])]
    path.write_text("\n".join([*text, *lines]) + "\n")
    return path


def listed(numbers: np.ndarray) -> list[str]:
    return [", ".join(map(str, numbers[i : i + 16])) for i in range(0, len(numbers), 16)]


LUMP = listed(np.flatnonzero(RIGHT) + 1)
TISSUE = listed(np.flatnonzero(RIGHT == 0) + 1)


@pytest.mark.parametrize("kind", ["C3D4", "c3d4h", "C3D4T", "DC3D4", "AC3D4", "C3D10", "C3D10MH"])
def test_tetrahedra_of_abaqus(tmp_path: Path, kind: str) -> None:
    path = inp(tmp_path / "m.inp", "*ELSET,", " elset=lump", *LUMP, kind=kind)
    mesh = read_mesh(path)
    assert mesh.content_hash() == CUBE.content_hash()
    np.testing.assert_array_equal(mesh.regions, RIGHT)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (("*Elset, elset=A", *LUMP, "*Elset, elset=B", *TISSUE), 2 - RIGHT),
        (("*ELSET, ELSET=ALL, GENERATE", "1, 48", "*elset, elset=b", *LUMP), 1 + RIGHT),
        (("*ELSET,ELSET=A,GENERATE", "1,48,2", "*ELSET,ELSET=B,GENERATE", "2,48,2"), "odd"),
        (("*ELSET, ELSET=A", *LUMP, "*ELSET, ELSET=B", *TISSUE, "*ELSET, ELSET=C", "A,B"), "ab"),
        # Sections, not other sets, divide the body.
        (
            ("*Elset, elset=_Pick, internal", *LUMP, "*Elset, elset=view, generate", "1, 20, 1",
             "*Elset, elset=t", *TISSUE, "*Solid Section, elset=_Pick, material=L", ",",
             "*Solid Section, elset=t, material=T"), 2 - RIGHT,
        ),
        (("*Surface, name=s", "1, S1", "*Step", "*Static", "1, 1", "*End Step"), None),
    ],
)  # fmt: skip
def test_sets_of_abaqus_are_regions(tmp_path: Path, lines: tuple[str, ...], expected) -> None:
    regions = read_mesh(inp(tmp_path / "m.inp", *lines)).regions
    if isinstance(expected, str):
        expected = 2 - RIGHT if expected == "ab" else 1 + np.arange(48) % 2
    np.testing.assert_array_equal(regions, expected)


def test_a_part_is_at_the_place_of_its_instance(tmp_path: Path) -> None:
    instance = ("*End Part", "*Assembly, name=A", "*Instance, name=P-1, part=P", "1., 2., 3.")
    turn = "0., 0., 0., 0., 0., 1., 90."
    sets = ("*End Instance", "*Elset, elset=lump, instance=P-1", *LUMP, "*End Assembly")
    path = inp(tmp_path / "m.inp", *instance, turn, *sets, head=("*Part, name=P",))
    mesh, (x, y, z) = read_mesh(path), np.add(CUBE.points, [1.0, 2.0, 3.0]).T
    np.testing.assert_allclose(mesh.points, np.column_stack((-y, x, z)), atol=1e-12)
    np.testing.assert_array_equal(mesh.regions, RIGHT)
    twice = (*instance, *sets[:1], "*Instance, name=P-2, part=P", "20., 0., 0.", "*End Instance")
    with pytest.raises(MeshError, match=r"m\.inp': the part P has 2 instances; write one"):
        read_mesh(inp(tmp_path / "m.inp", *twice, head=("*Part, name=P",)))
    with pytest.raises(FileError, match=r"m\.inp' .* it has no \*END for the part P"):
        read_mesh(inp(tmp_path / "m.inp", head=("*Part, name=P",)))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("*ELSET, ELSET=BIG, GENERATE", "1, 2000000000, 1"), "BIG has 2000000000 elements"),
        (("*ELSET, ELSET=BIG", "1, 99"), "BIG has 2 elements, of which the file does not have all"),
        (("*ELSET, ELSET=A", "B", "*ELSET, ELSET=B", "A"), "in itself"),
        (("*ELSET, ELSET=A", "B"), "no set of elements B"),
        (("*NGEN", "1, 5"), r"\*NGEN makes or moves nodes"),
        (("*ELEMENT, TYPE=C3D7", "1, 2"), "elements C3D7 are not known; use C3D4"),
        (("*ELEMENT, TYPE=C3D4", "99, 1, 2, 3, 99"), "there is no node 99"),
        (("*ELEMENT, TYPE=C3D4", "99, 1, 2, 3"), "do not have 4 nodes"),
        (("*INCLUDE, INPUT=/dev/zero",), "'/dev/zero', which is not in the folder of the mesh"),
        (("*include,input=../m.inp",), r"'\.\./m\.inp', which is not in the folder"),
        (("*INCLUDE, INPUT=m.inp",), "which includes itself"),
        (("*INCLUDE, INPUT=fifo",), "is no file"),
        (("*INCLUDE, INPUT=deep0.inp",), "one in another"),
        (("*NODE, INPUT=absent.txt",), "is no file; copy it to the folder of the mesh"),
    ],
)
def test_what_abaqus_files_may_not_state(
    tmp_path: Path, lines: tuple[str, ...], message: str
) -> None:
    os.mkfifo(tmp_path / "fifo")
    for i in range(20):
        (tmp_path / f"deep{i}.inp").write_text(f"*INCLUDE, INPUT=deep{i + 1}.inp\n")
    with pytest.raises(TactorchError, match=message):
        read_mesh(inp(tmp_path / "m.inp", *lines))


def test_includes_of_includes_are_counted(tmp_path: Path) -> None:
    for i in range(3):
        (tmp_path / f"{i}.inp").write_text(f"*INCLUDE, INPUT={i + 1}.inp\n" * 11)
    (tmp_path / "3.inp").write_text("")
    with pytest.raises(FileError, match="includes more than 1000 files"):
        read_mesh(tmp_path / "0.inp")


def test_included_files_in_the_folder(tmp_path: Path) -> None:
    whole = inp(tmp_path / "whole.inp").read_text().split("*Element", 1)
    (tmp_path / "sub").mkdir()
    nodes = whole[0].split("*Node, nset=all\n")[1].replace("5.0", "0.5D+01")
    (tmp_path / "sub" / "nodes.txt").write_text(nodes)
    (tmp_path / "elements.inp").write_text("*Element" + whole[1])
    (tmp_path / "m.inp").write_text('*NODE, INPUT="sub/nodes.txt"\n*Include, input=elements.inp\n')
    assert read_mesh(tmp_path / "m.inp").content_hash() == CUBE.content_hash()


def test_sets_do_not_exhaust_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many sets of many elements take more memory than the file has bytes."""
    monkeypatch.setenv("TACTORCH_FILE_GIB", "0.002")
    sets = [line for i in range(2000) for line in (f"*ELSET, ELSET=S{i}, GENERATE", "1, 48, 1")]
    with pytest.raises(TactorchError, match="2000 sets of elements"):
        read_mesh(inp(tmp_path / "m.inp", *sets))


# --- VTK -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["region", "gmsh:physical", "CellEntityIds", "Material_ID"])
def test_regions_of_vtk_files(tmp_path: Path, name: str) -> None:
    mesh = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: TETS}, np.array(CUBE.points))
    mesh.cell_data[name] = REGIONS
    mesh.save(tmp_path / "m.vtu")
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.vtu").regions, REGIONS)


@pytest.mark.parametrize("value", [0.5, np.nan])
def test_a_material_that_is_no_number_of_a_region_is_named(
    tmp_path: Path, value: float, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: TETS}, np.array(CUBE.points))
    mesh.cell_data["material"] = np.full(len(TETS), value)
    mesh.save(tmp_path / "m.vtu")
    assert read_mesh(tmp_path / "m.vtu").regions is None
    assert "m.vtu': 'material' has values that are not whole numbers" in caplog.text
    mesh.cell_data["region_id"] = REGIONS
    mesh.save(tmp_path / "m.vtu")
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.vtu").regions, REGIONS)


def test_a_vtk_file_without_cells_is_refused(tmp_path: Path) -> None:
    pyvista.UnstructuredGrid().save(tmp_path / "m.vtu")
    with pytest.raises(FileError, match="has no points: it is empty"):
        read_mesh(tmp_path / "m.vtu")


def test_boxes_of_vtk_are_divided(tmp_path: Path) -> None:
    voxels = pyvista.ImageData(dimensions=(3, 4, 3)).cast_to_unstructured_grid()
    voxels.cell_data["region"] = np.arange(12)
    voxels.save(tmp_path / "v.vtu")
    mesh = read_mesh(tmp_path / "v.vtu")
    assert mesh.regions is not None
    np.testing.assert_allclose(np.bincount(mesh.regions, mesh.volumes), 1.0)
    np.testing.assert_allclose(mesh.surface.areas.sum(), 32.0)
    hexahedra = pyvista.StructuredGrid(
        *np.meshgrid(*[np.arange(3.0)] * 3)
    ).cast_to_unstructured_grid()
    hexahedra.save(tmp_path / "h.vtu")
    assert read_mesh(tmp_path / "h.vtu").volumes.sum() == pytest.approx(8.0)


def test_pieces_of_a_vtk_file_are_joined(tmp_path: Path) -> None:
    vtk, path = pytest.importorskip("vtkmodules.vtkIOXML"), tmp_path / "p.vtu"
    parts = []
    for x in (0.0, 2.0):
        writer = vtk.vtkXMLUnstructuredGridWriter()
        writer.SetFileName(str(path))
        grid = pyvista.ImageData(dimensions=(3, 3, 3), origin=(x, 0.0, 0.0))
        writer.SetInputData(grid.cast_to_unstructured_grid())
        writer.SetDataModeToBinary()
        writer.Write()
        parts.append(path.read_text())
    piece = parts[0][parts[0].index("<Piece") : parts[0].index("</UnstructuredGrid>")]
    path.write_text(parts[1].replace("</UnstructuredGrid>", piece + "</UnstructuredGrid>"))
    assert read_mesh(path).volumes.sum() == pytest.approx(16.0)


# --- Surfaces ------------------------------------------------------------------------------

BALL = Sphere(radius_mm=10.0).surface(16)


def stl_text(vertices: np.ndarray, triangles: np.ndarray, name: str) -> list[str]:
    lines = [f"solid {name}"]
    for corners in vertices[triangles]:
        lines += ["facet normal 0 0 0", " outer loop"]
        lines += [f"  vertex {' '.join(f'{x:.9g}' for x in corner)}" for corner in corners]
        lines += [" endloop", "endfacet"]
    return [*lines, f"endsolid {name}"]


def test_text_of_several_solids(tmp_path: Path) -> None:
    vertices, triangles = BALL
    first, second = stl_text(vertices, triangles[:50], "a"), stl_text(vertices, triangles[50:], "b")
    (tmp_path / "s.stl").write_text("\r\n".join([*first, *(line.upper() for line in second)]))
    found, faces = read_surface(tmp_path / "s.stl")
    np.testing.assert_allclose(found[faces], vertices[triangles], atol=1e-7)
    (tmp_path / "s.stl").write_text("\n".join([*first, *second][:-4]))
    with pytest.raises(FileError, match="no line 'endsolid' at its end"):
        read_surface(tmp_path / "s.stl")
    four = [*first[:6], first[5], *first[6:]]
    (tmp_path / "s.stl").write_text("\n".join(four))
    with pytest.raises(FileError, match="vertices, not three each"):
        read_surface(tmp_path / "s.stl")
    (tmp_path / "s.stl").write_text("\ufeff" + "\r".join([*first, *second]), newline="")
    found, faces = read_surface(tmp_path / "s.stl")
    np.testing.assert_allclose(found[faces], vertices[triangles], atol=1e-7)


def test_binary_that_begins_with_solid(tmp_path: Path) -> None:
    vertices, triangles = BALL
    table = np.zeros((len(triangles), 50), np.uint8)
    table[:, 12:48] = vertices[triangles].astype("<f4").reshape(-1, 9).view(np.uint8)
    head = b"solid of a CAD program".ljust(80) + np.uint32(len(triangles)).tobytes()
    for after in (b"", b"made by a CAD program"):
        (tmp_path / "s.stl").write_bytes(head + table.tobytes() + after)
        found, faces = read_surface(tmp_path / "s.stl")
        np.testing.assert_allclose(found[faces], vertices[triangles], atol=1e-5)
    (tmp_path / "s.stl").write_bytes(b"x" * 80 + np.uint32(4e9).tobytes() + b"0" * 50)
    with pytest.raises(FileError, match="states 4000000000 triangles, and has 134 bytes"):
        read_surface(tmp_path / "s.stl")


def ply(path: Path, order: str) -> Path:
    """Write normals, colours, flags, texture coordinates and edges besides the surface."""
    vertices, triangles = BALL
    kind = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = (
        f"ply\nformat {kind} 1.0\ncomment of a scanner\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\nproperty float nx\n"
        f"property uchar red\nelement face {len(triangles)}\nproperty uchar flag\n"
        "property list uchar int vertex_indices\nproperty list uchar float texcoord\n"
        "element edge 1\nproperty int vertex1\nend_header\n"
    )
    e = order or "="
    body = []
    for point in vertices:
        body += [(f"{e}f8", point), (f"{e}f4", [1]), ("u1", [9])]
    for i, face in enumerate(triangles):
        texture = [0.5] * (6 if i % 3 else 0)
        body += [("u1", [7]), ("u1", [3]), (f"{e}i4", face), ("u1", [len(texture)])]
        body.append((f"{e}f4", texture))
    body.append((f"{e}i4", [3]))
    if order:
        path.write_bytes(head.encode() + b"".join(np.array(v).astype(k).tobytes() for k, v in body))
    else:
        path.write_text(head + "\n".join(" ".join(f"{x:.17g}" for x in v) for _, v in body) + "\n")
    return path


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_ply_with_other_properties(tmp_path: Path, order: str) -> None:
    vertices, triangles = BALL
    path = ply(tmp_path / "s.ply", order)
    found, faces = read_surface(path)
    np.testing.assert_array_equal(found[faces], vertices[triangles])
    content = path.read_bytes()
    for line in (b"element vertex %d" % len(vertices), b"element face %d" % len(triangles)):
        path.write_bytes(content.replace(line, line.rsplit(b" ", 1)[0] + b" 1000000000"))
        with pytest.raises(TactorchError, match=r"s\.ply'.*(states|number|ascii|vertex|index)"):
            read_surface(path)


def prism(path: Path, corners: list[tuple[float, float]]) -> Path:
    """Write a prism of height 10 with its ends as polygons, as CAD programs do."""
    n = len(corners)
    lines = [f"v {x} {y} {z}" for z in (0, 10) for x, y in corners]
    lines += ["g bottom", "f " + " ".join(f"{i + 1}//1" for i in reversed(range(n))), "g top"]
    lines.append("f " + " ".join(f"{i - n}/1/1" for i in range(n)))
    lines += [f"f {i + 1} {(i + 1) % n + 1} {(i + 1) % n + 1 + n} {i + 1 + n}" for i in range(n)]
    path.write_bytes("\n".join(["# caf\xe9", *lines]).encode("latin-1"))
    return path


@pytest.mark.parametrize(
    ("corners", "area"),
    [
        ([(0, 0), (10, 0), (15, 5), (10, 10), (0, 10)], 125.0),
        ([(0, 0), (10, 0), (10, 4), (4, 4), (4, 10), (0, 10)], 64.0),
        ([(0, 0), (5, 3), (10, 0), (5, 12)], 45.0),
    ],
)
def test_polygons_are_divided(tmp_path: Path, corners: list[tuple], area: float) -> None:
    """Also those that are not convex."""
    points, faces = closed_surface(*read_surface(prism(tmp_path / "s.obj", corners)))
    assert enclosed_volume(points, faces) == pytest.approx(10.0 * area)
    halves = np.linalg.norm(np.cross(*np.diff(points[faces], axis=1).swapaxes(0, 1)), axis=1) / 2
    ends = np.ptp(points[faces][..., 2], axis=1) == 0.0
    assert halves[ends].sum() == pytest.approx(2.0 * area)


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_faces_of_different_widths_keep_their_order(tmp_path: Path, suffix: str) -> None:
    """Quickly: exports of modelling programs have triangles among quadrangles."""
    side, count = 100, 99 * 99
    points = np.column_stack((*np.divmod(np.arange(side**2), side), np.zeros(side**2)))
    first = np.add.outer(side * np.arange(side - 1), np.arange(side - 1)).ravel()
    square = first[:, None] + [0, side, side + 1, 1]
    faces = [[*row] if i % 2 else [*row[:3]] for i, row in enumerate(square.tolist())]
    if suffix == "ply":
        lines = ["ply", "format ascii 1.0", f"element vertex {side**2}"]
        lines += [f"property float {axis}" for axis in "xyz"] + [f"element face {count}"]
        lines += ["property list uchar int vertex_indices", "end_header", *rows(points)]
        lines += [" ".join(map(str, (len(face), *face))) for face in faces]
    else:
        lines = [f"v {row}" for row in rows(points)]
        lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    (tmp_path / f"s.{suffix}").write_text("\n".join(lines) + "\n")
    start = time.perf_counter()
    found, triangles = read_surface(tmp_path / f"s.{suffix}")
    assert time.perf_counter() - start < 0.4
    expected = [
        face[i] for face in faces for i in ((0, 1, 2, 0, 2, 3) if len(face) > 3 else (0, 1, 2))
    ]
    used = np.unique(expected)
    np.testing.assert_array_equal(found[triangles].reshape(-1, 3), points[expected])
    assert len(found) == len(used)


# Faces without vertices among those of one.
SHORT_ROWS = (
    "ply\nformat binary_little_endian 1.0\nelement face 202\n"
    "property list uchar int vertex_indices\nend_header\n" + "\0\1\0\0\0\0" * 101
)


@pytest.mark.parametrize(
    ("suffix", "content", "message"),
    [
        ("stl", "solid\n" + "\n" * 6_000_000 + "endsolid\n", "cannot be read"),
        ("obj", "v 0 0 0\n" + "\n" * 6_000_000, "1 points and no faces"),
        ("ply", SHORT_ROWS, "more than 100 rows that differ"),
        ("obj", "v 0 0 0\n" * 101, "line 101: it has more than 100 vertices and faces"),
        ("obj", "v 0 0 0\nf" + " 1" * 50_000, "faces have up to 50000 vertices, whose division"),
    ],
)
def test_what_would_take_long_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, content: str, message: str
) -> None:
    monkeypatch.setattr(surfaces, "_MAX_ROWS", 100)
    (tmp_path / f"s.{suffix}").write_text(content)
    start = time.perf_counter()
    with pytest.raises(TactorchError, match=message):
        read_surface(tmp_path / f"s.{suffix}")
    assert time.perf_counter() - start < 0.4


def test_vertices_that_differ_by_rounding_are_merged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    vertices, triangles = Box(size_mm=10.0).surface()
    corners = vertices[triangles].reshape(-1, 3)
    corners = corners + np.random.default_rng(0).uniform(-1e-6, 1e-6, corners.shape)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in corners]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(triangles))]
    (tmp_path / "s.obj").write_text("\n".join(lines))
    points, faces = closed_surface(*read_surface(tmp_path / "s.obj"))
    assert len(points) == 8
    comment = "# of C:\\scans\\\n"  # does not go on, unlike the faces
    (tmp_path / "s.obj").write_text(comment + "\n".join(lines).replace("f ", "f \\\n  "))
    np.testing.assert_array_equal(closed_surface(*read_surface(tmp_path / "s.obj"))[1], faces)
    assert enclosed_volume(points, faces) == pytest.approx(1000.0, rel=1e-5)
    assert "28 vertices are merged with others within 1.7e-05" in caplog.text


def test_many_vertices_at_almost_one_place_are_refused(tmp_path: Path) -> None:
    """All pairs of them would take too much memory."""
    points = np.random.default_rng(0).uniform(0, 1e-6, (2000, 3))
    lines = ["v 1000 0 0", *(f"v {x} {y} {z}" for x, y, z in points.tolist()), "f 1 2 3"]
    (tmp_path / "s.obj").write_text("\n".join(lines))
    with pytest.raises(MeshError, match="many of its vertices are closer than 1e-06"):
        read_surface(tmp_path / "s.obj")


def test_a_cloud_of_points_has_a_way_to_a_surface(tmp_path: Path) -> None:
    vertices, _ = Box(size_mm=10.0).surface()
    path = tmp_path / "points.ply"
    pyvista.PolyData(np.vstack((vertices, vertices.mean(axis=0)))).save(path)
    with pytest.raises(MeshError, match="9 points and no faces: a cloud of points") as raised:
        read_surface(path)
    code = str(raised.value).split('python -c "')[1].split('"')[0]
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], cwd=tmp_path, check=True)
    points, faces = closed_surface(*read_surface(tmp_path / "surface.ply"))
    assert enclosed_volume(points, faces) == pytest.approx(1000.0)


@pytest.mark.parametrize("solid", [Sphere(radius_mm=20.0), Box(size_mm=30.0)])
def test_fine_surfaces_become_coarser(solid, caplog: pytest.LogCaptureFixture) -> None:
    points, faces = solid.surface(256) if isinstance(solid, Sphere) else divided(*solid.surface())
    coarse, triangles = decimated(points, faces, 8.0)
    assert 8 * len(triangles) < len(faces)
    assert f"{len(faces)} triangles, far finer than edges of 8 mm" in caplog.text
    _, outward = closed_surface(coarse, triangles)
    np.testing.assert_array_equal(outward, triangles)
    volume = enclosed_volume(points, faces)
    assert enclosed_volume(coarse, triangles) == pytest.approx(volume, rel=1e-2)
    surface = pyvista.PolyData(coarse, np.insert(triangles, 0, 3, axis=1).ravel())
    _, nearest = surface.find_closest_cell(points, return_closest_point=True)
    assert np.linalg.norm(nearest - points, axis=1).max() < MAX_DISTANCE * 8.0
    same, kept = decimated(points, faces, 0.5)
    assert same is points
    assert kept is faces


def divided(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    surface = pyvista.PolyData(points, np.insert(faces, 0, 3, axis=1).ravel()).subdivide(
        5, "linear"
    )
    return np.array(surface.points, float), surface.faces.reshape(-1, 4)[:, 1:].astype(np.int64)
