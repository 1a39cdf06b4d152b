"""dssc-jax explore: a page in the browser on a study or a result."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

from dssc_jax.cli.declarations.simulation import Explore
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import load_study, stored_result
from dssc_jax.cli.logs import logged_flight
from dssc_jax.cli.output import say
from dssc_jax.cli.parsing import parse_changes, require_unset
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration import require_panel
from dssc_jax.exploration.live import LiveStudy
from dssc_jax.exploration.page import Page
from dssc_jax.exploration.result_page import ResultPage
from dssc_jax.exploration.serving import PageServer
from dssc_jax.exploration.study_page import StudyPage


def run(options: Explore) -> int:
    """Serve the page until Ctrl-C."""
    require_panel()
    folder = Path(options.subject)
    server = result_server(folder, options) if folder.is_dir() else study_server(options)
    print(server.url, flush=True)
    say("the page is served to this machine only; Ctrl-C ends it")
    with server.opened_in_browser() if options.browser else nullcontext():
        server.serve()
    return DONE


def result_server(folder: Path, options: Explore) -> PageServer:
    """Load the result in a folder, and return the server of its page.

    Raises:
        ConfigError: The result cannot be loaded, or an option has no meaning with a result.
    """
    study_options = {"set": options.settings, "slider": options.sliders, "draws": options.draws, "log": options.logs}
    require_unset("with a result", **study_options, **log_options(options))
    result = stored_result(folder, options.trust_code, options.allow_local, options.allow_native)
    title = f"{result.study.name}: explore"
    return page_server(lambda: ResultPage(result, background=True), title, options.port)


def study_server(options: Explore) -> PageServer:
    """Load and compile the study, and return the server of its page.

    Raises:
        ConfigError: The study or a log cannot be loaded, or an option on logs is given without a log.
    """
    study = load_study(options.subject, parse_changes(options.settings), options.allow_local, options.allow_native)
    if not options.logs:
        require_unset("without --log", **log_options(options))
    logs = [logged_flight(options, path, study) for path in options.logs or []]
    live = LiveStudy(study, options.sliders, options.draws)
    say(f"{study.name}: compiling")
    live.compile()
    title = f"{study.name}: explore"
    return page_server(lambda: StudyPage(live, background=True, logs=logs), title, options.port)


def log_options(options: Explore) -> dict[str, object]:
    """Values of the options on how a log is read, by name."""
    return {
        "columns": options.columns,
        "column": options.column,
        "start": options.start,
        "segment": options.segment,
    }


def page_server(make_page: Callable[[], Page], title: str, port: int) -> PageServer:
    """Return the server of a page, which does not serve yet.

    Args:
        make_page: Makes the page of each session.
        title: Title of the page.
        port: The port; 0: any free port.

    Raises:
        ConfigError: The port cannot be used.
    """
    try:
        return PageServer(make_page, title, port)
    except OSError as error:
        rule = f"cannot serve at port {port} of this machine ({error.strerror}); 0 takes any free one"
        raise ConfigError("--port", rule) from None
