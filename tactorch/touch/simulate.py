"""Random presses of a sensor on a body, as a recording and as what the sensor measures."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.interpolate import CloughTocher2DInterpolator

from tactorch.config import to_mapping
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import element_means
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.sensor.render import (
    GelSurface,
    RenderOptions,
    marker_positions,
    pixel_positions,
    render,
)
from tactorch.touch.options import TouchOptions
from tactorch.touch.pairing import ELEMENT
from tactorch.touch.places import draw_motion, draw_place
from tactorch.touch.record import record_press
from tactorch.touch.scene import GelPress, TouchScene
from tactorch.versions import versions

_ROUNDING_MM = 1e-4  # of stored heights


@dataclass(frozen=True, eq=False)
class Touch:
    """What a sensor measures in the k presses of a recording; arrays are of single precision.

    Positions in images are (column, row) in pixels, with integers at the centres of pixels; those
    of the gel are in the sensor frame, whose z axis points to the body.

    Attributes:
        images: Images (rows, columns, colours).
        reference: Image of the gel without contact.
        height_mm: z of the gel's face at each pixel, relative to rest; None where not stored.
        markers_px: Centre of each marker.
        rest_markers_px: The same without contact.
        marker_visible: Whether it is in the image.
        gel_points: Nodes of the gel's face at rest, mm.
        gel_displacement: Their displacement, mm.
        gel_forces: Forces of the body on them, N: loads of quadratic elements, of which midside
            nodes have most.
        poses: T_object_sensor, mm.
        first_poses: T_object_sensor at first touch, mm.
        place: Number of the place that is pressed.
        mm_per_px: Size of a pixel along x and y.
    """

    images: UInt8[np.ndarray, "k h w 3"]
    reference: UInt8[np.ndarray, "h w 3"]
    height_mm: Float[np.ndarray, "k h w"] | None
    markers_px: Float[np.ndarray, "k p 2"]
    rest_markers_px: Float[np.ndarray, "p 2"]
    marker_visible: Bool[np.ndarray, "k p"]
    gel_points: Float[np.ndarray, "g 3"]
    gel_displacement: Float[np.ndarray, "k g 3"]
    gel_forces: Float[np.ndarray, "k g 3"]
    poses: Float[np.ndarray, "k 4 4"]
    first_poses: Float[np.ndarray, "k 4 4"]
    place: Int[np.ndarray, " k"]
    mm_per_px: Float[np.ndarray, "2"]

    @property
    def total_force(self) -> Float[np.ndarray, "k 3"]:
        """Force of the body on the gel in each press, N, in the sensor frame."""
        return self.gel_forces.sum(axis=1, dtype=np.float64)


def simulate_touch(
    phantom: Phantom,
    mesh: TetMesh,
    fine_mesh: TetMesh | None,
    *,
    material: MaterialSpec,
    options: TouchOptions,
    rng: np.random.Generator,
    samples: int = 4,
    snr_db: float | None = None,
) -> tuple[Recording, Touch]:
    """Press a sensor on random places of a body.

    Args:
        phantom: The body.
        mesh: Mesh of the recording.
        fine_mesh: Mesh that presses are solved on; None for the same, with quadratic elements.
        material: Constitutive law of the body without Young's modulus.
        options: The sensor and the distribution of its presses.
        rng: Generator of all random numbers.
        samples: Samples along an edge that average the modulus of the recording over elements.
        snr_db: Signal-to-noise ratio of the displacements in the recording; None for no noise.

    Raises:
        ConfigError: The body cannot be pressed, or is of another law than the gel.
        ConvergenceError: A press has no equilibrium.
    """
    sensor = options.description()
    scene = TouchScene(phantom, fine_mesh or mesh, material, sensor, options)
    found: list[GelPress] = []
    for _ in range(int(rng.integers(options.presses[0], options.presses[1] + 1))):
        pose, facing = draw_place(scene, rng)
        motion = draw_motion(options, rng)
        steps = [motion * (step + 1) / options.steps for step in range(options.steps)]
        found += scene.press(pose, steps, facing)
    presses = [
        record_press(scene, mesh, press, snr_db, rng, number % options.steps)
        for number, press in enumerate(found)
    ]
    provenance = {
        "simulator": "tactorch.touch",
        "phantom": phantom.to_config(),
        "touch": to_mapping(options),
        "element": ELEMENT,
        "samples": samples,
        "snr_db": snr_db,
        "same_mesh": fine_mesh is None,
        "versions": versions(),
    }
    truth = element_means(mesh, phantom.youngs_at, samples)
    recording = Recording(mesh, tuple(presses), material, truth=truth, provenance=provenance)
    return recording, _touch(sensor, found, options, rng)


def _touch(
    sensor: SensorDescription,
    presses: list[GelPress],
    options: TouchOptions,
    rng: np.random.Generator,
) -> Touch:
    points = presses[0].gel_points
    moved = np.stack([np.zeros_like(points), *(press.gel_displacement for press in presses)])
    seeds = rng.integers(2**31, size=len(moved)).tolist()
    pictures = [
        draw_gel(sensor, points, one, options.render, seed)
        for one, seed in zip(moved, seeds, strict=True)
    ]
    images, heights, markers, visible = map(np.stack, zip(*pictures, strict=True))
    rounded = np.round(heights[1:] / _ROUNDING_MM) * _ROUNDING_MM
    forces, poses, first_poses = (
        _single(np.stack([getattr(press, name) for press in presses]))
        for name in ("gel_forces", "pose", "first_pose")
    )
    return Touch(
        images[1:],
        images[0],
        _single(rounded) if options.heights else None,
        _single(markers[1:]),
        _single(markers[0]),
        visible[1:],
        _single(points),
        _single(moved[1:]),
        forces,
        poses,
        first_poses,
        np.arange(len(presses)) // options.steps,
        _single(np.array(sensor.mm_per_px)),
    )


def draw_gel(
    sensor: SensorDescription,
    points: Float[np.ndarray, "g 3"],
    displacement: Float[np.ndarray, "g 3"],
    options: RenderOptions,
    seed: int,
) -> tuple[Image, Float[np.ndarray, "h w"], Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Draw a gel.

    The face is a smooth surface through its nodes (Clough and Tocher, 1965), so that its slopes,
    which the image shows, are continuous. `points` are nodes of the gel's face at rest, mm; the
    seed is that of the noise of the camera.

    Returns:
        The image; z of the face at each pixel, relative to rest, mm; the centres of the markers
        (column, row); and which of these are in the image.
    """
    at = points[:, :2] + displacement[:, :2]
    # Elements have straight sides: on a curved face nodes are not on the face itself.
    risen = displacement[:, 2] + sensor.gel.height_mm(points[:, :2]) - sensor.gel.height_mm(at)
    found = CloughTocher2DInterpolator(at, risen)(pixel_positions(sensor))
    rise = np.where(np.isfinite(found), found, 0.0).reshape(sensor.shape)
    positions = marker_positions(sensor, points, displacement, CloughTocher2DInterpolator)
    markers = sensor.to_px(positions)
    image = render(sensor, GelSurface(rise, markers), options, seed)
    low, high = np.array([-0.5, -0.5]), np.array(sensor.image_size_px) - 0.5
    visible = np.asarray(((markers >= low) & (markers <= high)).all(axis=1))
    return image, rise, markers, visible


def _single(values: np.ndarray) -> Float[np.ndarray, "..."]:
    return np.asarray(values, dtype=np.float32)
