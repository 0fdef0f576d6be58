"""How a posed model meets an observation, in units of its noise."""

from petalfit.residuals.contact import Frame as Frame
from petalfit.residuals.contact import frame as frame
from petalfit.residuals.contact import pull_back as pull_back
from petalfit.residuals.curvature_bias import distance_score as distance_score
from petalfit.residuals.curvature_bias import perturbations as perturbations
from petalfit.residuals.edge import edge_pull as edge_pull
from petalfit.residuals.edge import edge_residual as edge_residual
from petalfit.residuals.edge import edge_score as edge_score
from petalfit.residuals.foot_point import nearest_nodes as nearest_nodes
from petalfit.residuals.foot_point import refine_foot_points as refine_foot_points
