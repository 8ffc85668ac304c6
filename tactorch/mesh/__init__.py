"""Tetrahedral meshes: making, reading, checking and asking them. Lengths in mm."""

from tactorch.files import cache_folder
from tactorch.mesh.combined import Rotated, Union
from tactorch.mesh.faces import FACE_NAMES, face_nodes, select_face
from tactorch.mesh.generate import box_mesh
from tactorch.mesh.io import read_mesh, read_surface, write_mesh, write_surface
from tactorch.mesh.meshing import tetrahedralize
from tactorch.mesh.parts import Adjacency, Surface
from tactorch.mesh.revolved import Cone, Hemisphere, Hyperboloid, Lathe, Torus
from tactorch.mesh.shapes import Box, Cylinder, Ellipsoid, Shape, Sphere
from tactorch.mesh.skin import skin
from tactorch.mesh.surfaces import (
    box_surface,
    cylinder_surface,
    revolved_surface,
    torus_surface,
)
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.topology import LOCAL_EDGES, LOCAL_FACES
from tactorch.mesh.voxels import VoxelGrid

__all__ = [
    "FACE_NAMES",
    "LOCAL_EDGES",
    "LOCAL_FACES",
    "Adjacency",
    "Box",
    "Cone",
    "Cylinder",
    "Ellipsoid",
    "Hemisphere",
    "Hyperboloid",
    "Lathe",
    "Rotated",
    "Shape",
    "Sphere",
    "Surface",
    "TetMesh",
    "Torus",
    "Union",
    "VoxelGrid",
    "box_mesh",
    "box_surface",
    "cache_folder",
    "compact",
    "cylinder_surface",
    "face_nodes",
    "read_mesh",
    "read_surface",
    "revolved_surface",
    "select_face",
    "skin",
    "tetrahedralize",
    "torus_surface",
    "write_mesh",
    "write_surface",
]
