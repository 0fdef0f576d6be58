"""Whole flowers: organs on a receptacle, their arrangement, their files and their meshes."""

from petalfit.flowers.androecium import KINDS as STAMENS  # noqa: F401
from petalfit.flowers.androecium import stamens as stamens
from petalfit.flowers.attachment import Attachment as Attachment
from petalfit.flowers.file import flower_from_json as flower_from_json
from petalfit.flowers.file import flower_to_json as flower_to_json
from petalfit.flowers.file import load_flower as load_flower
from petalfit.flowers.file import save_flower as save_flower
from petalfit.flowers.flower import Flower as Flower
from petalfit.flowers.flower import Part as Part
from petalfit.flowers.flower import Series as Series
from petalfit.flowers.grown import Grown as Grown
from petalfit.flowers.grown import grow as grow
from petalfit.flowers.grown import require_memory as require_memory
from petalfit.flowers.gynoecium import KINDS as PISTILS  # noqa: F401
from petalfit.flowers.gynoecium import pistils as pistils
from petalfit.flowers.lily import lily as lily
from petalfit.flowers.peony import peony as peony
from petalfit.flowers.phyllotaxis import GOLDEN_ANGLE as GOLDEN_ANGLE
from petalfit.flowers.phyllotaxis import Arrangement as Arrangement
from petalfit.flowers.phyllotaxis import l_system as l_system
from petalfit.flowers.phyllotaxis import recursion as recursion
from petalfit.flowers.phyllotaxis import rewrite as rewrite
from petalfit.flowers.phyllotaxis import scattered as scattered
from petalfit.flowers.phyllotaxis import whorls as whorls
from petalfit.flowers.settings import FlowerError as FlowerError
from petalfit.flowers.settings import with_settings as with_settings
