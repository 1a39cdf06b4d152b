"""Command that shows a page to explore: explore."""

from typing import Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, load_study, say


@app.command()
def explore(
    study: opt.StudyArgument,
    settings: opt.Set = None,
    sliders: Annotated[
        list[str] | None,
        typer.Option("--slider", metavar="NAME", help="Number to move, by dotted name; may be repeated."),
    ] = None,
    draws: Annotated[
        int | None, typer.Option("--draws", metavar="N", help="Number of draws [1000; 64 for a vehicle].")
    ] = None,
    port: Annotated[int, typer.Option("--port", metavar="P", min=0, max=65535, help="Port; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    allow_local: opt.Local = False,
) -> int:
    """Move a study's numbers and see its failures move: a page in the browser.

    Whenever a slider moves, all draws are simulated again: failure probability with interval, fans of the signals, and
    the worst draw. "Save" writes a study file that reproduces what is shown.

    The page is served to this machine only (127.0.0.1), under an address with a random token. Ctrl-C ends it.
    """
    from dssc_jax.exploration import require_panel

    require_panel()
    from dssc_jax.exploration.live import LiveStudy
    from dssc_jax.exploration.serving import PageServer
    from dssc_jax.exploration.study_page import StudyPage

    live = LiveStudy(load_study(study, settings, None, None, allow_local), sliders, draws)
    say(f"{live.base.name}: compiling")
    assert live.first  # compiled once for all pages
    server = PageServer(lambda: StudyPage(live, background=True), f"{live.base.name}: explore", port)
    print(server.url, flush=True)
    say("the page is served to this machine only; Ctrl-C ends it")
    if browser:
        import webbrowser

        webbrowser.open(server.url)
    server.serve()
    return DONE
