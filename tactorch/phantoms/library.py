"""Phantoms by name: the objects of the paper's figures and related ones."""

from typing import Any

from tactorch.config import Registry
from tactorch.phantoms.phantom import Phantom

PHANTOMS = Registry(
    "phantom",
    {
        "uniform_cube": "tactorch.phantoms.cubes:UniformCube",
        "cube_sphere": "tactorch.phantoms.cubes:CubeSphere",
        "cube_shallow_sphere": "tactorch.phantoms.cubes:CubeShallowSphere",
        "cube_deep_sphere": "tactorch.phantoms.cubes:CubeDeepSphere",
        "cube_box": "tactorch.phantoms.cubes:CubeBox",
        "cube_cylinder": "tactorch.phantoms.cubes:CubeCylinder",
        "cube_ellipsoid": "tactorch.phantoms.cubes:CubeEllipsoid",
        "cube_two_tiers": "tactorch.phantoms.cubes:CubeTwoTiers",
        "cube_torus": "tactorch.phantoms.cubes:CubeTorus",
        "cube_cone": "tactorch.phantoms.cubes:CubeCone",
        "cube_soft_cone": "tactorch.phantoms.cubes:CubeSoftCone",
        "cube_gradient": "tactorch.phantoms.cubes:CubeGradient",
        "cube_layers": "tactorch.phantoms.cubes:CubeLayers",
        "depth_cube": "tactorch.phantoms.cubes:DepthCube",
        "silicone_ball": "tactorch.phantoms.cubes:SiliconeBall",
        "silicone_hole": "tactorch.phantoms.cubes:SiliconeHole",
        "cylinder_sphere": "tactorch.phantoms.curved:CylinderSphere",
        "cylinder_hole_sphere": "tactorch.phantoms.curved:CylinderHoleSphere",
        "hyperboloid_sphere": "tactorch.phantoms.curved:HyperboloidSphere",
        "hemisphere_spheres": "tactorch.phantoms.curved:HemisphereSpheres",
        "hemisphere_random": "tactorch.phantoms.curved:HemisphereRandom",
        "hemisphere_two_spheres": "tactorch.phantoms.curved:HemisphereTwoSpheres",
        "mesh": "tactorch.phantoms.files:FilePhantom",
        "toy_two_spheres": "tactorch.phantoms.curved:ToyTwoSpheres",
        "labelled": "tactorch.phantoms.files:Labelled",
    },
)


def make_phantom(name: str, **changes: Any) -> Phantom:
    """Make one of `PHANTOMS`, with settings of that phantom such as `inclusion_mpa=2.0`."""
    return PHANTOMS.build({"name": name, **changes}).build()
