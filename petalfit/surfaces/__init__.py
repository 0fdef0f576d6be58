"""Differentiable surfaces: a map (u, v) → ℝ³ and what follows from the map alone."""

from petalfit.surfaces.deformation import AbstractDeformedSurface as AbstractDeformedSurface
from petalfit.surfaces.shapes import Cylinder as Cylinder
from petalfit.surfaces.shapes import Ellipsoid as Ellipsoid
from petalfit.surfaces.shapes import Rectangle as Rectangle
from petalfit.surfaces.surface import AbstractSurface as AbstractSurface
from petalfit.surfaces.surface import Domain as Domain
from petalfit.surfaces.surface import Scalar as Scalar
from petalfit.surfaces.surface import position_and_tangents as position_and_tangents
