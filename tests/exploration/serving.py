"""A server of a page in a thread, for tests."""

import asyncio
import threading
from contextlib import contextmanager

from dssc_jax.exploration.serving import PageServer


@contextmanager
def serving(make):
    """A server in a thread, as the command has it in the process."""
    started, servers = threading.Event(), []

    def serve():
        asyncio.set_event_loop(asyncio.new_event_loop())
        servers.append(PageServer(make, "explore"))
        started.set()
        servers[0].serve()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    assert started.wait(60)
    try:
        yield servers[0]
    finally:
        servers[0].stop()
        thread.join(60)
