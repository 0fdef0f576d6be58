"""Differentiable surfaces: a map (u, v) → ℝ³ and what follows from the map alone."""

from petalfit.surfaces.deformation import AbstractDeformedSurface as AbstractDeformedSurface
from petalfit.surfaces.outline import Outline as Outline
from petalfit.surfaces.outline import outline as outline
from petalfit.surfaces.parameter import WRAPPED as WRAPPED
from petalfit.surfaces.parameter import Parameter as Parameter
from petalfit.surfaces.parameter import length as length
from petalfit.surfaces.parameter import parameter as parameter
from petalfit.surfaces.parameter import parameters as parameters
from petalfit.surfaces.parameter import value_at as value_at
from petalfit.surfaces.parameter import with_value as with_value
from petalfit.surfaces.pose import Pose as Pose
from petalfit.surfaces.pose import about_x as about_x
from petalfit.surfaces.pose import about_y as about_y
from petalfit.surfaces.shapes import Cylinder as Cylinder
from petalfit.surfaces.shapes import Ellipsoid as Ellipsoid
from petalfit.surfaces.shapes import Rectangle as Rectangle
from petalfit.surfaces.silhouette import coverage as coverage
from petalfit.surfaces.silhouette import outline_rings as outline_rings
from petalfit.surfaces.silhouette import rings as rings
from petalfit.surfaces.surface import AbstractSurface as AbstractSurface
from petalfit.surfaces.surface import Domain as Domain
from petalfit.surfaces.surface import Scalar as Scalar
from petalfit.surfaces.surface import position_and_tangents as position_and_tangents
from petalfit.surfaces.symmetry import is_of_revolution as is_of_revolution
from petalfit.surfaces.tessellation import grid_faces as grid_faces
from petalfit.surfaces.tessellation import grid_uv as grid_uv
