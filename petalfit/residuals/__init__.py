"""Residuals of a posed model against an observation, in units of the noise."""

from petalfit.residuals.contact import Frame as Frame
from petalfit.residuals.contact import frame as frame
from petalfit.residuals.contact import pull_back as pull_back
from petalfit.residuals.contour_distance import ContourDistance as ContourDistance
from petalfit.residuals.curvature_bias import perturbation as perturbation
from petalfit.residuals.edge import EDGE_NODES as EDGE_NODES
from petalfit.residuals.edge import edge_nodes as edge_nodes
from petalfit.residuals.edge import edge_pull as edge_pull
from petalfit.residuals.edge import edge_residual as edge_residual
from petalfit.residuals.edge import edge_score as edge_score
from petalfit.residuals.foot_point import half_squared_distance as half_squared_distance
from petalfit.residuals.foot_point import least_places as least_places
from petalfit.residuals.foot_point import limits as limits
from petalfit.residuals.foot_point import nearest_nodes as nearest_nodes
from petalfit.residuals.foot_point import refine_foot_points as refine_foot_points
from petalfit.residuals.foot_point import slide_foot_points as slide_foot_points
from petalfit.residuals.strip import potential as potential
from petalfit.residuals.tangent_distance import Data as Data
from petalfit.residuals.tangent_distance import FrozenDistance as FrozenDistance
from petalfit.residuals.tangent_distance import TangentDistance as TangentDistance
from petalfit.residuals.tangent_distance import estimate_sigma as estimate_sigma
from petalfit.residuals.term import AbstractFrozen as AbstractFrozen
from petalfit.residuals.term import AbstractTerm as AbstractTerm
from petalfit.residuals.term import Pull as Pull
