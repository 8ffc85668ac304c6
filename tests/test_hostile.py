"""Files that state, or expand to, far more than they hold: every reader refuses them in one line.

Each is read in a process with limits of memory and time; see `hostile_readers`.
"""

import gzip
import json
import lzma
import os
import sqlite3
import struct
import subprocess
import sys
import zipfile
import zlib
from base64 import b64encode
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hostile_readers
import numpy as np
import pytest
from hostile_readers import LIMIT_GIB, MEMORY_MIB, SECONDS

from tactorch.mesh import box_mesh, write_mesh, write_surface
from tactorch.recording import MaterialSpec, Press, Recording

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs the limits of Linux")
ZEROS = bytes(1 << 20)
OVER = int(2 * LIMIT_GIB * 1024)  # MiB of zeros that exceed the budget
NESTED = "[" * 100_000
TETRAHEDRON = (
    "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n"
    "*ELEMENT, TYPE=C3D4, ELSET=ALL\n1, 1, 2, 3, 4\n"
)
Answer = tuple[str, str, float, float]
Ask = Callable[[str, Path], Answer]


@pytest.fixture(scope="session")
def ask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ask]:
    """Read a file in a process with limits."""
    settings = {"TACTORCH_FILE_GIB": str(LIMIT_GIB), "OMP_NUM_THREADS": "1"}
    log = (tmp_path_factory.mktemp("hostile") / "log.txt").open("w")
    server = subprocess.Popen(
        [sys.executable, hostile_readers.__file__], env={**os.environ, **settings}, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
    )  # fmt: skip

    def answer(reader: str, path: Path) -> Answer:
        assert server.stdin is not None
        assert server.stdout is not None
        print(json.dumps([reader, str(path)]), file=server.stdin, flush=True)
        outcome, message, seconds, mib = json.loads(server.stdout.readline())
        return outcome, message, seconds, mib

    with server, log:
        yield answer
        assert server.stdin is not None
        server.stdin.close()


# --- Text ---------------------------------------------------------------------------------------


