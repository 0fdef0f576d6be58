"""`petalfit parameters`: a list of the parameters of a model."""

from typing import Annotated

from tyro.conf import Positional, arg

from petalfit.cli.status import SUCCESS, require

Model = Annotated[
    Positional[str | None],
    arg(metavar="MODEL", help="Name of a component; the default is a peony petal."),
]


def parameters(model: Model = None) -> int:
    """List the parameters of a model."""
    from rich import box
    from rich.table import Table

    from petalfit.cli.console import output
    from petalfit.cli.models import kind_of
    from petalfit.components import parameters as declared
    from petalfit.surfaces import value_at

    kind = kind_of(model)
    require(kind != "auto", "auto is no component; name one of those that it tries.")
    assert not isinstance(kind, str)
    one = kind()
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False, padding=(0, 1, 0, 0))
    for heading in ("name", "symbol", "unit"):
        table.add_column(heading)
    table.add_column("default", justify="right")
    table.add_column("range\ntypical", justify="right")
    table.add_column("meaning")
    for name, parameter in declared(kind).items():
        unit = "" if parameter.unit == "1" else parameter.unit
        meaning = parameter.meaning + (" (fixed unless freed)" if parameter.fixed else "")
        spans = (f"{low:g} to {high:g}" for low, high in (parameter.bounds, parameter.typical))
        table.add_row(
            name, parameter.symbol, unit, f"{value_at(one, name):g}", "\n".join(spans), meaning
        )
    output().print(table)
    return SUCCESS
