"""Command that shows a page to explore: explore."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, load_result, load_study, say
from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.study import Study


@app.command()
def explore(
    subject: Annotated[str, typer.Argument(metavar="STUDY|RESULT", help="A study, or the folder of a run or sweep.")],
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
    trust_code: opt.TrustCode = False,
    allow_local: opt.Local = False,
) -> int:
    """Move a study's numbers and see its failures move, or brush a result's draws: a page in the browser.

    For a study, all draws are simulated again whenever a slider moves: failure probability with interval, fans of the
    signals, and the worst draw. "Save" writes a study file that reproduces what is shown. For a result, brushed draws
    are counted, and a click on a draw simulates it again.

    The page is served to this machine only (127.0.0.1), under an address with a random token. Ctrl-C ends it.
    """
    from dssc_jax.exploration import require_panel

    require_panel()
    if Path(subject).is_dir():
        require_unset("a result", {"--set": settings, "--slider": sliders, "--draws": draws})
        name, make = result_pages(Path(subject), trust_code, allow_local)
    else:
        name, make = study_pages(load_study(subject, settings, None, None, allow_local), sliders, draws)
    from dssc_jax.exploration.serving import PageServer

    try:
        server = PageServer(make, f"{name}: explore", port)
    except OSError as error:
        rule = f"cannot serve at port {port} of this machine ({error.strerror}); 0 takes any free one"
        raise ConfigError("--port", rule) from None
    print(server.url, flush=True)
    say("the page is served to this machine only; Ctrl-C ends it")
    with server.opened_in_browser() if browser else nullcontext():
        server.serve()
    return DONE


def require_unset(what: str, given: dict[str, Any]) -> None:
    """Require that options without a meaning here are not given."""
    for option, value in given.items():
        if value:
            raise ConfigError(option, f"has no meaning with {what}")


def study_pages(study: "Study", sliders: list[str] | None, draws: int | None) -> tuple[str, Callable[[], Any]]:
    """The name of a study, and what makes its pages; all of them use the same compiled program."""
    from dssc_jax.exploration.live import LiveStudy
    from dssc_jax.exploration.study_page import StudyPage

    live = LiveStudy(study, sliders, draws)
    say(f"{study.name}: compiling")
    live.compile()
    return study.name, lambda: StudyPage(live, background=True)


def result_pages(folder: Path, trust_code: bool, local: bool) -> tuple[str, Callable[[], Any]]:
    """The name of a result's study, and what makes its pages."""
    from dssc_jax.exploration.result_page import ResultPage

    result = load_result(folder, trust_code, local)
    return result.study.name, lambda: ResultPage(result, background=True)
