"""The organs of the paper as named, differentiable components."""

from petalfit.components.peony_petal import PeonyPetal as PeonyPetal
from petalfit.components.posed import Posed as Posed
from petalfit.components.posed import bare as bare
from petalfit.surfaces import Cylinder as Cylinder
from petalfit.surfaces import Ellipsoid as Ellipsoid
from petalfit.surfaces import Parameter as Parameter
from petalfit.surfaces import Rectangle as Rectangle
from petalfit.surfaces import parameter as parameter
from petalfit.surfaces import parameters as parameters
