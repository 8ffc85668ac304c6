"""Labels and places of voxels, from NIfTI, DICOM segmentations and arrays."""

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError, TactorchError
from tactorch.volumes import BodySettings, LabelVolume, read_body, read_volume

from .conftest import block

nib = pytest.importorskip("nibabel")


def oblique() -> np.ndarray:
    """Voxels of 1 x 1.5 x 2 mm, left-handed and turned."""
    affine = np.eye(4)
    turn = Rotation.from_euler("xyz", [20.0, 35.0, -15.0], degrees=True).as_matrix()
    affine[:3, :3] = turn @ np.diag([-1.0, 1.5, 2.0])
    affine[:3, 3] = 12.0, -40.0, 7.0
    return affine


def nifti(
    path: Path, labels: np.ndarray, affine: np.ndarray | None = None, unit: str = "mm"
) -> Path:
    image = nib.Nifti1Image(labels, np.eye(4) if affine is None else affine)
    image.header.set_xyzt_units(unit)
    image.to_filename(path)
    return path


@pytest.mark.parametrize("name", ["v.nii", "v.nii.gz"])
def test_nifti_has_its_own_orientation(tmp_path: Path, name: str) -> None:
    volume = read_volume(nifti(tmp_path / name, block(), oblique()))
    np.testing.assert_array_equal(volume.labels, block())
    np.testing.assert_allclose(volume.affine, oblique(), atol=1e-4)
    np.testing.assert_allclose(volume.voxel_mm, [1.0, 1.5, 2.0], rtol=1e-5)
    assert volume.voxel_mm3 == pytest.approx(3.0)
    corner = volume.positions(np.array([[3.0, 4.0, 5.0]]))
    np.testing.assert_allclose(corner[0], (oblique() @ [3.0, 4.0, 5.0, 1.0])[:3], atol=1e-4)
    assert volume.indices(corner).tolist() == [[3, 4, 5]]


@pytest.mark.parametrize(
    ("unit", "given", "factor"),
    [("meter", None, 1e3), ("micron", None, 1e-3), ("unknown", None, 1.0), ("mm", "cm", 10.0)],
)
def test_lengths_are_converted(tmp_path: Path, unit: str, given: str | None, factor: float) -> None:
    volume = read_volume(nifti(tmp_path / "v.nii", block(), oblique(), unit), unit=given)
    np.testing.assert_allclose(volume.affine[:3], factor * oblique()[:3], rtol=1e-4, atol=1e-3)


def test_scaled_and_floating_labels_are_whole_numbers(tmp_path: Path) -> None:
    floats = read_volume(nifti(tmp_path / "f.nii", block().astype(np.float32)))
    np.testing.assert_array_equal(floats.labels, block())
    image = nib.Nifti1Image(block(), np.eye(4))
    image.header.set_slope_inter(2.0, 0.0)
    image.to_filename(tmp_path / "s.nii")
    stored = np.asarray(nib.load(tmp_path / "s.nii").dataobj)
    np.testing.assert_array_equal(read_volume(tmp_path / "s.nii").labels, np.round(stored))


def test_a_trailing_axis_of_one_is_no_fourth_dimension(tmp_path: Path) -> None:
    volume = read_volume(nifti(tmp_path / "v.nii", block()[..., None]))
    assert volume.labels.shape == block().shape


def test_a_file_without_orientation_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    image = nib.Nifti1Image(block(), None)
    image.header.set_zooms((1.0, 2.0, 3.0))
    image.to_filename(tmp_path / "v.nii")
    with caplog.at_level(logging.WARNING):
        volume = read_volume(tmp_path / "v.nii")
    assert "neither sform nor qform" in caplog.text
    np.testing.assert_allclose(volume.voxel_mm, [1.0, 2.0, 3.0])


def test_two_orientations_of_a_file_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    image = nib.Nifti1Image(block(), oblique())
    image.set_qform(np.diag([1.0, 1.5, 2.0, 1.0]), code=1)
    image.set_sform(oblique(), code=1)
    image.to_filename(tmp_path / "v.nii")
    with caplog.at_level(logging.WARNING):
        volume = read_volume(tmp_path / "v.nii")
    assert "sform and qform differ by up to" in caplog.text
    np.testing.assert_allclose(volume.affine, oblique(), atol=1e-4)
    caplog.clear()
    image.set_qform(oblique(), code=1)
    image.to_filename(tmp_path / "w.nii")
    with caplog.at_level(logging.WARNING):
        read_volume(tmp_path / "w.nii")
    assert not caplog.text


