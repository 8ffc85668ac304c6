"""NRRD and MetaImage against NIfTI of the same body, as 3D Slicer and ITK write them."""

import gzip
import time
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError
from tactorch.volumes import read_body, read_volume

from .conftest import block
from .test_read import nifti, oblique

LPS = np.diag([-1.0, -1.0, 1.0, 1.0])  # from right, anterior, superior to left, posterior
SEGMENTS = (
    "Segment0_LabelValue:=1", "Segment0_Layer:=0", "Segment0_Name:=tissue",
    "Segment1_LabelValue:=2", "Segment1_Layer:=0", "Segment1_Name:=hard, lump",
    "Segmentation_MasterRepresentation:=Binary labelmap",
)  # fmt: skip


def labels() -> np.ndarray:
    values = block().astype(np.uint8)
    values[2, 1:-1, 1:-1] = 2  # no symmetry
    return values


def vector(values: np.ndarray) -> str:
    return f"({','.join(f'{v:.17g}' for v in values)})"


def nrrd(
    path: Path,
    values: np.ndarray,
    affine: np.ndarray,
    *lines: str,
    space: str = "left-posterior-superior",
    packed: bool = True,
    data: str = "",
) -> Path:
    """Write a file; an axis before the last three is that of layers."""
    layers = values.ndim - 3
    directions = ["none"] * layers + [vector(v) for v in affine[:3, :3].T]
    content = values.tobytes(order="F")
    content = gzip.compress(content) if packed else content
    header = [
        "NRRD0005", "# Complete NRRD file format specification at:", "type: unsigned char",
        f"dimension: {values.ndim}", f"space: {space}",
        f"sizes: {' '.join(map(str, values.shape))}",
        f"space directions: {' '.join(directions)}",
        f"kinds: {' '.join(['list'] * layers + ['domain'] * 3)}",
        f"encoding: {'gzip' if packed else 'raw'}", f"space origin: {vector(affine[:3, 3])}",
        *([f"data file: {data}"] if data else []), *lines,
    ]  # fmt: skip
    path.write_bytes("\n".join([*header, "", ""]).encode() + (b"" if data else content))
    if data:
        (path.parent / data).write_bytes(content)
    return path


def meta(path: Path, values: np.ndarray, affine: np.ndarray, data: str = "LOCAL") -> Path:
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    words = {
        "ObjectType": "Image", "NDims": "3", "BinaryData": "True", "CompressedData": "False",
        "BinaryDataByteOrderMSB": "False",
        "TransformMatrix": " ".join(f"{v:.17g}" for v in (affine[:3, :3] / spacing).T.ravel()),
        "Offset": " ".join(f"{v:.17g}" for v in affine[:3, 3]),
        "ElementSpacing": " ".join(f"{v:.17g}" for v in spacing),
        "DimSize": " ".join(map(str, values.shape)), "ElementType": "MET_UCHAR",
        "ElementDataFile": data,
    }  # fmt: skip
    text = "".join(f"{key} = {value}\n" for key, value in words.items())
    content = values.tobytes(order="F")
    path.write_bytes(text.encode() + (content if data == "LOCAL" else b""))
    if data != "LOCAL":
        (path.parent / data).write_bytes(content)
    return path


@pytest.mark.parametrize(
    "name", ["v.nrrd", "v.seg.nrrd", "v.nhdr", "r.nrrd", "ras.nrrd", "las.nrrd", "v.mha", "v.mhd"]
)
def test_the_place_is_that_of_nifti(tmp_path: Path, name: str) -> None:
    path, lps = tmp_path / name, LPS @ oblique()
    if name.startswith("ras"):
        nrrd(path, labels(), oblique(), space="right-anterior-superior")
    elif name.startswith("las"):
        nrrd(path, labels(), np.diag([-1.0, 1.0, 1.0, 1.0]) @ oblique(), space="LAS")
    elif "nrrd" in name:
        nrrd(path, labels(), lps, packed=name[0] == "v")
    elif name.endswith(".nhdr"):
        nrrd(path, labels(), lps, data="v.raw.gz")
    else:
        meta(path, labels(), lps, "v.raw" if name == "v.mhd" else "LOCAL")
    expected = read_volume(nifti(tmp_path / "n.nii", labels(), oblique()))
    volume = read_volume(path)
    np.testing.assert_array_equal(volume.labels, expected.labels)
    np.testing.assert_allclose(volume.affine, LPS @ expected.affine, atol=1e-5)
    assert volume.unit == "mm"
    assert read_body(path).volume_mm3 == pytest.approx(read_body(tmp_path / "n.nii").volume_mm3)
    with pytest.raises(ConfigError, match=f"'.*{name}' states it; leave it out"):
        read_volume(path, spacing_mm=(1.0, 1.0, 1.0))