def text(content: str, name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
        return path

    return make


def aliases(first: str = "a: &a", others: str = "{b}: &{b}") -> str:
    lines = [f"{first} [x, x, x, x, x, x, x, x, x]"]
    pairs = zip("abcdefgh", "bcdefghi", strict=True)
    lines += [f"{others.format(b=b)} [{', '.join([f'*{a}'] * 9)}]" for a, b in pairs]
    return "\n".join(lines) + "\n"


def references() -> str:
    pairs = zip("abcdefgh", "bcdefghi", strict=True)
    return "a: xxxxxxxxx\n" + "".join(f'{b}: "{f"${{{a}}}" * 9}"\n' for a, b in pairs)


def run(name: str, content: str) -> Callable[[Path], Path]:
    """A file of the settings of a run, beside sound ones."""

    def make(folder: Path) -> Path:
        hydra = "hydra: {job: {name: invert}, runtime: {cwd: .}}\n"
        sound = {"hydra.yaml": hydra, "overrides.yaml": "[]\n", "config.yaml": "recording: a.h5\n"}
        for file, lines in (sound | {name: content}).items():
            text(lines, f"run/.hydra/{file}")(folder)
        return folder / "run" / ".hydra" / name

    return make


# --- Containers -----------------------------------------------------------------------------------


def recording(points: Callable[[Any], None]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        import h5py

        with h5py.File(folder / "a.h5", "w", libver=("v110", "v110")) as file:
            file.attrs["format"] = np.array(b"tactorch-recording", "S18")
            file.attrs["version"] = 1
            file.attrs["units"] = np.array(b"mm, N, MPa, tonne/mm^3", "S22")
            points(file)
            zeros(file, "mesh/tets", 1, 4, "<i8")
        return folder / "a.h5"

    return make


def zeros(file: Any, name: str, mib: int, columns: int, kind: str) -> None:
    """Make a compressed dataset of zeros, all of which the file has."""
    item = np.dtype(kind).itemsize
    rows = len(ZEROS) // (columns * item)
    data = file.create_dataset(
        name, (mib * rows, columns), kind, chunks=(rows, columns), compression=9
    )
    chunk = zlib.compress(bytes(rows * columns * item), 9)
    for first in range(mib):
        data.id.write_direct_chunk((first * rows, 0), chunk)


def declared(file: Any) -> None:
    data = file.create_dataset("mesh/points", (10**9, 3), "<f8", chunks=(1000, 3), compression=4)
    data[:1000] = 0.0


def nested_json(file: Any) -> None:
    zeros(file, "mesh/points", 1, 3, "<f8")
    file["material"] = np.bytes_(NESTED)


def array_header(shape: str, kind: str = "|u1") -> bytes:
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode()


def npz(kind: int = zipfile.ZIP_DEFLATED, mib: int = OVER, lie: bool = False) -> Any:
    """An archive whose array has zeros; one that lies states that its member is small."""

    def make(folder: Path) -> Path:
        path = folder / "a.npz"
        with zipfile.ZipFile(path, "w", kind) as archive:
            with archive.open("labels.npy", "w") as member:
                member.write(array_header(f"({mib}, 1024, 1024)"))
                for _ in range(mib):
                    member.write(ZEROS)
            if lie:
                archive.infolist()[0].file_size = 1000
            archive.writestr("spacing_mm.npy", array_header("(3,)", "<f8") + bytes(24))
        if lie:  # in the local header too
            content = bytearray(path.read_bytes())
            content[22:26] = struct.pack("<I", 1000)
            path.write_bytes(content)
        return path

    return make


def claimed_array(folder: Path) -> Path:
    path = folder / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("labels.npy", array_header("(100000, 100000, 1000)"))
    return path


def claimed_npy(folder: Path) -> Path:
    (folder / "a.npy").write_bytes(array_header("(100000, 100000, 1000)"))
    return folder / "a.npy"


def checkpoint(change: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        import torch

        path, settings = folder / "a.ckpt", {"classes": ["a", "b"], "hidden": 2, "layers": 1}
        weights = torch.zeros(4)
        if change == "repeated":
            weights = torch.zeros(1).expand(10**12)
        elif change in ("hidden", "layers"):
            settings[change] = 10**7
        torch.save({"state_dict": {"w": weights}, "hyper_parameters": settings}, path)
        if change == "expands":
            _expand_storage(path)
        return path

    return make


def _expand_storage(path: Path) -> None:
    small = zipfile.ZipFile(path.rename(path.with_suffix(".old")))
    with small, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as big:
        for name in small.namelist():
            big.writestr(name, ZEROS * OVER if name.endswith("/data/0") else small.read(name))


# --- Volumes --------------------------------------------------------------------------------------


def nifti(side: int, *, voxels: bool = False, offset: float = 352.0, extension: int = 0) -> Any:
    def make(folder: Path) -> Path:
        header = bytearray(352)
        struct.pack_into("<i", header, 0, 348)
        struct.pack_into("<8h", header, 40, 3, side, side, side, 1, 1, 1, 1)
        struct.pack_into("<hh", header, 70, 2, 8)
        struct.pack_into("<8f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1)
        struct.pack_into("<f", header, 108, offset)
        struct.pack_into("<hh", header, 252, 0, 1)
        struct.pack_into("<12f", header, 280, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)
        header[344:348] = b"n+1\0"
        if extension:
            header[348:] = b"\1\0\0\0"
        path = folder / "a.nii.gz"
        with gzip.open(path, "wb", 1) as file:
            file.write(header)
            if extension:
                file.write(struct.pack("<ii", extension, 4))
            for _ in range(OVER if extension or voxels else 0):
                file.write(ZEROS)
        return path

    return make


def nrrd(suffix: str, encoding: str, mib: int = OVER, sizes: str = "8 8 8") -> Any:
    """Zeros after a header that states another size, or none that is true."""

    def make(folder: Path) -> Path:
        keys = {"nrrd": ("type: uchar\ndimension: 3\nsizes: {}\nspacings: 1 1 1\nencoding: {}\n\n"),
                "mha": ("NDims = 3\nDimSize = {}\nElementSpacing = 1 1 1\nElementType = MET_UCHAR\n"
                        "CompressedData = {}\nElementDataFile = LOCAL\n")}  # fmt: skip
        stated = {"gzip": "True", "raw": "False"}.get(encoding) if suffix == "mha" else encoding
        content = (b"NRRD0004\n" if suffix == "nrrd" else b"") + keys[suffix].format(
            sizes, stated
        ).encode()
        data = b" 1" * (mib << 19) if encoding == "text" else ZEROS * mib
        path = folder / f"a.{suffix}"
        path.write_bytes(content + (zlib.compress(data) if encoding == "gzip" else data))
        return path

    return make


def deflated_dicom(folder: Path) -> Path:
    pydicom = pytest.importorskip("pydicom")
    dataset = pydicom.Dataset()
    dataset.file_meta = pydicom.dataset.FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = pydicom.uid.DeflatedExplicitVRLittleEndian
    dataset.SOPClassUID, dataset.SOPInstanceUID = "1.2.840.10008.5.1.4.1.1.66.4", "1.2.3"
    dataset.add_new(0x00091010, "OB", ZEROS * OVER)
    dataset.save_as(folder / "a.dcm", enforce_file_format=True)
    return folder / "a.dcm"


# --- Pictures, tables, bags -----------------------------------------------------------------------


def png(folder: Path) -> Path:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 9000, 9000, 8, 2, 0, 0, 0))
    body = chunk(b"IDAT", zlib.compress(bytes(9000 * 27001))) + chunk(b"IEND", b"")
    (folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + body)
    return folder / "a.png"


def jpeg_scans(folder: Path) -> Path:
    """A picture that repeats its last scan: each takes the time of a picture."""
    import io

    from PIL import Image

    memory = io.BytesIO()
    Image.new("RGB", (2400, 2400)).save(memory, "JPEG", progressive=True)
    content = memory.getvalue()
    last = content.rindex(b"\xff\xda")
    (folder / "a.jpg").write_bytes(content[:-2] + content[last:-2] * 2000 + b"\xff\xd9")
    return folder / "a.jpg"


def parquet_rows(folder: Path) -> Path:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    column = pyarrow.DictionaryArray.from_arrays(
        pyarrow.array(np.zeros(4_000_000, np.int32)), pyarrow.array([1.5])
    )
    parquet.write_table(pyarrow.table({"x": column}), folder / "a.parquet")
    return folder / "a.parquet"


def parquet_text(folder: Path) -> Path:
    """A long text, stored once, in each of many rows."""
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    column = pyarrow.DictionaryArray.from_arrays(
        pyarrow.array(np.zeros(10_000, np.int32)), pyarrow.array(["x" * 100_000])
    )
    parquet.write_table(pyarrow.table({"x": column}), folder / "a.parquet")
    return folder / "a.parquet"


def mcap(kind: str) -> Callable[[Path], Path]:
    """A bag with a chunk of zeros that is compressed; it states a small size, or the true one."""

    def make(folder: Path) -> Path:
        pytest.importorskip("rosbags")
        from lz4.frame import compress
        from rosbags.rosbag2 import reader

        content = ZEROS * OVER
        name = kind.partition(" ")[0]
        packed = compress(content) if name == "lz4" else reader.zstd.compress(content)
        size = 1000 if "small" in kind else len(content)
        chunk = struct.pack("<QQQI", 0, 1, size, 0) + sized(name.encode())
        chunk += struct.pack("<Q", len(packed)) + packed
        records = record(1, sized(b"ros2") + sized(b"")) + record(6, chunk)
        magic = b"\x89MCAP0\r\n"
        (folder / "a.mcap").write_bytes(magic + records + record(2, bytes(20)) + magic)
        return folder / "a.mcap"

    return make


def sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def record(kind: int, data: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(data)) + data


def database(folder: Path) -> Path:
    """A bag whose messages are a view without end."""
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS"
    with sqlite3.connect(folder / "a.db3") as base:
        base.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        base.execute("INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/String', 'cdr')")
        base.execute(
            f"CREATE VIEW messages AS {endless} topic_id, i AS timestamp, i AS data FROM n"
        )
    base.close()
    return folder / "a.db3"


def long_message(folder: Path) -> Path:
    with sqlite3.connect(folder / "a.db3") as base:
        base.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        base.execute("INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/String', 'cdr')")
        base.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
        base.execute(f"INSERT INTO messages VALUES (1, 1, 1, zeroblob({OVER << 18}))")
    base.close()
    return folder / "a.db3"


# --- Meshes ---------------------------------------------------------------------------------------

PLY = (
    "ply\nformat {} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1000000000\n{}end_header\n"
)
GMSH = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n$EndNodes\n"
GENERATED = "*ELSET, ELSET=B, GENERATE\n1, 2000000000, 1\n"
SPARSE = "4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n2000000000 0 0 1"
LEGACY = (
    "# vtk DataFile Version 3.0\na\nASCII\nDATASET UNSTRUCTURED_GRID\n"
    "POINTS 10000000000 double\n0 0 0\n"
)
IMAGE = (
    "# vtk DataFile Version 3.0\na\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 90 90 90\n"
    "ORIGIN 0 0 0\nSPACING 1 1 1\n"
)
VTU = (
    '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">'
    '<UnstructuredGrid><Piece NumberOfPoints="10000000000" NumberOfCells="1"><Points><DataArray '
    'type="Float64" NumberOfComponents="3" format="ascii">0 0 0</DataArray></Points></Piece>'
    "</UnstructuredGrid></VTKFile>"
)


def repeated_array(folder: Path) -> Path:
    """A file whose arrays are all at one place of the raw data."""
    array = '<DataArray type="Float64" Name="{}" format="appended" offset="0"/>'
    (folder / "a.vtu").write_bytes(
        b'<VTKFile type="UnstructuredGrid" byte_order="LittleEndian"><UnstructuredGrid><Piece>'
        b"<PointData>%b</PointData></Piece></UnstructuredGrid>"
        b'<AppendedData encoding="raw">_%b%b</AppendedData></VTKFile>'
        % ("".join(map(array.format, range(300))).encode(), struct.pack("<I", 1 << 20), ZEROS)
    )
    return folder / "a.vtu"


def vtk(kind: str, name: str) -> Callable[[Path], Path]:
    """A file whose points are compressed zeros, in several parts or with a small size stated."""

    def make(folder: Path) -> Path:
        pack = lzma.compress if "lzma" in kind else zlib.compress
        parts = [pack(ZEROS * 8)] * (OVER // 8) if "parts" in kind else [pack(ZEROS * OVER)]
        size = 72 if "small" in kind else len(ZEROS) * OVER // len(parts)
        header = struct.pack(f"<{3 + len(parts)}Q", len(parts), size, size, *map(len, parts))
        points = (b64encode(header) + b64encode(b"".join(parts))).decode()
        grid, cells = ("PolyData", "Polys") if name.endswith("p") else ("UnstructuredGrid", "Cells")
        array = '<DataArray type="{}" Name="{}" NumberOfComponents="{}" format="{}">{}</DataArray>'
        rows = [("Int64", "connectivity", 1, "ascii", "0 1 2"), ("Int64", "offsets", 1, "ascii", 3),
                ("Int64", "types", 1, "ascii", 5)]  # fmt: skip
        compressor = "vtkLZMADataCompressor" if "lzma" in kind else "vtkZLibDataCompressor"
        (folder / name).write_text(
            f'<VTKFile type="{grid}" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
            f'compressor="{compressor}"><{grid}><Piece NumberOfPoints="10000000000"><Points>'
            f"{array.format('Float64', 'Points', 3, 'binary', points)}</Points><{cells}>"
            f"{''.join(array.format(*row) for row in rows)}</{cells}></Piece></{grid}></VTKFile>"
        )
        return folder / name

    return make


def stl(folder: Path) -> Path:
    (folder / "a.stl").write_bytes(bytes(80) + struct.pack("<I", 4_000_000_000) + bytes(50))
    return folder / "a.stl"


# --- The table ------------------------------------------------------------------------------------

#: Reader, attack, function that makes the file: one line each.
ATTACKS: list[tuple[str, str, Callable[[Path], Path]]] = [
    ("presets", "aliases", text(aliases(), "conf/optimizer/a.yaml")),
    ("presets", "nested", text(f"a: {NESTED}", "conf/optimizer/a.yaml")),
    ("presets", "nested blocks", text("- " * 50_000, "conf/optimizer/a.yaml")),
    ("presets", "long", text("a: 1\n" * 300_000, "conf/optimizer/a.yaml")),
    ("presets", "references", text(references(), "conf/optimizer/a.yaml")),
    ("presets", "long number", text(f"a: 0x{'f' * 200_000}\n", "conf/optimizer/a.yaml")),
    ("sensor", "aliases", text(aliases(), "sensor.yaml")),
    ("sensor", "nested", text(f"a: {NESTED}", "sensor.yaml")),
    ("sensor", "long number", text(f"mm_per_px: {'59:' * 100_000}59\n", "sensor.yaml")),
    ("run", "long number", run("config.yaml", f"a: 0x{'f' * 200_000}\n")),
    ("run", "aliases", run("config.yaml", aliases())),
    ("run", "nested", run("config.yaml", f"a: {NESTED}")),
    ("run", "references", run("config.yaml", references())),
    ("run", "aliases of words", run("overrides.yaml", aliases("- &a", "- &{b}"))),
    ("run", "nested word", run("overrides.yaml", f"- 'start_mpa={NESTED[:50000]}'")),
    ("run", "long word", run("overrides.yaml", f"- start_mpa=[{'1,' * 100_000}1]")),
    ("json", "nested", text('{"a": ' + NESTED, "a.json")),
    ("json", "nested and closed", text('{"a": ' + "[" * 900 + "]" * 900 + "}", "a.json")),
    ("json", "many tables", text('{"a": [' + "{}," * 2_000_000 + "{}]}", "a.json")),
    ("json", "long number", text('{"a": ' + "9" * 100_000 + "}", "a.json")),
    ("recording", "declared", recording(declared)),
    ("recording", "expands", recording(lambda f: zeros(f, "mesh/points", OVER, 3, "<f8"))),
    (
        "recording", "expands on conversion",
        recording(lambda f: zeros(f, "mesh/points", int(LIMIT_GIB * 800), 3, "<f4")),
    ),
    ("recording", "nested", recording(nested_json)),
    ("arrays", "expands", npz()),
    ("arrays", "expands (bzip2)", npz(zipfile.ZIP_BZIP2)),
    ("arrays", "expands (lzma)", npz(zipfile.ZIP_LZMA)),
    ("arrays", "states less (bzip2)", npz(zipfile.ZIP_BZIP2, 4 * OVER, lie=True)),
    ("arrays", "states less (lzma)", npz(zipfile.ZIP_LZMA, 4 * OVER, lie=True)),
    ("arrays", "declared", claimed_array),
    ("calibration", "expands", npz()),
    ("volume", "expands", npz()),
    ("volume", "labels beside bytes", npz(mib=OVER // 4)),
    ("volume", "declared", claimed_npy),
    ("volume", "declared (NIfTI)", nifti(1000)),
    ("volume", "expands (NIfTI)", nifti(600, voxels=True)),
    ("volume", "place of the voxels", nifti(10, voxels=True, offset=1e12)),
    ("volume", "extension", nifti(10, extension=2**31 - 8)),
    ("volume", "negative extension", nifti(10, extension=-(2**31))),
    ("volume", "expands (DICOM)", deflated_dicom),
    ("volume", "expands (nrrd)", nrrd("nrrd", "gzip", sizes="9000 9000 9000")),
    ("volume", "expands (mha)", nrrd("mha", "gzip", sizes="9000 9000 9000")),
    ("volume", "longer than stated (nrrd)", nrrd("nrrd", "raw", 5 * OVER)),
    ("volume", "long text (nrrd)", nrrd("nrrd", "text", OVER // 2)),
    ("recognizer", "expands", checkpoint("expands")),
    ("recognizer", "repeated number", checkpoint("repeated")),
    ("recognizer", "wide", checkpoint("hidden")),
    ("recognizer", "many layers", checkpoint("layers")),
    ("image", "expands", png),
    ("image", "many scans", jpeg_scans),
    ("table", "long", text("x,y\n" + "1,\n" * 2_000_000, "a.csv")),
    ("table", "many columns", text("," * 4_000_000, "a.csv")),
    ("table", "long cell", text("x,y\n" + f"{'1' * 100_000},1\n" + "1,1\n" * 20_000, "a.csv")),
    ("table", "empty lines", text("\n" * 20_000_000, "a.csv")),
    ("table", "rows", parquet_rows),
    ("table", "long text in each row", parquet_text),
    ("bag", "expands (zstd)", mcap("zstd")),
    ("bag", "expands (lz4)", mcap("lz4")),
    ("bag", "states less (zstd)", mcap("zstd small")),
    ("bag", "states less (lz4)", mcap("lz4 small")),
    ("bag", "aliases", text(aliases(), "bag/metadata.yaml")),
    ("bag", "endless view", database),
    ("mesh", "sparse tag", text(GMSH.format(SPARSE), "a.msh")),
    ("mesh", "nodes", text(GMSH.format("1000000000\n1 0 0 0"), "a.msh")),
    ("mesh", "generated set", text(TETRAHEDRON + GENERATED, "a.inp")),
    ("mesh", "includes a device", text(TETRAHEDRON + "*INCLUDE, INPUT=/dev/zero\n", "a.inp")),
    ("mesh", "includes itself", text(TETRAHEDRON + "*INCLUDE, INPUT=a.inp\n", "a.inp")),
    ("mesh", "declared (vtu)", text(VTU, "a.vtu")),
    ("mesh", "expands (vtu)", vtk("zlib", "a.vtu")),
    ("mesh", "expands in parts (vtu)", vtk("zlib parts", "a.vtu")),
    ("vtk", "expands (lzma)", vtk("lzma", "a.vtu")),
    ("vtk", "expands (vtp)", vtk("zlib", "a.vtp")),
    ("vtk", "states less (vtp)", vtk("zlib small", "a.vtp")),
    ("vtk", "one array many times", repeated_array),
    ("vtk", "declared (vtk)", text(LEGACY, "a.vtk")),
    ("vtk", "dimensions (vtk)", text(IMAGE, "a.vtk")),
    ("surface", "triangles", stl),
    ("surface", "faces", text(PLY.format("ascii", "") + "0 0 0\n1 0 0\n0 1 0\n", "a.ply")),
    (
        "surface", "faces (binary)",
        text(PLY.format("binary_little_endian", "property list uchar int vertex_indices\n")
             + "\0" * 36, "a.ply"),
    ),
]  # fmt: skip
#: Files that are read within the limits: one copy is kept of what repeats, and what is beyond the
#: stated size is not read.
SHARED = {("volume", "longer than stated (nrrd)")}


#: Files that take long to make; others of their kind are quick.
LONG = {
    ("arrays", "expands (bzip2)"),
    ("arrays", "expands (lzma)"),
    ("vtk", "expands (lzma)"),
    ("volume", "expands (DICOM)"),
    ("arrays", "states less (bzip2)"),
    ("arrays", "states less (lzma)"),
    ("volume", "longer than stated (nrrd)"),
}


@pytest.mark.parametrize(
    ("reader", "attack", "make"),
    [
        pytest.param(*a, marks=[pytest.mark.slow] * (a[:2] in LONG), id=f"{a[0]}: {a[1]}")
        for a in ATTACKS
    ],
)
def test_attacks(
    reader: str, attack: str, make: Callable[[Path], Path], ask: Ask, tmp_path: Path
) -> None:
    path = make(tmp_path)
    outcome, message, seconds, mib = ask(reader, path)
    assert mib < MEMORY_MIB
    assert seconds < SECONDS
    assert outcome == ("read" if (reader, attack) in SHARED else "refused"), message
    if (reader, attack) in SHARED:
        return
    assert "\n" not in message
    assert len(message) < 1000
    assert path.stem in message or "setting 'start_mpa" in message
    for refusal_of_the_system in ("llocate", "MemoryError"):
        assert refusal_of_the_system not in message, message
    assert "recursion" not in message, message


def test_long_messages_are_refused_before_they_are_read(ask: Ask, tmp_path: Path) -> None:
    outcome, message, *_ = ask("bag", long_message(tmp_path))
    assert outcome == "refused"
    assert "a message of" in message


# --- Damage at random -----------------------------------------------------------------------------


def valid_recording(folder: Path) -> Path:
    mesh = box_mesh((10.0, 10.0, 10.0), 1)
    ones = np.ones((8, 3))
    press = Press(ones, ones > 0, 0.1 * ones, springs=ones, name="top")
    Recording(mesh, (press,), MaterialSpec("neo_hookean", 0.3)).save(folder / "a.h5")
    return folder / "a.h5"


def valid_mesh(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        cube, path = box_mesh(10.0, 1), folder / f"a{suffix}"
        if suffix in (".msh", ".vtu", ".inp"):
            write_mesh(path, cube)
        else:
            write_surface(path, cube.points, cube.surface.triangles)
        return path

    return make


def valid_vtk(suffix: str) -> Callable[[Path], Path]:
    """A file with raw data, of which only the header is text."""

    def make(folder: Path) -> Path:
        pyvista = pytest.importorskip("pyvista")
        grid = pyvista.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid()
        grid = pyvista.Cube() if suffix == ".vtp" else grid
        grid["u"] = np.zeros((grid.n_points, 3))
        grid.save(folder / f"a{suffix}")
        return folder / f"a{suffix}"

    return make


def valid_labels(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        labels, path = np.ones((6, 5, 4), np.uint8), folder / f"a{suffix}"
        if suffix == ".npz":
            np.savez_compressed(path, labels=labels, spacing_mm=np.ones(3))
        else:
            nib = pytest.importorskip("nibabel")
            nib.save(nib.Nifti1Image(labels, np.eye(4)), path)
        return path

    return make


def valid_volume(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = nrrd(suffix, "gzip", 0)(folder)
        header = path.read_bytes()[: -len(zlib.compress(b""))]
        labels = np.pad(np.ones((6, 6, 6), np.uint8), 1)
        path.write_bytes(header + zlib.compress(labels.tobytes()))
        return path

    return make


def valid_picture(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        from PIL import Image

        pixels = np.random.default_rng(0).integers(0, 255, (32, 48, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"a{suffix}")
        return folder / f"a{suffix}"

    return make


def valid_video(folder: Path) -> Path:
    import cv2

    writer = cv2.VideoWriter(str(folder / "a.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))  # type: ignore[attr-defined]
    for _ in range(3):
        writer.write(np.full((48, 64, 3), 90, np.uint8))
    writer.release()
    return folder / "a.avi"


def valid_bag(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        pytest.importorskip("rosbags")
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        store, kind = get_typestore(Stores.ROS2_HUMBLE), "std_msgs/msg/String"
        plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
        with Writer(folder / "bag", version=9, storage_plugin=plugin) as writer:
            topic = writer.add_connection("/a", kind, typestore=store)
            for i in range(4):
                message = store.types[kind](data="hello")
                writer.write(topic, 10**9 * (i + 1), store.serialize_cdr(message, kind))
        return next((folder / "bag").glob(f"*{suffix}"))

    return make


def valid_arrays(folder: Path) -> Path:
    np.savez_compressed(folder / "a.npz", x=np.arange(50.0), name=np.array("x"))
    return folder / "a.npz"


#: Reader, function that makes a valid file (of which one file is damaged): one line each.
VALID: list[tuple[str, Callable[[Path], Path]]] = [
    ("presets", text("# A preset\nname: lbfgs\ntolerance: 1.0e-3\n", "conf/optimizer/a.yaml")),
    ("run", run("config.yaml", "recording: a.h5\nbounds: {low: 0.1}\n")),
    ("run", run("overrides.yaml", "- recording=a.h5\n- bounds.low_mpa=0.1\n")),
    ("json", text('{"a": [1, 2.5, {"b": null}], "c": "x"}', "a.json")),
    ("arrays", valid_arrays),
    ("recording", valid_recording),
    ("recognizer", checkpoint("")),
    ("volume", valid_labels(".npz")),
    ("volume", valid_labels(".nii")),
    ("volume", valid_labels(".nii.gz")),
    ("volume", valid_volume("nrrd")),
    ("volume", valid_volume("mha")),
    *(("image", valid_picture(suffix)) for suffix in (".png", ".jpg", ".bmp", ".tif")),
    ("video", valid_video),
    ("bag", valid_bag(".mcap")),
    ("bag", valid_bag(".db3")),
    ("table", text("x,y\n1,2\n3,4.5\n", "a.csv")),
    *(("mesh", valid_mesh(suffix)) for suffix in (".msh", ".vtu", ".inp")),
    *(("surface", valid_mesh(suffix)) for suffix in (".stl", ".obj", ".ply")),
    *(("vtk", valid_vtk(suffix)) for suffix in (".vtu", ".vtk", ".vtp")),
]
QUICK, FULL = 3, 100


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Flip bits, set bytes, cut the end, repeat a part, or make a number enormous."""
    place, way = int(rng.integers(len(content))), int(rng.integers(6))
    changed = bytearray(content)
    if way == 0:
        changed[place] ^= 1 << int(rng.integers(8))
    elif way == 1:
        changed[place : place + 4] = rng.bytes(4)
    elif way == 2:
        del changed[place:]
    elif way == 3:
        changed[place:place] = changed[place : place + int(rng.integers(1, 40))] * 50
    elif way == 4:  # a binary number, in the header more often than not
        place = int(len(content) * rng.random() ** 4)
        size = int(rng.choice([2, 4, 8]))
        changed[place : place + size] = b"\xff" * (size - 1) + b"\x7f"
    else:  # a number of text
        digits = [i for i, c in enumerate(content[:2000]) if 48 <= c <= 57] or [0]
        place = int(rng.choice(digits))
        changed[place : place + 1] = b"9" * int(rng.integers(3, 20))
    return bytes(changed)


@pytest.mark.parametrize("amount", [QUICK, pytest.param(FULL, marks=pytest.mark.slow)])
def test_damage(amount: int, ask: Ask, tmp_path: Path, record_property: Any) -> None:
    """Damaged files of all kinds: one line, or a result; nothing else, in bounded time and memory.

    All in one test, as the number of files, the longest time and the most memory are its result.
    """
    worst_s = worst_mib = 0.0
    outcomes = {"read": 0, "refused": 0}
    for number, (reader, make) in enumerate(VALID):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = make(folder)
        content, rng = path.read_bytes(), np.random.default_rng(number)
        for attempt in range(amount):
            path.write_bytes(damaged(content, rng))
            outcome, message, seconds, mib = ask(reader, path)
            place = f"{reader} {path.name}, attempt {attempt}: {message}"
            assert outcome in outcomes, place
            assert "\n" not in message, place
            assert mib < MEMORY_MIB, place
            outcomes[outcome] += 1
            worst_s, worst_mib = max(worst_s, seconds), max(worst_mib, mib)
    assert outcomes["refused"] > outcomes["read"] // 4
    summary = f"{sum(outcomes.values())} files, {outcomes}, {worst_s:.1f} s, {worst_mib:.0f} MiB"
    record_property("damage", summary)
    print(summary)
