"""From an image of a tactile sensor to the force on it.

A simulated sensor stands in for a real one. Its colours are calibrated with presses of a ball; then
a finite-element gel, finer than the one that the sensor chain knows, is pressed by the ball, the
image that a camera would take is drawn, and the chain tells the force from that image alone.
"""

import numpy as np

from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Calibration,
    Circle,
    FitOptions,
    fit_map,
    image_change,
    marker_pixels,
)
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription
from tactorch.sensor.frames import Frame
from tactorch.sensor.gel import GelContact, GelModel, GelOptions
from tactorch.sensor.markers import MarkerAppearance
from tactorch.sensor.render import GelSurface, build_surface, render

PIXEL_MM, BALL_MM = 0.08, 2.5
GEL = GelLayer(3.0, 0.15, 0.45, size_mm=(12.0, 9.6))  # mm, MPa
SENSOR = SensorDescription(
    "drawn", (150, 120), (PIXEL_MM, PIXEL_MM), GEL, MarkerGrid(7, 5, (1.6, 1.7), 0.45)
)
LOOK = MarkerAppearance(0.45 / PIXEL_MM)
AT_REST = GelSurface(np.zeros(SENSOR.shape), SENSOR.to_px(SENSOR.markers.positions_mm))


def calibrated() -> Calibration:
    """Calibrate with eight presses of the ball whose contacts are known."""
    still, rng = render(SENSOR, AT_REST, seed=0), np.random.default_rng(1)
    touches = []
    for number in range(8):
        middle, edge = rng.uniform((45, 40), (105, 80)), rng.uniform(14.0, 18.0)  # px
        image = render(SENSOR, ball_face(middle, edge), seed=number + 1)
        changed = image_change(image, still, LOOK)
        known = ~marker_pixels(image, still, LOOK)
        touches.append(BallPress(f"press {number}", changed, known, Circle(tuple(middle), edge)))
    ball = Ball(BALL_MM, (PIXEL_MM, PIXEL_MM))
    found, _ = fit_map(touches, ball, FitOptions("mlp_colour", rounds=0))
    return Calibration(found, still, (PIXEL_MM, PIXEL_MM), LOOK)


def ball_face(middle_px: np.ndarray, edge_px: float) -> GelSurface:
    """The face under a ball as far as its contact, and a rim that dies away beyond."""
    rows, columns = np.indices(SENSOR.shape)
    away = np.hypot(columns - middle_px[0], rows - middle_px[1]) * PIXEL_MM
    edge = edge_px * PIXEL_MM
    rim = 0.35 * edge / np.sqrt(BALL_MM**2 - edge**2)
    ball = np.sqrt(BALL_MM**2 - edge**2) - np.sqrt(np.maximum(BALL_MM**2 - away**2, 0.0)) - rim
    return GelSurface(
        np.where(away < edge, ball, -rim * np.exp(-(away - edge) / 0.35)), AT_REST.markers_px
    )


def pressed(depth_mm: float, shift_mm: float) -> GelContact:
    """Press the ball so deep into a fine gel, and drag it along x; without slip."""
    gel = GelModel(GEL, GelOptions(edge_mm=0.6, layers=4))
    away = np.linalg.norm(gel.points[:, :2], axis=1)
    down = np.sqrt(np.maximum(BALL_MM**2 - away**2, 0.0)) - BALL_MM + depth_mm
    moved = np.column_stack([np.full_like(down, shift_mm), np.zeros_like(down), -down])
    moved[down <= 0.0] = np.nan  # free
    return gel.forces(moved)


def main() -> dict[str, np.ndarray]:
    """Press, render, and estimate the force."""
    truth = pressed(depth_mm=0.5, shift_mm=0.1)
    chain = SensorChain(
        SENSOR, calibrated(), render(SENSOR, AT_REST, seed=50), GelModel(GEL, GelOptions(0.8))
    )
    image = render(SENSOR, build_surface(SENSOR, truth.points, truth.displacement), seed=51)
    seen = chain.measure(Frame(0, "press", image, 0.0))
    assert seen.contact is not None, "no contact detected"
    found = {"true": truth.total, "estimated": seen.contact.total}
    for name, force in found.items():
        print(f"{name}: {force[0]:+.3f} N along x, {force[2]:+.3f} N along z")
    print(f"depth {seen.height.depth_mm:.2f} mm (true 0.50)")
    return found


if __name__ == "__main__":
    main()
