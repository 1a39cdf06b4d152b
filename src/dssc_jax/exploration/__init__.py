"""Explore a study or a result: in the browser by a local page, in a notebook by the same page as an object.

Needs the extra ``explore`` (Panel and Bokeh), which no other layer imports.
"""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

from dssc_jax.core.errors import ConfigError
from dssc_jax.study import Study

if TYPE_CHECKING:
    from dssc_jax.exploration.study_page import StudyPage

__all__ = ["explore", "require_panel"]


def require_panel() -> None:
    """Check that what the pages need is installed.

    Raises:
        ConfigError: It is not.
    """
    for name in ("panel", "bokeh"):
        if find_spec(name) is None:
            raise ConfigError("explore", f"needs {name}: pip install 'dssc_jax[explore]'")


def explore(study: Study, *, sliders: Sequence[str] | None = None, draws: int | None = None) -> "StudyPage":
    """A page on which moving a number of a study shows its failures, fans of signals and worst draw anew.

    A notebook shows it as the value of a cell. A program moves its sliders by ``move``.

    Args:
        study: The study.
        sliders: Dotted names of the numbers to move; None: the swept ones, gains, unmodelled dynamics and laws.
        draws: Number of draws; None: 1,000, for a vehicle 64.

    Returns:
        The page: ``move({name: value})``, ``now`` (the run that is shown), ``before``, ``save_as(name)``.

    Raises:
        ConfigError: The extra is not installed, a number cannot be moved, or the number of draws is not admissible.
    """
    require_panel()
    import panel as pn

    from dssc_jax.exploration.live import LiveStudy
    from dssc_jax.exploration.study_page import StudyPage

    pn.extension()
    return StudyPage(LiveStudy(study, sliders, draws))
