"""The part of a data card about a tactile sensor."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tactorch.touch import Touch


def touch_contents(touch: dict[str, Any]) -> list[str]:
    """Return lines about what a sample has besides its recording, of the settings of touch."""
    sensor = touch["description"]
    width, height = sensor["image_size_px"]
    gel = sensor["gel"]
    return [
        "",
        f"For each press of the sensor `{sensor['name']}`: its image of {width} x {height} px with"
        f" noise of {touch['render']['noise']:g} gray values, the positions of its markers in px,"
        " and which are in the image,"
        + (" the height of the gel's face at each pixel in mm," if touch["heights"] else "")
        + " displacement (mm) and force (N) of the nodes of the gel's face, and the pose of the"
        " sensor; for each sample the image without contact.",
        "",
        f"The gel has {gel['youngs_mpa']:g} MPa, a Poisson's ratio of {gel['poisson']:g} and a"
        f" thickness of {gel['thickness_mm']:g} mm.",
    ]


def touch_method(touch: dict[str, Any], same_mesh: bool) -> list[str]:
    """Return lines about how presses are simulated, of the settings of touch."""
    slip = {
        "stick": "Points in contact do not slip from rest on, without a limit of friction.",
        "none": "Points in contact slip freely.",
    }
    meshes = (
        "the mesh that they are recorded on, but with quadratic elements and the modulus at"
        " quadrature points, where an inversion has one modulus for each linear element: less than"
        " an inverse crime, but results on these data may flatter"
        if same_mesh
        else "another mesh than the one they are recorded on, with quadratic elements and the"
        " modulus at quadrature points: no inverse crime"
    )
    return [
        "Gel and body are one static problem of finite elements with large strains: forces on them"
        " are opposite and equal, and image, markers and forces belong to one equilibrium. They"
        f" touch along the axis of the sensor. {slip[touch['friction']]} Points of gel and body are"
        " paired where they are opposite at rest. There is no adhesion, no floor and no hysteresis,"
        " and the camera sees the face through Lambertian shading with shadows, without lens"
        f" errors. The body is held at its side {touch['held_side']}. Details smaller than the"
        f" gel's elements ({touch['gel_edge_mm']:g} mm on average) are smoothed.",
        "",
        f"Presses are computed on {meshes}. Images have noise; positions of markers, heights and"
        " forces are exact.",
    ]


def touch_rows(touches: Sequence[Touch]) -> dict[str, list[float]]:
    """Return the quantities of the card's table, one value for each press."""
    indentation = [
        float(-one.gel_displacement[k, :, 2].min())
        for one in touches
        for k in range(len(one.images))
    ]
    moved = [
        float(np.linalg.norm(one.markers_px[k] - one.rest_markers_px, axis=1).max())
        for one in touches
        for k in range(len(one.images))
        if len(one.rest_markers_px)
    ]
    rows = {
        "force along the axis, N": [float(f) for one in touches for f in -one.total_force[:, 2]],
        "indentation of the gel, mm": indentation,
        "largest motion of a marker, px": moved,
    }
    return {name: values for name, values in rows.items() if values}
