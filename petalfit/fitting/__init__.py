"""From a target to parameters: starts, the solver, uncertainty, the result."""

from petalfit.fitting.checks import check_request as check_request
from petalfit.fitting.colours import ColourFit as ColourFit
from petalfit.fitting.colours import colours_on as colours_on
from petalfit.fitting.estimate import Estimate as Estimate
from petalfit.fitting.estimate import FitError as FitError
from petalfit.fitting.estimate import Start as Start
from petalfit.fitting.fit import fit as fit
from petalfit.fitting.fit import fit_petal as fit_petal
from petalfit.fitting.result import Agreement as Agreement
from petalfit.fitting.result import FitResult as FitResult
from petalfit.fitting.result import Profile as Profile
