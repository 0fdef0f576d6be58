"""From a target to parameters: starts, the solver, uncertainty, the result."""

from petalfit.fitting.fit import fit as fit
from petalfit.fitting.fit import fit_petal as fit_petal
from petalfit.fitting.result import Agreement as Agreement
from petalfit.fitting.result import FitError as FitError
from petalfit.fitting.result import FitResult as FitResult
from petalfit.fitting.result import Profile as Profile
from petalfit.fitting.result import Start as Start
