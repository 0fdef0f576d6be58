"""Compiled programs, and their storage beyond the process that compiled them."""

from petalfit.compilation.buckets import BLOCK as BLOCK
from petalfit.compilation.buckets import ROWS as ROWS
from petalfit.compilation.buckets import blocks as blocks
from petalfit.compilation.buckets import bucket as bucket
from petalfit.compilation.buckets import pad_to as pad_to
from petalfit.compilation.program import Program as Program
from petalfit.compilation.program import RowProgram as RowProgram
from petalfit.compilation.program import prepared as prepared
from petalfit.compilation.stopwatch import Stopwatch as Stopwatch
from petalfit.compilation.stopwatch import stage as stage
from petalfit.compilation.stopwatch import watched as watched
from petalfit.compilation.store import ExecutableStore as ExecutableStore
from petalfit.compilation.store import use_folder as use_folder
from petalfit.compilation.store import use_store as use_store
