"""Who may connect: only pages of the studio itself, under this computer's own names.

A page of another origin can open a WebSocket to a server on this computer, and by DNS rebinding it can
call itself by a name that leads here. A browser says in `Origin` which page asks, and in `Host` under
which name; neither can be forged by a page. The port may be another one, for a tunnel.
"""

from __future__ import annotations

import http
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio import server

_NAMES = ("127.0.0.1", "localhost", "::1")


@contextmanager
def own_pages_only() -> Iterator[None]:
    """Makes servers that are started in a block refuse requests of other origins and under other names.

    viser offers no way to look at a request, so the function with which it starts its server is wrapped.
    """
    serve = server.serve

    def guarded(*arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            headers = request.headers
            reason = refusal(headers.get_all("Host"), headers.get_all("Origin"))
            if reason:
                return connection.respond(http.HTTPStatus.FORBIDDEN, reason)
            response = process_request(connection, request)
            if response is not None:
                response.headers["X-Frame-Options"] = "DENY"
            return response

        return serve(*arguments, process_request=answer, **options)

    server.serve = guarded  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        server.serve = serve


def refusal(hosts: list[str], origins: list[str]) -> str:
    """Why a request with these headers is refused, in a sentence; "" if it is not."""
    try:
        name = urlsplit(f"//{hosts[0]}").hostname if len(hosts) == 1 else None
    except ValueError:
        name = None
    if name not in _NAMES:
        return "The studio answers only under the name 127.0.0.1 or localhost.\n"
    if origins and origins != [f"http://{hosts[0]}"]:
        return "The studio answers only to its own pages.\n"
    return ""