def test_arrays_state_their_place_or_get_a_spacing(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", labels=block(), affine=oblique())
    np.testing.assert_allclose(read_volume(tmp_path / "a.npz").affine, oblique())
    np.savez(
        tmp_path / "b.npz", labels=block(), spacing_mm=[1.0, 2.0, 3.0], origin_mm=[4.0, 5.0, 6.0]
    )
    placed = read_volume(tmp_path / "b.npz").affine
    np.testing.assert_allclose(placed[:3], [[1, 0, 0, 4], [0, 2, 0, 5], [0, 0, 3, 6]])
    np.save(tmp_path / "c.npy", block())
    given = read_volume(tmp_path / "c.npy", spacing_mm=(1.0, 2.0, 3.0))
    np.testing.assert_allclose(given.affine, np.diag([1.0, 2.0, 3.0, 1.0]))


@settings(max_examples=30)
@given(
    angles=st.tuples(*[st.floats(-180.0, 180.0)] * 3),
    sizes=st.tuples(*[st.floats(0.1, 5.0)] * 3),
    flip=st.booleans(),
)
def test_positions_and_indices_are_inverse(
    angles: tuple[float, ...], sizes: tuple[float, ...], flip: bool
) -> None:
    affine = np.eye(4)
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    affine[:3, :3] = turn @ np.diag(sizes) @ np.diag([-1.0 if flip else 1.0, 1.0, 1.0])
    affine[:3, 3] = 3.0, -2.0, 50.0
    volume = LabelVolume(block().astype(np.int32), affine)
    indices = np.argwhere(block() == 2)
    assert (volume.indices(volume.positions(indices.astype(float))) == indices).all()


def segmentation(
    path: Path, labels: np.ndarray, kind: str = "BINARY", overlap: bool = False
) -> Path:
    """Write a DICOM segmentation of CT slices of 0.5 x 0.8 mm, 2 mm apart."""
    hd = pytest.importorskip("highdicom")
    import pydicom
    from pydicom.sr.codedict import codes
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

    study, series, frame = generate_uid(), generate_uid(), generate_uid()
    images = []
    for k in range(labels.shape[2]):
        image = pydicom.Dataset()
        image.file_meta = pydicom.dataset.FileMetaDataset()
        image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        image.SOPClassUID, image.SOPInstanceUID = CTImageStorage, generate_uid()
        image.StudyInstanceUID, image.SeriesInstanceUID = study, series
        image.FrameOfReferenceUID, image.Modality = frame, "CT"
        image.PatientName = image.PatientID = image.PatientSex = image.PatientBirthDate = ""
        image.StudyID = image.AccessionNumber = image.ReferringPhysicianName = ""
        image.StudyDate = image.StudyTime = image.PositionReferenceIndicator = ""
        image.Rows, image.Columns = labels.shape[1], labels.shape[0]
        image.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        image.ImagePositionPatient = [-10.0, 20.0, 5.0 + 2.0 * k]
        image.PixelSpacing, image.SliceThickness = [0.8, 0.5], 2.0
        image.InstanceNumber = k + 1
        image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
        image.BitsAllocated, image.BitsStored, image.HighBit = 16, 16, 15
        image.PixelRepresentation = 0
        image.PixelData = np.zeros(labels.shape[1::-1], dtype=np.uint16).tobytes()
        images.append(image)
    numbers = [n for n in np.unique(labels).tolist() if n]
    described = [
        hd.seg.SegmentDescription(
            number, f"part {number}", codes.SCT.Tissue, codes.SCT.Tissue,
            hd.seg.SegmentAlgorithmTypeValues.MANUAL,
        )
        for number in numbers
    ]  # fmt: skip
    pixels = np.ascontiguousarray(labels.transpose(2, 1, 0)).astype(np.uint8)
    if overlap:
        pixels = np.stack([pixels >= number for number in numbers], axis=-1).astype(np.uint8)
    dataset = hd.seg.Segmentation(
        images, pixels,
        hd.seg.SegmentationTypeValues[kind], described, generate_uid(), 1, generate_uid(), 1,
        "maker", "model", "1", "serial",
    )  # fmt: skip
    dataset.save_as(path)
    return path


@pytest.mark.parametrize("kind", ["BINARY", "LABELMAP"])
def test_dicom_segmentations_have_places_and_names(tmp_path: Path, kind: str) -> None:
    volume = read_volume(segmentation(tmp_path / "seg.dcm", block(), kind))
    assert volume.names == {1: "part 1", 2: "part 2"}
    assert sorted(volume.voxel_mm) == pytest.approx([0.5, 0.8, 2.0])
    ball = volume.positions(np.argwhere(volume.labels == 2).astype(float))
    expected = np.argwhere(block() == 2) * [0.5, 0.8, 2.0] + [-10.0, 20.0, 5.0]
    np.testing.assert_allclose(np.sort(ball, axis=0), np.sort(expected, axis=0), atol=1e-6)
    centre = ball.mean(axis=0)
    np.testing.assert_allclose(centre, expected.mean(axis=0))


def test_segments_that_overlap_are_refused(tmp_path: Path) -> None:
    path = segmentation(tmp_path / "seg.dcm", block(), overlap=True)
    with pytest.raises(TactorchError, match=r"seg\.dcm.*Export segments that do not overlap"):
        read_volume(path)


def test_dicom_images_are_no_segmentations(tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    path = segmentation(tmp_path / "seg.dcm", block())
    dataset = pydicom.dcmread(path)
    dataset.SOPClassUID, dataset.Modality = pydicom.uid.CTImageStorage, "CT"
    dataset.save_as(tmp_path / "ct.dcm")
    with pytest.raises(TactorchError, match="modality CT, not a segmentation"):
        read_volume(tmp_path / "ct.dcm")
    path.write_bytes(path.read_bytes()[:400])
    with pytest.raises(TactorchError, match=r"seg\.dcm"):
        read_volume(path)


def _spoilt(change: str) -> np.ndarray:
    labels = block()
    if change == "pieces":
        labels[:, :, 4] = 0
    if change == "edge":
        labels[:, :, -1] = labels[:, :, -2]
    return labels


def _broken_affine(value: float) -> np.ndarray:
    affine = np.eye(4)
    affine[2, 2] = value
    return affine


def _header(path: Path, sform: float | None = None, pixdim: float | None = None) -> Path:
    """Write NIfTI, and overwrite a row of the sform, or a voxel size without an sform."""
    nifti(path, block())
    content = bytearray(path.read_bytes())
    if sform is not None:
        content[280 : 280 + 16] = np.full(4, sform, dtype="<f4").tobytes()
    if pixdim is not None:
        content[254:256] = np.int16(0).tobytes()  # sform_code
        content[252:254] = np.int16(1).tobytes()  # qform_code
        content[80:84] = np.float32(pixdim).tobytes()
    path.write_bytes(content)
    return path


BAD = {
    "sform of NaN": (lambda p: _header(p / "v.nii", sform=np.nan), {}, "no finite numbers"),
    "sform of 0": (lambda p: _header(p / "v.nii", sform=0.0), {}, "have no volume"),
    "pixdim of 0": (lambda p: _header(p / "v.nii", pixdim=0.0), {}, "have no volume"),
    "pixdim of NaN": (lambda p: _header(p / "v.nii", pixdim=np.nan), {}, "have no volume"),
    "missing": (lambda p: p / "none.nii", {}, "not found"),
    "no suffix": (lambda p: _text(p / "labels.txt"), {}, "no volume of labels"),
    "not NIfTI": (lambda p: _text(p / "v.nii"), {}, "cannot be read as NIfTI"),
    "not gzip": (lambda p: _text(p / "v.nii.gz"), {}, "cannot be read as NIfTI"),
    "cut short": (lambda p: _cut(nifti(p / "v.nii", block())), {}, "is incomplete"),
    "4-D": (lambda p: nifti(p / "v.nii", np.stack([block()] * 2, -1)), {}, "three axes"),
    "2-D": (lambda p: nifti(p / "v.nii", block()[..., 0]), {}, "three axes"),
    "probabilities": (lambda p: nifti(p / "v.nii", block() * 0.3), {}, "not whole numbers"),
    "NaN": (lambda p: nifti(p / "v.nii", block() * np.float32("nan")), {}, "not whole numbers"),
    "label absent": (
        lambda p: nifti(p / "v.nii", block()), {"labels": (1, 7)}, "no label 7; its labels are 1, 2"
    ),
    "no label": (lambda p: nifti(p / "v.nii", block()), {"labels": ()}, "needs one label or more"),
    "empty": (lambda p: nifti(p / "v.nii", 0 * block()), {}, "is empty"),
    "pieces": (
        lambda p: nifti(p / "v.nii", _spoilt("pieces")), {},
        r"2 pieces that share no face: 576 voxels \(576 mm\^3\), 432 voxels .*keep_largest=true",
    ),
    "edge": (
        lambda p: nifti(p / "v.nii", _spoilt("edge")), {"close_at_edge": False},
        "touches the edge of the volume .*end of axis 2",
    ),
    "affine of NaN": (
        lambda p: _npz(p, affine=_broken_affine(np.nan)), {}, "no finite numbers"
    ),
    "flat voxels": (lambda p: _npz(p, affine=_broken_affine(0.0)), {}, "have no volume"),
    "zero spacing": (lambda p: _npz(p, spacing_mm=[1.0, 0.0, 1.0]), {}, "give positive edge"),
    "negative spacing": (lambda p: _npz(p, spacing_mm=[-1.0, 1.0, 1.0]), {}, "give positive edge"),
    "transposed affine": (lambda p: _npz(p, affine=_transposed()), {}, "last row of the affine"),
    "metres as mm": (
        lambda p: nifti(p / "v.nii", block(), np.diag([1e-3, 1e-3, 1e-3, 1.0])), {},
        r"0.0188 mm across when read in mm.*in m\?",
    ),
    "micrometres as mm": (
        lambda p: nifti(p / "v.nii", block(), np.diag([1e3, 1e3, 1e3, 1.0])), {}, "in um",
    ),
    "mm as metres": (
        lambda p: nifti(p / "v.nii", block(), unit="meter"), {}, r"in m, .*Is it in mm or cm\?"
    ),
    "no spacing": (lambda p: _npy(p), {}, "give spacing_mm"),
    "spacing twice": (
        lambda p: nifti(p / "v.nii", block()), {"spacing_mm": (1.0, 1.0, 1.0)}, "leave it out"
    ),
    "no labels": (lambda p: _npz(p, name="mask"), {}, "no array 'labels'; it has mask"),
    "wrong affine": (lambda p: _npz(p, affine=np.eye(3)), {}, "of shape"),
    "pickled": (lambda p: _pickled(p), {}, "cannot be read"),
    "text": (lambda p: _npz(p, labels=np.array([[["a"]]])), {}, "labels are whole numbers"),
    "large numbers": (
        lambda p: _npz(p, labels=np.full((2, 2, 2), 2**40), spacing_mm=[1, 1, 1]), {}, "above"
    ),
}  # fmt: skip


def _text(path: Path) -> Path:
    path.write_text("labels of a liver, 1 and 2\n" * 40)
    return path


def _cut(path: Path) -> Path:
    path.write_bytes(path.read_bytes()[:1000])
    return path


def _transposed() -> np.ndarray:
    affine = np.eye(4)
    affine[:3, 3] = 5.0, 6.0, 7.0
    return affine.T


def _npz(folder: Path, name: str = "labels", **arrays: object) -> Path:
    path = folder / "v.npz"
    np.savez(path, **{name: block(), **arrays})
    return path


def _npy(folder: Path) -> Path:
    np.save(folder / "v.npy", block())
    return folder / "v.npy"


def _pickled(folder: Path) -> Path:
    np.save(folder / "v.npy", np.array([{}], dtype=object), allow_pickle=True)
    return folder / "v.npy"


@pytest.mark.parametrize("fault", BAD)
def test_wrong_files_are_refused(tmp_path: Path, fault: str) -> None:
    make, changes, message = BAD[fault]
    path = make(tmp_path)
    with pytest.raises(TactorchError, match=message) as error:
        read_body(path, BodySettings(**changes))
    assert path.name in str(error.value)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.util

    path = nifti(tmp_path / "v.nii", block())
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"tactorch\[volumes\]"):
        read_volume(path)
