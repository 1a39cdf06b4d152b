"""The tables of the controllers of a comparison: a study's own, those that it states, and those derived from its DSSC.

If a study does not give the gains of another controller, they follow from the article's correspondences (Table 2). PI
and SSC get the gains that DSSC synthesises at the origin. The STA, in its three sampled forms, gets kappa1 and kappa2
of the functions that approximate it, and the VGSTA also the smoothing delta. First-order sliding mode gets the gain
rho. Error pole and nominal control are DSSC's. A name may include a sampled form or a limit: ``sta_proper``,
``sta_limited``. A controller of one's own is named ``module:OBJECT``; error pole and nominal control are the study's,
its other gains have their defaults.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax

from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.controllers.dssc_forms import DsscGains, switching_gain
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in
from dssc_jax.study.components import lookup
from dssc_jax.study.correlation import correlated_names
from dssc_jax.study.fields import field_specs
from dssc_jax.study.laws import UncertainValue
from dssc_jax.study.tables import channel_table, merge_tables

ControllerTable = TomlTable
"""The ``[controller]`` table of a study file."""
LIMITED = "limited"
SINGLE = ""  # name of the channel of a plant that has only one
COMMON_GAINS = ("l0", "nominal")
"""Error pole and nominal control, which any controller may share with DSSC."""


class RivalName(NamedTuple):
    """The controller that a name in a comparison denotes.

    Args:
        kind: Kind of the controller.
        form: Its sampled form; empty: the default.
        limited: Whether its command is clipped to DSSC's rho.
    """

    kind: str
    form: str = ""
    limited: bool = False


def rival_names() -> dict[str, RivalName]:
    """All controllers that a comparison can name: each kind, each of its sampled forms, and with a limited command."""
    names = {}
    for kind, entry in CONTROLLERS.items():
        names[kind] = RivalName(kind)
        for form in entry.members:
            if form:  # None: the kind has only one
                names[f"{kind}_{form}"] = RivalName(kind, form=str(form))
        names[f"{kind}_{LIMITED}"] = RivalName(kind, limited=True)
    return names


def switching_kinds() -> list[str]:
    """Kinds of controller that declare a describing function: their switching sustains oscillations."""
    return [kind for kind, entry in CONTROLLERS.items() if entry.default_member.describing is not None]


def with_own_controllers(study: Study, names: Iterable[str]) -> Study:
    """The study with a table ``[compare.NAME]`` for each controller of a user's own, NAME being ``module:OBJECT``.

    A stored comparison then tells, like any study, which code it refers to. If the study has a ``[compare.NAME]``
    already, its gains are kept.

    Args:
        study: The study.
        names: Names of all controllers of the comparison.
    """
    added_tables = {}
    for name in names:
        stated_table = study.config.compare.get(name, {})
        is_own = ":" in name and name != controller_kinds(study)
        if is_own and "kind" not in stated_table:
            added_tables[name] = merge_tables({"kind": name, **common_gains(study, name)}, stated_table)
    if not added_tables:
        return study
    return study.override({"compare": {**study.config.compare, **added_tables}})


def controller_kinds(study: Study) -> str:
    """The kind of the study's controller, or the kinds of its channels if they differ, as one text."""
    kinds = dict.fromkeys(kind_in(study.config, "controller", channel) for channel in study.loop.channels)
    return ", ".join(kinds)


def common_gains(study: Study, name: str) -> ControllerTable:
    """The gains that the study's controller and a user's own controller have in common, by key.

    They are the error pole ``l0`` and the nominal control ``nominal``, as far as the user's controller has them. The
    gains of one channel are in a table under its name.

    Args:
        study: The study.
        name: The user's controller, ``module:OBJECT``.
    """
    controller = study.config.controller
    with errors_under(f"compare.{name}"):
        forms = lookup(name, CONTROLLERS).members
        own_controller = next(iter(forms.values()))  # its only form
        fields = field_specs(own_controller.params)
    common = [key for key in COMMON_GAINS if key in fields]
    gains = {key: controller[key] for key in common if key in controller}
    for channel in study.loop.channels:
        channel_gains = controller.get(channel, {})
        common_of_channel = {key: channel_gains[key] for key in common if key in channel_gains}
        if common_of_channel:
            gains[channel] = common_of_channel
    return gains


