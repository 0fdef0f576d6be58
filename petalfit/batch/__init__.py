"""Many targets: on all cores of this machine, or of a cluster; in memory, or from files into a table."""

from petalfit.batch.failure import FitFailure as FitFailure
from petalfit.batch.many import fit_batch as fit_batch
