"""Tetrahedral meshes: generation, files, validation and queries. Lengths in mm."""

from tactorch.mesh.body_file import BodyFile
from tactorch.mesh.io import read_mesh, read_surface, write_mesh, write_surface
from tactorch.mesh.meshing import box_mesh, tetrahedralize
from tactorch.mesh.refine import Refinement, refine
from tactorch.mesh.revolved import Cone, Cylinder, Hemisphere, Hyperboloid, Lathe, Torus
from tactorch.mesh.shapes import Box, Ellipsoid, Rotated, Shape, Sphere, Union
from tactorch.mesh.solids import solid_surface
from tactorch.mesh.tetmesh import FACE_NAMES, TetMesh, compact, face_nodes, select_face
from tactorch.mesh.topology import Adjacency, Surface
from tactorch.mesh.voxels import VoxelGrid, locate

__all__ = [
    "FACE_NAMES",
    "Adjacency",
    "BodyFile",
    "Box",
    "Cone",
    "Cylinder",
    "Ellipsoid",
    "Hemisphere",
    "Hyperboloid",
    "Lathe",
    "Refinement",
    "Rotated",
    "Shape",
    "Sphere",
    "Surface",
    "TetMesh",
    "Torus",
    "Union",
    "VoxelGrid",
    "box_mesh",
    "compact",
    "face_nodes",
    "locate",
    "read_mesh",
    "read_surface",
    "refine",
    "select_face",
    "solid_surface",
    "tetrahedralize",
    "write_mesh",
    "write_surface",
]
