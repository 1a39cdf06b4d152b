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
    """All names that a comparison can use, with the controller of each.

    A name is a kind (``sta``), a kind with a sampled form (``sta_proper``), or a kind with ``limited``
    (``sta_limited``).
    """
    names = {}
    for kind, entry in CONTROLLERS.items():
        names[kind] = RivalName(kind)
        for form in entry.members:
            if form:  # a kind with a single sampled form has no name for the form
                names[f"{kind}_{form}"] = RivalName(kind, form=str(form))
        names[f"{kind}_{LIMITED}"] = RivalName(kind, limited=True)
    return names


def switching_kinds() -> list[str]:
    """Kinds of controllers that declare a describing function, because their switching sustains oscillations."""
    return [kind for kind, entry in CONTROLLERS.items() if entry.default_member.describing is not None]


def with_own_controllers(study: Study, names: Iterable[str]) -> Study:
    """Add a table ``[compare.NAME]`` to the study for each controller of a user's own, named ``module:OBJECT``.

    The stored study then names all code that the comparison refers to. If the study already has a ``[compare.NAME]``
    without ``kind``, the added table keeps its gains.

    Args:
        study: The study.
        names: Names of all controllers of the comparison; only those with a colon are a user's own.
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
    """The kind of the study's controller as a text; the kinds joined by commas if channels have different ones."""
    kinds = dict.fromkeys(kind_in(study.config, "controller", channel) for channel in study.loop.channels)
    return ", ".join(kinds)


def common_gains(study: Study, name: str) -> ControllerTable:
    """The study's error pole ``l0`` and nominal control ``nominal``, for a user's own controller that has such gains.

    The gains are returned by key. Gains that the study states for one channel are in a table under the channel's name.

    Args:
        study: The study.
        name: The user's controller, ``module:OBJECT``.
    """
    controller = study.config.controller
    with errors_under(f"compare.{name}"):
        forms = lookup(name, CONTROLLERS).members
        own_controller = next(iter(forms.values()))  # a user's own controller has only one form
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

    Without a table ``[compare.NAME]`` in the study, the name denotes a controller of :func:`corresponding_table`. If
    the study has such a table, there are three cases:

    * The table has no ``kind``, and NAME is in :func:`rival_names`: the table changes gains of that controller.
    * The table has another kind than the study's controller: the table is the whole controller.
    * Otherwise the table changes gains of the study's ``[controller]``.

    Args:
        study: The study.
        name: NAME of a table ``[compare.NAME]``, or a name of :func:`rival_names`.

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
    """The ``[controller]`` table that a name denotes by itself: the study's own, or one derived from DSSC.

    A table ``[compare.NAME]`` of the study is not read here.

    Args:
        study: The study.
        name: The kind of the study's controller, or a name of :func:`rival_names`. Any other controller of a user's own
            has a table ``[compare.NAME]``, which :func:`with_own_controllers` adds.

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
    """The table of a controller whose name states its kind, with the changes that ``[compare.NAME]`` makes.

    If the controller's gains cannot be derived from the study's own, the changes have to state all of its gains.

    Args:
        study: The study.
        name: A name of :func:`rival_names`.
        changes: The table ``[compare.NAME]``, which states no kind.

    Raises:
        ConfigError: The gains cannot be derived, and either ``changes`` is empty, or it lacks the limit of a
            controller whose name says ``limited``.
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
        kind: Kind of the controller that gets the gains.

    Raises:
        ConfigError: The study's controller is not DSSC, the other kind has no rule for its gains, or DSSC's functions
            have uncertain parameters.
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
    """Require that no parameter of DSSC's functions is uncertain, since the gains derived from them are plain numbers.

    Args:
        gains: The gains of one channel's DSSC.

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
    """The error message if a controller lacks a number that ``[correlation]`` names; otherwise an empty string.

    Such a pair of correlated numbers is not dropped silently, since the other controllers would then get other draws.

    Args:
        study: The study.
        table: The ``[controller]`` table of the controller.
    """
    correlation = study.config.correlation
    try:
        free = study.override({"controller": table, "sweep": {}, "correlation": {}})
    except ConfigError:
        return ""
    for pair in correlation:
        for gain in correlated_names({pair: 0.0}):  # only the names matter, so any coefficient will do
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
        """Find the table of each named controller, and put each into the study.

        Args:
            study: The study; its sweep is ignored.
            controllers: Names of the controllers, at least two and all different.

        Raises:
            ConfigError: There are fewer than two names, a name is repeated or unknown, or a controller does not fit
                the study.
        """
        names = list(controllers)
        has_repetition = len(set(names)) < len(names)
        if has_repetition or len(names) < 2:
            raise ConfigError("controllers", f"needs two different names or more, got {', '.join(names) or 'none'}")
        study = with_own_controllers(study.without_sweep(), names)
        tables = {name: controller_table(study, name) for name in names}
        studies = {name: with_controller(study, name, table) for name, table in tables.items()}
        return cls(study, tables, studies)
