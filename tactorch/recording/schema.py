"""Layout of the file of a recording: HDF5.

Versions 2 to 17 (n nodes, m elements; arrays row by row, gzip with checksums; text is UTF-8 of
fixed length; the structure is that of HDF5 1.10, with checksums):

| path | type | unit |
|---|---|---|
| / `format` | attribute, "tactorch-recording" | |
| / `version` | attribute, 6 (7 while presses are appended), see below | |
| / `units` | attribute, "mm, N, MPa, tonne/mm^3" | |
| / `density` | attribute, float64; absent where weight is not modelled | tonne/mm^3 |
| /mesh/points | float64 (n, 3) | mm |
| /mesh/tets | int64 (m, 4) | |
| /mesh/regions | int64 (m,), region number of each element; absent before version 8 | |
| /material `name`, `poisson` | attributes | |
| /material `parameters` | attribute, JSON object of numbers | |
| /gravity | float64 (3,) | mm/s^2 |
| /provenance | text, JSON object; its SHA-256 in the attribute `sha256` | |
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
| /presses/0000/probe `name`, `sizes` | attributes, JSON object of numbers; may be absent | mm |
| /presses/0000/probe/position_mm | float64 (3,) | mm |
| /presses/0000/probe/rotation | float64 (3, 3) | |
| /presses/0000/probe `deviation_mm` | attribute, float64; absent where zero | mm |
| /presses/0000/force/axes | float64 (k, 6), may be absent | |
| /presses/0000/force/values, deviations | float64 (k,) | N, N mm |
| /presses/0000/force/about_mm | float64 (3,) | mm |
| /presses/0000/surface/points_mm, directions | float64 (k, 3), may be absent | mm |
| /presses/0000/surface/displacement_mm, deviations_mm | float64 (k,) | mm |
| /presses/0000/errors/nodes | int64 (l,), may be absent | |
| /presses/0000/errors/forces | float64 (q, l, 3) | N |
| /presses/0000/errors/displacement | float64 (q, l, 3) | mm |
| /presses/0000/gel/layer | float64 (7,), see `GelReading`; may be absent | mm, MPa |
| /presses/0000/gel/pose, first_pose | float64 (4, 4) | mm |
| /presses/0000/gel/markers_mm, displacement_mm | float64 (k, 2) | mm |
| /presses/0000/gel/deviations_mm | float64 (k,) | mm |
| /presses/0000/gel/uncertain | float64 (3,) | , mm, rad |
| /presses/0000/gel/opposed | float64 (2,), may be absent | mm |

With a probe, nodal fields that are zero, or NaN, throughout are absent.

From version 12 on, k consecutive presses by one probe that have the same nodal fields may share
a group, with the number of the first of them as its name. The nodal fields are stored once, and the
other arrays have a further first axis of length k. In place of attributes there are

| path | type | unit |
|---|---|---|
| /presses/0000/names | text, JSON list of k names, with its SHA-256 | |
| /presses/0000/step | int64 (k,) | |
| /presses/0000/noise_mm | float64 (k,), NaN where unknown | mm |
| /presses/0000/probe/deviation_mm | float64 (k,) | mm |

Links, external storage and virtual datasets are refused: they lead to other files.

In versions 7, 9, 11, 13, 15 and 17 presses follow the end of the HDF5 part, as its superblock
states it. HDF5 ignores them, and drops them when it opens the file for writing. Each is a record of
60 bytes (the text `TACPRESS`; number of the press, uint64; length of the image, uint64; SHA-256 of
the image; CRC-32 of the 56 bytes before; little-endian) and an image: an HDF5 file whose root is a
group as /presses/0000. An incomplete last record is ignored. `tactorch.recording.compact` makes
version 6, 8, 10, 12, 14 or 16 of such a file.

A reader refuses a version above its own. A change of the layout raises `VERSION`;
`tactorch.recording.storage` reads all versions. Version 1 had no `unloaded`; versions 2 and 3 were
4 and 5 without `probe`, `force` and `surface`; in versions 4 and 5 all nodal fields were stored,
and probes had no `deviation_mm`; versions 6 and 7 have no `regions`, and are written for meshes
without regions, so that tactorch before version 8 reads them; versions 8 and 9 have no `errors`,
and are written where no press has them; before version 12 each press had a separate group, as it
has where the nodal fields differ; versions 12 and 13 have no `gel`, and are written where no press
has one; versions 14 and 15 have no `opposed`, and are written where no press is a grasp.
"""

FORMAT = "tactorch-recording"
VERSION = 17
GROWING_VERSIONS = (3, 5, 7, 9, 11, 13, 15, 17)
ERRORS_VERSION = 10  # the first with `errors`
STACKED_VERSION = 12  # the first with several presses in a group
GEL_VERSION = 14  # the first with `gel`
GRASP_VERSION = 16  # the first with an opposed gel
UNITS = "mm, N, MPa, tonne/mm^3"
#: Nodal fields with the value they have throughout where a press by a probe does not store them.
PRESS_ARRAYS: dict[str, float | bool] = {
    "forces": 0.0,
    "observed": False,
    "displacement": float("nan"),
    "springs": 0.0,
    "fixed": False,
    "prescribed": 0.0,
}
PRESS_MASKS = ("observed", "fixed")
#: Other arrays of a press by name, with their shapes (None: any length); each group may be absent.
PRESS_VALUES: dict[str, tuple[int | None, ...]] = {
    "direction": (3,),
    "probe/position_mm": (3,),
    "probe/rotation": (3, 3),
    "force/axes": (None, 6),
    "force/values": (None,),
    "force/deviations": (None,),
    "force/about_mm": (3,),
    "surface/points_mm": (None, 3),
    "surface/directions": (None, 3),
    "surface/displacement_mm": (None,),
    "surface/deviations_mm": (None,),
    "errors/nodes": (None,),
    "errors/forces": (None, None, 3),
    "errors/displacement": (None, None, 3),
    "gel/layer": (7,),
    "gel/pose": (4, 4),
    "gel/first_pose": (4, 4),
    "gel/markers_mm": (None, 2),
    "gel/displacement_mm": (None, 2),
    "gel/deviations_mm": (None,),
    "gel/uncertain": (3,),
    "gel/opposed": (2,),
}
#: Those that may be absent where their group is present.
OPTIONAL_VALUES = ("gel/opposed",)


def written_version(*, regions: bool, least: int = 0, growing: bool = False) -> int:
    """Return the version of a file: the lowest one whose readers know its content.

    `least` is the lowest one that knows the content of its presses.
    """
    return max(6 + 2 * regions, least) + growing
