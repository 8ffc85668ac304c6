"""What a file of a recording looks like: HDF5.

Layout, version 2 (n nodes, m elements; arrays row by row, gzip with checksums; text is UTF-8 of
fixed length; the structure is that of HDF5 1.10, with checksums):

| path | type | unit |
|---|---|---|
| / `format` | attribute, "tactorch-recording" | |
| / `version` | attribute, 2 | |
| / `units` | attribute, "mm, N, MPa, tonne/mm^3" | |
| / `density` | attribute, float64; absent where weight plays no part | tonne/mm^3 |
| /mesh/points | float64 (n, 3) | mm |
| /mesh/tets | int64 (m, 4) | |
| /material `name`, `poisson` | attributes | |
| /material `parameters` | attribute, JSON object of numbers | |
| /gravity | float64 (3,) | mm/s^2 |
| /provenance | text, JSON object | |
| /truth, /reference | float64 (m,), each may be absent | MPa |
| /unloaded | float64 (frames, n, 3), NaN where not observed; may be absent | mm |
| /presses `count` | attribute | |
| /presses/0000 `name`, `step` | attributes | |
| /presses/0000 `noise_mm` | attribute, float64; absent where unknown | mm |
| /presses/0000/forces | float64 (n, 3) | N |
| /presses/0000/observed | uint8 (n, 3), 0 or 1 | |
| /presses/0000/displacement | float64 (n, 3), NaN where not observed | mm |
| /presses/0000/springs | float64 (n, 3) | N/mm |
| /presses/0000/fixed | uint8 (n, 3), 0 or 1 | |
| /presses/0000/prescribed | float64 (n, 3) | mm |
| /presses/0000/weights | float64 (n, 3), may be absent | |
| /presses/0000/direction | float64 (3,), may be absent | |

A reader refuses a version above its own. Whoever changes the layout raises `VERSION` and teaches
`tactorch.recording.reader` the older ones. Version 1 had no `unloaded`.
"""

FORMAT = "tactorch-recording"
VERSION = 2
UNITS = "mm, N, MPa, tonne/mm^3"
PRESS_ARRAYS = ("forces", "observed", "displacement", "springs", "fixed", "prescribed")
PRESS_MASKS = ("observed", "fixed")
PRESS_OPTIONAL = {"weights": (None, 3), "direction": (3,)}