def controller_table(study: Study, name: str) -> ControllerTable:
    """The ``[controller]`` table of a controller in a comparison.

    The study's ``[compare.NAME]`` has priority. It is a whole controller if it states another kind than the study's.
    Otherwise it has changes: of the controller that NAME denotes without a table, where NAME is a kind, else of
    ``[controller]``.

    Args:
        study: The study.
        name: Name of the table, or kind of controller, optionally with a sampled form or ``limited`` to rho.

    Raises:
        ConfigError: There is no such controller, or its gains do not follow from the study's own.
    """
    stated_table = study.config.compare.get(name)
    if stated_table is None:
        return corresponding_table(study, name)
    controller = study.config.controller
    table = {key: value for key, value in stated_table.items() if key != "tune"}
    if "kind" not in table and name in rival_names():
        return table_with_changes(study, name, table)
    if table.get("kind", controller_kinds(study)) != controller_kinds(study):
        return table
    return merge_tables(controller, table)


def corresponding_table(study: Study, name: str) -> ControllerTable:
    """The table of a controller that has no ``[compare.NAME]``: the study's own, or derived from DSSC.

    A user's own controller has such a table; see :func:`with_own_controllers`.

    Raises:
        ConfigError: There is no such controller, or its gains do not follow from the study's own.
    """
    study_kind = controller_kinds(study)
    if name == study_kind:
        return dict(study.config.controller)
    names = rival_names()
    if name not in names:
        hint = nearest(name, [*names, *study.config.compare])
        raise ConfigError(f"compare.{name}", f"there is no such controller; {hint}")
    rival = names[name]
    is_study_kind = rival.kind == study_kind
    table = dict(study.config.controller) if is_study_kind else derive_table(study, name, rival.kind)
    if rival.limited:
        return with_limit(study, name, table)
    if rival.form:
        return {**table, "discretisation": rival.form}
    return table


def table_with_changes(study: Study, name: str, changes: ControllerTable) -> ControllerTable:
    """The table of a controller whose name states its kind, with the changes of a ``[compare.NAME]`` that states none.

    If the controller's gains do not follow from the study's own, the changes are all of its gains.

    Args:
        study: The study.
        name: A name of :func:`rival_names`.
        changes: The table ``[compare.NAME]``, which states no kind.

    Raises:
        ConfigError: The gains do not follow, and there are no changes, or a limited controller gets no limit.
    """
    rival = rival_names()[name]
    try:
        table = corresponding_table(study, name)
    except ConfigError:
        limit = CONTROLLERS[rival.kind].default_member.limit  # name of the gain that limits the command; empty: none
        if not changes or (rival.limited and not limit):
            raise
        if rival.limited and limit not in changes:
            raise ConfigError(f"compare.{name}.{limit}", "is required and missing") from None
        form = {"discretisation": rival.form} if rival.form else {}
        return {"kind": rival.kind, **form, **changes}
    if rival.kind != controller_kinds(study):  # each channel has all gains, so that common changes go to each
        channels = study.loop.channels
        common_changes = {key: value for key, value in changes.items() if key not in channels}
        for channel in channels:
            if channel in table:
                table[channel] = merge_tables(table[channel], common_changes)
    return merge_tables(table, changes)


def derive_table(study: Study, name: str, kind: str) -> ControllerTable:
    """Derive the gains of another kind of controller from the gains of the study's DSSC, channel by channel.

    Args:
        study: The study.
        name: Name of the controller in the comparison, for messages.
        kind: Kind of the controller.

    Raises:
        ConfigError: The gains do not follow from the study's own.
    """
    controller = study.config.controller
    from_dssc = CONTROLLERS[kind].default_member.from_dssc
    if from_dssc is None or not all(isinstance(gains, DsscGains) for gains in study.template.controller):
        raise ConfigError(
            f"compare.{name}", f"cannot be derived from '{controller_kinds(study)}'; give [compare.{name}]"
        )
    channels = study.loop.channels
    common = {key: value for key, value in controller.items() if key not in channels}
    tables = {}
    for channel, gains in zip(channels, study.template.controller, strict=True):
        try:
            require_numbers(gains)
            with jax.enable_x64(True):
                table = {"kind": kind, **from_dssc(gains)}
        except ConfigError as error:
            raise ConfigError(f"compare.{name}", f"{error.rule}; give [compare.{name}]") from None
        stated_gains = common if channel == SINGLE else channel_table(common, controller.get(channel, {}))
        tables[channel] = table | {key: stated_gains[key] for key in COMMON_GAINS if key in stated_gains}
    if SINGLE in tables:
        return tables[SINGLE]
    return {"kind": kind, **tables}


