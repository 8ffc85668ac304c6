"""Make the data of the story of a roboticist: images of a tactile sensor, and a robot's log.

    python examples/stories/make_roboticist_data.py FOLDER

A soft cube of 10 mm has a stiff ball. A robot presses a camera sensor with a soft gel on three of
its sides, turning the cube to the next one. Gel and cube are simulated as one body of quadratic
elements, fine at the edge of the contact and at the ball, whose modulus is that of the quadrature
points; images are drawn through a distorting lens with noise and 8 bits, as in
`benchmarks/sensor_chain.py`. The files are

    sensor.yaml   description of the sensor
    still.png     gel without contact
    balls/        presses of a ball of 3 mm radius, for the calibration
    frames/       images of the session
    poses.csv     log of the robot: pose of the sensor in the frame of the cube, for each image
    truth.json    what is inside, which the story does not read

It takes two to three minutes. Files that are there are kept.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from sensor_chain import SIDES, Session, draw_session, simulated
from sensor_truth import Ball

SESSION = Session(Ball((6.0, 4.4, 6.6), 2.0, 1.0))
RIM_MM = 0.55  # edge length of the simulation at the edge of the contact


def main() -> None:
    """Write the files that are not there."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    make(parser.parse_args().folder)


def make(folder: Path) -> None:
    """Write the files into a folder, unless it has them all; `truth.json` is the last one."""
    if (folder / "truth.json").is_file():
        return
    contacts = {side: simulated(SESSION, turn, RIM_MM) for side, turn in SIDES.items()}
    draw_session(folder, SESSION, contacts)
    ball = SESSION.ball
    truth = {"center_mm": ball.center_mm, "radius_mm": ball.radius_mm}
    truth |= {"youngs_mpa": ball.youngs_mpa, "around_mpa": SESSION.youngs_mpa}
    (folder / "truth.json").write_text(json.dumps(truth))


if __name__ == "__main__":
    main()
