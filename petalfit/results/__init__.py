"""Everything that a fit.json holds: values, errors, warnings, and the data with their residuals."""

from petalfit.results.agreement import Agreement as Agreement
from petalfit.results.discrepancy import Discrepancy as Discrepancy
from petalfit.results.draws import Draws as Draws
from petalfit.results.estimate import APART as APART
from petalfit.results.estimate import CLEAR_LEAD as CLEAR_LEAD
from petalfit.results.estimate import Estimate as Estimate
from petalfit.results.estimate import Start as Start
from petalfit.results.estimate import quantile as quantile
from petalfit.results.estimate import rivals as rivals
from petalfit.results.estimate import standard_errors as standard_errors
from petalfit.results.flower_record import FlowerRecord as FlowerRecord
from petalfit.results.layout import Layout as Layout
from petalfit.results.layout import LayoutKind as LayoutKind
from petalfit.results.layout import Quantity as Quantity
from petalfit.results.layout import Whorl as Whorl
from petalfit.results.misfit import MisfitMap as MisfitMap
from petalfit.results.profile import Profile as Profile
from petalfit.results.record import FitRecord as FitRecord
from petalfit.results.record import Rank as Rank
from petalfit.results.status import Status as Status
from petalfit.results.trait import Posterior as Posterior
from petalfit.results.trait import Trait as Trait
from petalfit.results.trait import errors_of as errors_of
from petalfit.results.warning import FitWarning as FitWarning
from petalfit.results.warning import WarningKind as WarningKind
from petalfit.results.warning import in_order as in_order