def test_segments_of_slicer_have_names(tmp_path: Path) -> None:
    volume = read_volume(nrrd(tmp_path / "v.seg.nrrd", labels(), np.eye(4), *SEGMENTS))
    assert volume.names == {1: "tissue", 2: "hard, lump"}
    lines = [line.replace("Value:=2", "Value:=1") for line in SEGMENTS]
    lines = [line.replace("1_Layer:=0", "1_Layer:=1") for line in lines]
    layers = np.stack([labels() == 1, labels() == 2]).astype(np.uint8)
    volume = read_volume(nrrd(tmp_path / "l.seg.nrrd", layers, LPS @ oblique(), *lines))
    np.testing.assert_array_equal(volume.labels, labels())
    np.testing.assert_allclose(volume.affine, LPS @ oblique(), atol=1e-6)
    assert volume.names == {1: "tissue", 2: "hard, lump"}
    layers[0] |= layers[1]
    with pytest.raises(FileError, match="segments that overlap, such as 'hard, lump'"):
        read_volume(nrrd(tmp_path / "o.seg.nrrd", layers, np.eye(4), *lines))


def test_many_segments_take_one_pass(tmp_path: Path) -> None:
    """Segments of any labels, in two layers; a label of two segments is one that overlaps."""
    values = np.zeros((2, 120, 120, 120), dtype=np.uint8)
    values[0, 1, 1, 1:120] = np.arange(119)[::-1]
    values[1, 2, 2, 1:120] = np.arange(119)
    lines = [
        line
        for i in range(238)
        for line in (f"Segment{i}_LabelValue:={i % 119}", f"Segment{i}_Layer:={i // 119}")
    ]
    lines = [line.replace("Value:=0", "Value:=200") for line in lines]
    start = time.perf_counter()
    volume = read_volume(nrrd(tmp_path / "a.nrrd", values, np.eye(4), *lines))
    assert time.perf_counter() - start < 0.5
    np.testing.assert_array_equal(volume.labels[1, 1, 1:119], np.arange(119, 1, -1))
    np.testing.assert_array_equal(volume.labels[2, 2, 2:120], np.arange(121, 239))
    assert np.count_nonzero(volume.labels) == 2 * 118
    same = [line.replace("Value:=7", "Value:=8") for line in lines]
    with pytest.raises(FileError, match="segments that overlap, such as 'segment"):
        read_volume(nrrd(tmp_path / "b.nrrd", values, np.eye(4), *same))
    for line in ("Segment0_Layer:=9", "Segment0_LabelValue:=x", f"Segment0_LabelValue:={10**30}"):
        with pytest.raises(FileError, match=r"c\.nrrd' cannot be read"):
            read_volume(nrrd(tmp_path / "c.nrrd", values, np.eye(4), line, *lines))


@pytest.mark.parametrize("skip", ["byte skip: -1", "byte skip: 7", "line skip: 1"])
def test_data_after_other_bytes(tmp_path: Path, skip: str) -> None:
    path = nrrd(tmp_path / "v.nhdr", labels(), np.eye(4), skip, packed=False, data="v.raw")
    (tmp_path / "v.raw").write_bytes(b"header\n" + (tmp_path / "v.raw").read_bytes())
    np.testing.assert_array_equal(read_volume(path).labels, labels())


def test_units_of_nrrd(tmp_path: Path) -> None:
    path = nrrd(tmp_path / "v.nrrd", labels(), np.eye(4), 'space units: "cm" "cm" "cm"')
    volume = read_volume(path)
    assert volume.unit == "cm"
    np.testing.assert_allclose(volume.voxel_mm, 10.0)


@pytest.mark.parametrize(
    ("stated", "unit"),
    [("microns", "um"), ("\u00b5m", "um"), ("Meters", "m"), ("millimetres", "mm"), ("", "mm")],
)
def test_names_of_units(tmp_path: Path, stated: str, unit: str) -> None:
    lines = [f'space units: "{stated}" "{stated}" "{stated}"'] if stated else []
    assert read_volume(nrrd(tmp_path / "v.nrrd", labels(), np.eye(4), *lines)).unit == unit


@pytest.mark.parametrize(
    ("stated", "shown"), [('"inch" "inch" "inch"', "inch"), ('"mm" "mm" "cm"', "cm, mm")]
)
def test_units_that_are_not_known_are_asked_for(tmp_path: Path, stated: str, shown: str) -> None:
    path = nrrd(tmp_path / "v.nrrd", labels(), np.eye(4), f"space units: {stated}")
    with pytest.raises(FileError, match=rf"v.nrrd' states its lengths in {shown}; give .* \(unit="):
        read_volume(path)
    assert read_volume(path, unit="cm").voxel_mm == pytest.approx(10.0)


