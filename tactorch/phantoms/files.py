"""Phantom whose body is read from a file."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh.body_file import BodyFile
from tactorch.phantoms.phantom import Phantom


@dataclass(frozen=True, kw_only=True)
class FilePhantom(Options):
    """Body of a surface (.stl, .obj, .ply) or mesh file, with inclusions of simple shapes."""

    section = "phantom"
    file: Path | None = option(None, "Closed surface or mesh of the body; required")
    unit: Literal["mm", "cm", "m"] = option("mm", "Length unit of the file")
    youngs_mpa: float = option(0.2, "Young's modulus of the body", unit="MPa", gt=0)
    inclusions: tuple[Mapping[str, Any], ...] = option(
        (), "Shapes with their moduli, such as "
        "{shape: sphere, center_mm: [0, 0, 8], radius_mm: 3, youngs_mpa: 1}",
    )  # fmt: skip

    def build(self) -> Phantom:
        """Return the phantom.

        Raises:
            ConfigError: There is no file, or an inclusion is not valid.
            FileError: The file cannot be read.
            MeshError: The surface does not bound one body.
        """
        if self.file is None:
            raise ConfigError("phantom.file is required: the surface or mesh of the body.")
        body = BodyFile(str(self.file), self.unit)
        entries = {"shape": "bodyfile", "path": body.path, "unit": body.unit}
        return Phantom.from_config(
            {"body": entries, "youngs_mpa": self.youngs_mpa, "inclusions": list(self.inclusions)}
        )
