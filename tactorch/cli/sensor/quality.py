"""How good a calibration is on some presses: as JSON, as text and as a picture."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tactorch.cli.logs import log_text
from tactorch.cli.outputs import write_json
from tactorch.cli.sensor.presses import Pressed, write_circles
from tactorch.cli.settings import log
from tactorch.cli.tables import Table
from tactorch.files import atomic_path
from tactorch.sensor.calibration import Ball, Circle, MapQuality, SlopeMap, evaluate_map, map_slopes
from tactorch.sensor.depth import integrate_slopes
from tactorch.viz.sensor_calibration import BallPress, plot_ball_presses

REPORT, TEXT, CIRCLES, PICTURE = "quality.json", "quality.txt", "circles.csv", "held_out.png"
#: What a command of presses leaves in its folder.
RESULTS = (REPORT, TEXT, CIRCLES, PICTURE)


@dataclass(frozen=True, eq=False)
class Judged:
    """A press, the circle fitted to it, and a map that it is seen with.

    Attributes:
        pressed: The press.
        circle: Where the ball touches.
        map: From colours to slopes; not fitted to this press, where that can be helped.
    """

    pressed: Pressed
    circle: Circle
    map: SlopeMap


def write_report(
    folder: Path,
    title: str,
    quality: MapQuality,
    judged: Sequence[Judged],
    ball: Ball,
    circles: Mapping[str, Circle],
    more: Mapping[str, Any],
) -> None:
    """Write figures, contacts and the picture, and tell the figures.

    Args:
        folder: Of the run.
        title: What was judged on what.
        quality: Of all presses pool_quality.
        judged: The presses.
        ball: What was pressed.
        circles: All contacts, those of presses that were fitted to included.
        more: Goes into the JSON as it is.
    """
    each = {
        one.pressed.touch.name: evaluate_map(one.map, [one.pressed.touch], [one.circle], ball)
        for one in judged
    }
    radii = {one.pressed.touch.name: one.circle.radius_px * ball.mm_per_px[0] for one in judged}
    table = _table(quality, each, radii)
    text = _text(title, quality, table)
    presses = {n: {**asdict(q), "contact_radius_mm": radii[n]} for n, q in each.items()}
    figures = {"quality": asdict(quality), "presses": presses}
    write_json(folder / REPORT, {"judged": title, **figures, **more})
    with atomic_path(folder / TEXT) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    write_circles(folder / CIRCLES, circles)
    plot_ball_presses([_seen(one, ball) for one in judged], ball, title, folder / PICTURE)
    log_text(text, table)
    log.info("pictures of them: %s", folder / PICTURE)


def _table(
    quality: MapQuality, each: Mapping[str, MapQuality], radii_mm: Mapping[str, float]
) -> Table:
    head = ("", "R^2 x", "R^2 y", "MAE x", "MAE y", "depth rms, mm", "contact radius, mm")
    rows = []
    for name, q in [*each.items(), ("all together", quality)]:
        numbers = [f"{v:.3f}" for v in (*q.r2, *q.mae)]
        radius = f"{radii_mm[name]:.2f}" if name in radii_mm else ""
        rows.append((name, *numbers, f"{q.depth_rms_mm:.4f}", radius))
    return Table(head, rows)


def _text(title: str, quality: MapQuality, table: Table) -> str:
    lines = [
        title,
        table.text(),
        f"Slopes are compared at {quality.pixels} pixels within 0.9 of the contacts' radii, which"
        " were fitted to these presses, as their middles were; depth but for a constant.",
    ]
    return "\n".join(lines)


def _seen(one: Judged, ball: Ball) -> BallPress:
    touch = one.pressed.touch
    slopes = map_slopes(one.map, touch.change)
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], ball.mm_per_px)
    return BallPress(
        touch.name, one.pressed.image, touch.circle, one.circle, touch.known, slopes, height
    )
