"""`petalfit studio`: a page in the browser on which petals are fitted."""

from typing import Annotated

from tyro.conf import arg

from petalfit.cli.options import Quiet
from petalfit.cli.status import SUCCESS, CommandError, require

Port = Annotated[
    int,
    arg(
        metavar="PORT",
        help="Port to listen on, on this computer only; if it is taken, the next free one is used.",
    ),
]
NoBrowser = Annotated[bool, arg(help="Print the address without opening a browser.")]


def studio(port: Port = 8090, no_browser: NoBrowser = False, quiet: Quiet = False) -> int:
    """Open a page in the browser to fit a petal, watch the fit, edit the result and download it."""
    require(1 <= port <= 65535, f"--port {port} is no port; give one from 1 to 65535.")
    try:
        import viser  # noqa: F401
    except ModuleNotFoundError:
        raise CommandError("the studio needs viser: pip install 'petalfit[studio]'") from None
    import threading
    import webbrowser

    from petalfit.cli.console import output
    from petalfit.studio import Studio

    running = Studio(port)
    if not quiet:
        output().print(f"{running.url}  (Ctrl-C ends it)", soft_wrap=True)
    if not no_browser:
        webbrowser.open(running.url)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        running.stop()
    return SUCCESS
