"""Pages to explore a study or a result: served to the browser, or as an object in a notebook.

The pages need the extra ``explore`` (Panel and Bokeh), which no other layer imports.
"""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.live import LiveStudy
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.results.result import Result
from dssc_jax.study import Study

if TYPE_CHECKING:
    from dssc_jax.exploration.result_page import ResultPage
    from dssc_jax.exploration.study_page import StudyPage

__all__ = ["explore", "require_panel"]


def require_panel() -> None:
    """Require that Panel and Bokeh are installed.

    Raises:
        ConfigError: One of them is not installed.
    """
    for name in ("panel", "bokeh"):
        if find_spec(name) is None:
            raise ConfigError("explore", f"needs {name}: pip install 'dssc_jax[explore]'")


def explore(
    subject: Study | Result,
    *,
    sliders: Sequence[str] | None = None,
    draws: int | None = None,
    logs: Sequence[FlightLog] = (),
) -> "StudyPage | ResultPage":
    """Make a page on which the numbers of a study are moved, or the draws of a result are brushed and replayed.

    When a number of a study moves, the study's failures, fans of signals and worst draw follow. A notebook shows the
    page as the value of a cell. A program moves sliders by ``move``, and shows a result's draws by ``replay``.

    Args:
        subject: A study, or the result of a run or a sweep.
        sliders: For a study, dotted names of the numbers to move; None: the swept ones, gains, unmodelled dynamics and
            laws.
        draws: For a study, number of draws; None: 1,000, or 64 for a vehicle.
        logs: For a study, logged flights, see :func:`dssc_jax.read_log`. The page compares a single flight with the
            draws, see :func:`dssc_jax.compare_log`; from several it predicts the next one, see
            :func:`dssc_jax.next_flight`.

    Returns:
        The page. The page of a study has ``move({name: value})``, ``now`` (the run that is shown), ``before`` and
        ``save_as(name)``. The page of a result has ``replay(row)``, ``flight`` and ``pin_draw()``.

    Raises:
        ConfigError: The extra is not installed, a number cannot be moved, the number of draws is not admissible, or an
            argument for a study is given with a result.
    """
    require_panel()
    import panel as pn

    pn.extension()
    if isinstance(subject, Result):
        if sliders is not None or draws is not None or logs:
            raise ConfigError("explore", "`sliders`, `draws` and `logs` are for a study; a result has its own draws")
        from dssc_jax.exploration.result_page import ResultPage

        return ResultPage(subject)
    from dssc_jax.exploration.study_page import StudyPage

    return StudyPage(LiveStudy(subject, sliders, draws), logs=logs)
