"""The organs of the paper as named, differentiable components."""

from petalfit.components.parameter import Parameter as Parameter
from petalfit.components.parameter import parameter as parameter
from petalfit.components.parameter import parameters as parameters
from petalfit.components.peony_petal import PeonyPetal as PeonyPetal
from petalfit.components.posed import Posed as Posed
from petalfit.components.posed import bare as bare
