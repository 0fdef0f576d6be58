"""The organs of the paper as named, differentiable components."""

import inspect

from petalfit.components.assembly import AbstractAssembly as AbstractAssembly
from petalfit.components.blade_petal import BladePetal as BladePetal
from petalfit.components.pedicel import Pedicel as Pedicel
from petalfit.components.peony_petal import PeonyPetal as PeonyPetal
from petalfit.components.pistil import CompoundPistil as CompoundPistil
from petalfit.components.pistil import Ovary as Ovary
from petalfit.components.pistil import Pistil as Pistil
from petalfit.components.pistil import Stigma as Stigma
from petalfit.components.pistil import Style as Style
from petalfit.components.posed import Posed as Posed
from petalfit.components.posed import bare as bare
from petalfit.components.receptacle import Bowl as Bowl
from petalfit.components.receptacle import ConeReceptacle as ConeReceptacle
from petalfit.components.receptacle import CylinderReceptacle as CylinderReceptacle
from petalfit.components.scaling import lengths as lengths
from petalfit.components.scaling import scales_with_lengths as scales_with_lengths
from petalfit.components.sepal import Sepal as Sepal
from petalfit.components.spline_petal import SplinePetal as SplinePetal
from petalfit.components.stamen import Anther as Anther
from petalfit.components.stamen import Filament as Filament
from petalfit.components.stamen import Stamen as Stamen
from petalfit.observations import TargetError as _TargetError
from petalfit.surfaces import AbstractSurface as _AbstractSurface
from petalfit.surfaces import Cylinder as Cylinder
from petalfit.surfaces import Ellipsoid as Ellipsoid
from petalfit.surfaces import Parameter as Parameter
from petalfit.surfaces import Rectangle as Rectangle
from petalfit.surfaces import parameter as parameter
from petalfit.surfaces import parameters as parameters


def models() -> dict[str, type[_AbstractSurface]]:
    """All components that can be fitted or grown, by name."""
    return {
        name: kind
        for name, kind in globals().items()
        if inspect.isclass(kind)
        and issubclass(kind, _AbstractSurface)
        and not inspect.isabstract(kind)
        and kind is not Posed
    }


def model_named(name: str) -> type[_AbstractSurface]:
    """The component with this name.

    Raises:
        TargetError: There is no component with this name.
    """
    kinds = models()
    if name not in kinds:
        raise _TargetError(f"there is no model {name!r}; the models are {', '.join(kinds)}.")
    return kinds[name]
