"""Server of the explorer's page: of this machine alone, until the page is closed."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Callable
from typing import Any

from xcg.common.checks import extra

ADDRESS = "127.0.0.1"
CLOSED = 10_000  # milliseconds without a connection, after which a page counts as closed
STOPPED = (
    "The server has stopped: this page no longer changes. Start it again and open its new page."
)


def serve(page: Callable[[], Any], port: int = 0, show: bool = True) -> None:
    """Serve a page to this machine alone, until it is closed.

    Parameters
    ----------
    page : callable
        Returns what is shown, anew for each visitor.
    port : int
        Port at 127.0.0.1; 0 takes a free one.
    show : bool
        Open the page in the browser.

    Raises
    ------
    ImportError
        If Panel is not installed.
    OSError
        If the port is taken, or not allowed to this user.
    """
    pn = extra("panel", "explore", "explore")
    pn.extension(notifications=True, disconnect_notification=STOPPED)
    try:
        server = pn.serve(
            page,
            address=ADDRESS,
            port=port,
            start=False,
            show=False,
            verbose=False,
            title="xcg explore",
            unused_session_lifetime_milliseconds=CLOSED,
            check_unused_sessions_milliseconds=CLOSED // 10,
        )
    except OSError as error:
        raise OSError(
            f"port {port} at {ADDRESS} cannot be used ({error.strerror or error}): give another one, "
            "or leave out --port, which takes a free one"
        ) from error
    address = f"http://{ADDRESS}:{server.port}"

    def stop_without_pages(session: Any) -> None:
        if all(other.id == session.id for other in server.get_sessions()):
            server.io_loop.add_callback(server.io_loop.stop)

    pn.state.on_session_destroyed(stop_without_pages)
    sys.stderr.write(f"{address} (close the page, or press Ctrl-C, to end)\n")
    if show:
        server.io_loop.add_callback(webbrowser.open, address)
    server.run_until_shutdown()