def require_numbers(gains: DsscGains) -> None:
    """Require that no parameter of DSSC's functions is uncertain, since a rival's gains are derived as numbers.

    Raises:
        ConfigError: A parameter has a law.
    """
    if any(isinstance(value, UncertainValue) for value in gains.functions):
        raise ConfigError("", "the functions hold a law, and a rival's gains are numbers")


def with_limit(study: Study, name: str, table: ControllerTable) -> ControllerTable:
    """The table of a controller with its command clipped to +-rho, the switching gain of the study's DSSC.

    Args:
        study: The study.
        name: Name of the controller in the comparison, for messages.
        table: The ``[controller]`` table without a limit.

    Raises:
        ConfigError: The controller has no limit, or rho is not constant.
    """
    limit = CONTROLLERS[table["kind"]].default_member.limit
    if not limit:
        limited_kinds = [kind for kind, entry in CONTROLLERS.items() if entry.default_member.limit]
        rule = f"'{table['kind']}' has no limit; these have one: {', '.join(limited_kinds)}"
        raise ConfigError(f"compare.{name}", rule)
    limits = {}
    for channel, gains in zip(study.loop.channels, study.template.controller, strict=True):
        if not isinstance(gains, DsscGains):
            raise ConfigError(f"compare.{name}", "rho is DSSC's; give [compare.NAME] with a limit")
        with errors_under(f"compare.{name}"):
            limits[channel] = {limit: switching_gain(gains)}
    return merge_tables(table, limits.get(SINGLE, limits))


def with_controller(study: Study, name: str, table: ControllerTable) -> Study:
    """The study with another controller and without its sweep.

    Args:
        study: The study.
        name: Name of the controller in the comparison, for messages.
        table: The ``[controller]`` table.

    Raises:
        ConfigError: The controller does not fit the study.
    """
    try:
        return study.override({"controller": table, "sweep": {}})
    except ConfigError as error:
        rule = missing_pair_rule(study, table) or str(error)
        raise ConfigError(f"compare.{name}", rule) from None


def missing_pair_rule(study: Study, table: ControllerTable) -> str:
    """The message for a controller that lacks a number which the study correlates with another; empty if it lacks none.

    Without the pair, the numbers of the other controllers would have other draws. So it is not left out silently.
    Args:
        study: The study.
        table: The ``[controller]`` table.
    """
    correlation = study.config.correlation
    try:
        free = study.override({"controller": table, "sweep": {}, "correlation": {}})
    except ConfigError:
        return ""
    for pair in correlation:
        for gain in correlated_names({pair: 0.0}):  # the names alone matter, no coefficient
            if gain not in free.laws:
                return (
                    f'has no uncertain number {gain}, which correlation."{pair}" ties to another, and all controllers '
                    "fly the same draws; take this pair out of [correlation] for the comparison (--set correlation={} "
                    "takes out all), or give the controller this gain with a law"
                )
    return ""


class Contestants(NamedTuple):
    """The controllers of a comparison, by name.

    Args:
        study: The study without its sweep, with a table ``[compare.NAME]`` for each controller of a user's own.
        tables: The ``[controller]`` table of each controller.
        studies: The study with each controller.
    """

    study: Study
    tables: dict[str, ControllerTable]
    studies: dict[str, Study]

    @classmethod
    def of(cls, study: Study, controllers: Sequence[str]) -> "Contestants":
        """Find the tables of the controllers with some names, and put each into the study.

        Args:
            study: The study; its sweep is ignored.
            controllers: Two different names or more.

        Raises:
            ConfigError: There are fewer, one is named twice or unknown, or a controller does not fit the study.
        """
        names = list(controllers)
        has_repetition = len(set(names)) < len(names)
        if has_repetition or len(names) < 2:
            raise ConfigError("controllers", f"needs two different names or more, got {', '.join(names) or 'none'}")
        study = with_own_controllers(study.without_sweep(), names)
        tables = {name: controller_table(study, name) for name in names}
        studies = {name: with_controller(study, name, table) for name, table in tables.items()}
        return cls(study, tables, studies)
