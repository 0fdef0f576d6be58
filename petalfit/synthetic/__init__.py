"""Synthetic cases made by the forward model: their truth is known, so fits can be compared with it."""

from petalfit.synthetic.case import Case as Case
from petalfit.synthetic.case import make as make
from petalfit.synthetic.case import make_masks as make_masks
from petalfit.synthetic.files import check_cases as check_cases
from petalfit.synthetic.files import read_case as read_case
from petalfit.synthetic.files import read_flower_case as read_flower_case
from petalfit.synthetic.files import write_case as write_case
from petalfit.synthetic.files import write_cases as write_cases
from petalfit.synthetic.files import write_flower_case as write_flower_case
from petalfit.synthetic.flower_case import FlowerCase as FlowerCase
from petalfit.synthetic.flower_case import Scan as Scan
from petalfit.synthetic.flower_case import scan as scan
from petalfit.synthetic.random_petal import random_petal as random_petal
from petalfit.synthetic.recipes import FLOWERS as FLOWERS
from petalfit.synthetic.recipes import RECIPES as RECIPES
from petalfit.synthetic.sight import Sight as Sight
