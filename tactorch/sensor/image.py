"""Images of the sensor: RGB, 8 bits a channel, rows from the top."""

import numpy as np
from jaxtyping import UInt8

Image = UInt8[np.ndarray, "_ _ 3"]