@pytest.mark.parametrize("space", ["3D-right-handed", "scanner-xyz", "3D-left-handed", ""])
def test_spaces_without_directions_of_a_patient_keep_their_axes(tmp_path: Path, space: str) -> None:
    path = nrrd(tmp_path / "v.nrrd", labels(), oblique(), space=space)
    np.testing.assert_allclose(read_volume(path).affine, oblique(), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("long long int", "<i8"), ("unsigned long long int", "<u8"), ("short int", "<i2"),
        ("signed short", "<i2"), ("unsigned short int", "<u2"), ("uint16_t", "<u2"),
        ("signed char", "i1"), ("unsigned int", "<u4"), ("float", "<f4"), ("double", "<f8"),
    ],
)  # fmt: skip
def test_names_of_types(tmp_path: Path, name: str, code: str) -> None:
    path = nrrd(tmp_path / "v.nrrd", labels().astype(code), np.eye(4))
    path.write_bytes(path.read_bytes().replace(b"type: unsigned char", f"type: {name}".encode()))
    np.testing.assert_array_equal(read_volume(path).labels, labels())


@pytest.mark.parametrize(
    ("name", "code"), [(b"MET_LONG_LONG", "<i8"), (b"MET_LONG", "<i4"), (b"MET_ULONG", "<u4")]
)
def test_long_numbers_of_meta_images(tmp_path: Path, name: bytes, code: str) -> None:
    path = meta(tmp_path / "v.mha", labels().astype(code), np.eye(4))
    path.write_bytes(path.read_bytes().replace(b"MET_UCHAR", name))
    np.testing.assert_array_equal(read_volume(path).labels, labels())


def test_pictures_are_no_volumes(tmp_path: Path) -> None:
    path = tmp_path / "v.nrrd"
    header = "NRRD0004\ntype: uchar\nsizes: 14 14\nspace directions: (1,0) (0,1)\n\n"
    path.write_bytes(header.encode() + labels()[..., 0].tobytes())
    with pytest.raises(FileError, match=r"shape \(14, 14\); a volume of labels has three axes"):
        read_volume(path)


@pytest.mark.parametrize(
    "name", ["/etc/hostname", "../outside.raw", "absent.raw", "%03d.raw 1 9 1"]
)
def test_data_are_in_the_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    nrrd(folder / "v.nhdr", labels(), np.eye(4), data="a.raw")
    meta(folder / "v.mhd", labels(), np.eye(4), "a.raw")
    (tmp_path / "outside.raw").write_bytes((folder / "a.raw").read_bytes())
    for header in (folder / "v.nhdr", folder / "v.mhd"):
        header.write_bytes(header.read_bytes().replace(b"a.raw", name.encode()))
        with pytest.raises(FileError, match="is no file in its folder"):
            read_volume(header)


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ("2000 2000 2000", "2000 x 2000 x 2000 voxels of 1 bytes would take 82 GiB"),
        ("100 100 100", "is incomplete or its header is wrong: 100 x 100 x 100 voxels"),
        ("1 2 x", "cannot be read .*'x'"),
        ("-1 2 3", r"its sizes are \[-1, 2, 3\]"),
    ],
)
def test_sizes_are_compared_with_the_file(tmp_path: Path, sizes: str, message: str) -> None:
    raw, image = tmp_path / "v.nrrd", tmp_path / "v.mha"
    nrrd(raw, labels(), np.eye(4), packed=False)
    meta(image, labels(), np.eye(4))
    for path in (raw, image):
        path.write_bytes(path.read_bytes().replace(b"14 14 10", sizes.encode()))
        with pytest.raises(FileError, match=message):
            read_volume(path)


@pytest.mark.parametrize("name", ["v.nrrd", "v.mha"])
@pytest.mark.parametrize("damage", ["half", "text", "empty"])
def test_damaged_files_are_named(tmp_path: Path, name: str, damage: str) -> None:
    path = tmp_path / name
    (nrrd if "nrrd" in name else meta)(path, labels(), np.eye(4))
    content = path.read_bytes()
    wrong = {"half": content[: -len(content) // 4], "text": b"hello\n" * 9, "empty": b""}[damage]
    path.write_bytes(wrong)
    with pytest.raises(FileError, match=rf"{name}'"):
        read_volume(path)


def test_missing_spacing_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = meta(tmp_path / "v.mha", labels(), np.eye(4))
    path.write_bytes(path.read_bytes().replace(b"ElementSpacing = 1 1 1\n", b""))
    np.testing.assert_allclose(read_volume(path).voxel_mm, 1.0)
    assert "does not state the size of its voxels" in caplog.text
