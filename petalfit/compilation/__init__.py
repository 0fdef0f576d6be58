"""Compiled programs, and how they outlive the process that compiled them."""

from petalfit.compilation.buckets import bucket as bucket
from petalfit.compilation.buckets import pad_to as pad_to
from petalfit.compilation.program import Program as Program
from petalfit.compilation.store import ExecutableStore as ExecutableStore
from petalfit.compilation.store import use_store as use_store
