"""Fits of many targets in parallel, on one machine or a cluster, in memory or from files to a table."""

from petalfit.batch.failure import FitFailure as FitFailure
from petalfit.batch.many import fit_batch as fit_batch
