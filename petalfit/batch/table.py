"""The table of a batch as Parquet, with one row per target."""

from __future__ import annotations

from collections.abc import Container, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from petalfit.batch.records import Record, WarningOfRecord
from petalfit.components import models, parameters
from petalfit.observations import TargetError
from petalfit.observations.atomic import atomic_path

if TYPE_CHECKING:
    import pyarrow

TABLE = "table.parquet"
_TEXT = ("id", "target", "status", "message", "model", "pose", "loss", "version", "input_hash",
         "finished")  # fmt: skip
_NUMBERS = ("seconds", "rms", "noise", "discrepancy", "discrepancy_length", "scale")


def check_pyarrow() -> None:
    """Checks, before thousands of fits, that their table can be written: pyarrow is installed."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise TargetError(
            "a batch writes its table with pyarrow, which is not installed: "
            "pip install 'petalfit[batch]'."
        ) from None


def write_table(records: Sequence[Record], path: Path) -> None:
    """Write a table with one row per record, completely or not at all.

    Columns of every target are id, target, status, converged, message, model, pose, loss, seconds,
    version, input_hash, finished (UTC), warnings (their sentences), warning_kinds (their kinds), data
    (the number of points, or of places of a contour), outliers, rms, noise, discrepancy and
    discrepancy_length (the standard deviation and the length of a misfit, null if there is none),
    scale, rotation (nine numbers, row by row) and translation (three). Each parameter of each model has
    four more columns: its name for the value, and its name with `_stderr` (null where the data do not
    determine it), with `_stderr_noise` (what noise alone would make of it) and with `_identifiable`.
    Each trait has two: `trait_` and its name, and the same with `_stderr` (null where it is not known);
    see `petalfit.results.trait`. Values that a target does not have are null.
    """
    import pyarrow.parquet

    table = as_table(records)
    with atomic_path(path) as temporary:
        pyarrow.parquet.write_table(table, temporary)


def as_table(records: Sequence[Record]) -> pyarrow.Table:
    """The records as a table; see `write_table` for its columns."""
    import pyarrow as pa

    def column(name: str, kind: pyarrow.DataType) -> pyarrow.Array:
        return pa.array([record.get(name) for record in records], kind)

    def of_parameter(group: str, name: str, kind: pyarrow.DataType) -> pyarrow.Array:
        return pa.array([record.get(group, {}).get(name) for record in records], kind)

    numbers = pa.list_(pa.float64())
    columns = {name: column(name, pa.string()) for name in _TEXT}
    columns |= {name: column(name, pa.float64()) for name in _NUMBERS}
    columns |= {name: column(name, pa.int64()) for name in ("data", "outliers")}
    columns["converged"] = column("converged", pa.bool_())
    for name, part in (("warnings", "text"), ("warning_kinds", "kind")):
        texts = [_each(record.get("warnings"), part) for record in records]
        columns[name] = pa.array(texts, pa.list_(pa.string()))
    columns |= {name: column(name, numbers) for name in ("rotation", "translation")}
    for name in _parameter_names(records, columns):
        columns[name] = of_parameter("values", name, pa.float64())
        columns[f"{name}_stderr"] = of_parameter("stderr", name, pa.float64())
        columns[f"{name}_stderr_noise"] = of_parameter("stderr_noise", name, pa.float64())
        columns[f"{name}_identifiable"] = of_parameter("identifiable", name, pa.bool_())
    for name in dict.fromkeys(x for record in records for x in record.get("traits", ())):
        columns[f"trait_{name}"] = of_parameter("traits", name, pa.float64())
        columns[f"trait_{name}_stderr"] = of_parameter("trait_stderr", name, pa.float64())
    return pa.table(columns)


def _each(warnings: Sequence[WarningOfRecord] | None, part: str) -> list[str] | None:
    """One part of every warning of a record; None for a record without a list of warnings."""
    return None if warnings is None else [warning[part] for warning in warnings]


def _parameter_names(records: Sequence[Record], taken: Container[str]) -> list[str]:
    """The parameters' names in the order of declaration; those that only images have come last."""
    used = dict.fromkeys(record["model"] for record in records if "values" in record)
    known = models()
    declared = [name for model in used if model in known for name in parameters(known[model])]
    found = [name for record in records for name in record.get("values", ())]
    # A column of every target, such as the pose's scale, is not replaced by a parameter of its name.
    return [name for name in dict.fromkeys([*declared, *found]) if name not in taken]
