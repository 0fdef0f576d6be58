"""Fitting of models to targets: starts, solvers, errors, and the result."""

from petalfit.fitting.colours.fit import ColourFit as ColourFit
from petalfit.fitting.colours.texture import colours_on as colours_on
from petalfit.fitting.error import FitError as FitError
from petalfit.fitting.families.family import AbstractFamily as AbstractFamily
from petalfit.fitting.families.open_surface import CloudStart as CloudStart
from petalfit.fitting.families.open_surface import OpenSurfaceFamily as OpenSurfaceFamily
from petalfit.fitting.families.registry import DEFAULT as DEFAULT
from petalfit.fitting.families.registry import FOR_SCANS as FOR_SCANS
from petalfit.fitting.families.registry import family_of as family_of
from petalfit.fitting.families.registry import petals as petals
from petalfit.fitting.families.registry import register as register
from petalfit.fitting.fit import check_request as check_request
from petalfit.fitting.fit import fit as fit
from petalfit.fitting.fit import fit_petal as fit_petal
from petalfit.fitting.fit import tip_of as tip_of
from petalfit.fitting.flower import fit_flower as fit_flower
from petalfit.fitting.flower_result import FlowerResult as FlowerResult
from petalfit.fitting.outliers.registry import LOSSES as LOSSES
from petalfit.fitting.result import FitResult as FitResult
