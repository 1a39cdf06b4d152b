"""The numbers of a fit that a flight does not identify, and that keep their laws."""

from collections.abc import Mapping

from dssc_jax.flight_logs.fit.refusals import NotIdentifiable


class UnidentifiedNumbers:
    """The numbers of a fit that keep their laws, while the fit seeks a set of numbers that the flight identifies.

    If a flight identifies only a combination of two numbers, one of them keeps its law. Trials show which one, so that
    the other becomes narrower than its law.
    """

    def __init__(self) -> None:
        self.kept: frozenset[str] = frozenset()
        self.widths: dict[str, float] = {}
        self.reasons = ""
        self._insensitive: set[str] = set()
        self._recovered: set[str] = set()
        self._last: str | None = None
        self._tried = {self.kept}

    @property
    def kept_widths(self) -> dict[str, float]:
        """The kept numbers, with the width that the flight leaves for each over that of its law."""
        return {name: width for name, width in self.widths.items() if name in self.kept}

    def update_insensitive(self, widths: Mapping[str, float]) -> bool:
        """Keep the laws of numbers on which the output hardly depends; return whether the set of kept numbers changes.

        At another minimum the output may depend on such a number after all. The number is then fitted again, but only
        once.

        Args:
            widths: All numbers on which the output hardly depends, with their widths, including those already kept.
        """
        before = self.kept
        recovered = self._insensitive - widths.keys() - self._recovered
        self._recovered |= recovered
        self._insensitive = (self._insensitive | widths.keys()) - recovered
        self.widths |= {name: width for name, width in widths.items() if name not in self.kept}
        self._keep((self.kept - recovered).union(widths))
        return self.kept != before

    def add(self, name: str, refusal: NotIdentifiable) -> None:
        """Keep the law of a number from a combination that is not identified.

        The number replaces the one that was added before it. If the resulting set has been tried already, both keep
        their laws.

        Args:
            name: The number.
            refusal: The refusal that names it, with its width and reasons.
        """
        self.widths[name] = refusal.width
        self.reasons = refusal.reasons
        exchanged = (self.kept - {self._last}) | {name}
        self._keep(self.kept | {name} if exchanged in self._tried else exchanged)
        self._last = name

    def _keep(self, names: frozenset[str]) -> None:
        self.kept = names
        self._tried.add(names)
