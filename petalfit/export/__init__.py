"""Export of fits and flowers to files for other programs."""

from petalfit.export.flower import export_flower as export_flower
from petalfit.export.mesh import SUFFIXES as SUFFIXES
from petalfit.export.mesh import export_glb as export_glb
from petalfit.export.mesh import export_mesh as export_mesh
from petalfit.export.mesh import obj_text as obj_text
