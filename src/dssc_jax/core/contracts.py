"""The contracts that models implement: types of plants, controllers, references, sensors and disturbances.

A model is a ``NamedTuple`` of pure functions for one draw, without a batch axis, and the ``NamedTuple`` type of its
parameters. It is chosen before tracing; its parameters, each annotated with a ``Quantity``, may be traced.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Generic, NamedTuple, TypeAlias, TypeVar

import jax

from dssc_jax.core.default_functions import (
    ignore_sample,
    never,
    never_broken,
    never_grounded,
    no_constraint,
    no_info,
    no_signals,
    unchanged_params,
)
from dssc_jax.core.estimation import Estimation
from dssc_jax.core.harmonic_balance import HarmonicBalance
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.onboard import Onboard
from dssc_jax.core.outside_state import Begin
from dssc_jax.core.quantities import quantities_of
from dssc_jax.core.sampled_linear import LinearDynamics, LinearSystem, Moments
from dssc_jax.core.setting import LoopSetting
from dssc_jax.core.signals import (
    Command,
    Info,
    LastChange,
    Measurement,
    Measurements,
    Params,
    PlantInput,
    ReferencePoint,
    ReferencePoints,
    Scalar,
    Signal,
    State,
)
from dssc_jax.core.smoothness import Declaration
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import ChannelUnits
from dssc_jax.core.vectors import Vec3

Output = TypeVar("Output", bound=Measurement | Measurements)
Desired = TypeVar("Desired", bound=ReferencePoint | ReferencePoints)


class NoParams(NamedTuple):
    """The parameters of a model that has no parameters."""


class Plant(NamedTuple, Generic[Output, Signal]):
    """A plant of relative degree two from each command to its output.

    A plant with several channels (MIMO, such as the UAV) lists their names; its measurement, input gain and input are
    tuples in that order. For a plant with one channel (SISO) they are plain values.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params) -> state`` at t = 0.
        derivative: ``(params, state, input, t) -> state'``, the same structure as the state.
        measure: ``(params, state, input) -> Measurement``. At a sample, ``input`` is the input just before the sample:
            the commands that reach the plant, the disturbances and the wind. So a y' that depends on the input (a load
            current in v') can be the derivative that a sensor shows. Commands and disturbances of ``input`` are 0 at an
            equilibrium, and where the measurement serves to evaluate a disturbance that depends on it.
        input_gain: ``(params) -> k_p``, the high-frequency gain from command to y''.
        velocities: Names of the state's fields that semi-implicit Euler advances first.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        channels: Names of the channels; empty for a plant with one channel.
        angles: Channels whose output is an angle [rad]; the loop wraps the errors of these to (-pi, pi].
        units: Units and meanings of each channel's output and command; without them, results show the symbols y and u.
        project: ``(params, state) -> state`` after each integrator step, back onto the state's manifold.
        monitor: ``(params, state, input) -> info`` at each sample, a NamedTuple for metrics and plots.
        broken: ``(params, state) -> bool``: whether the model is no longer valid (a singular attitude), which ends the
            draw.
        grounded: ``(params, state, input, t, dt) -> bool``: whether the plant hits the ground in the sample that begins
            with this state; the constant False: the model has no ground.
        linear: ``(params) -> LinearDynamics``: the plant's linear part, which the loop advances by its exact solution.
            None: the loop integrates ``derivative`` by its fixed-step method.
        remainder: ``(params, state, input, t) -> state'``: what ``derivative`` adds to the linear part, as plain 0.0
            where it adds nothing. None: the plant is linear.
        onboard: Names, in words, of the parts of the plant that are software of the vehicle; the generated code of the
            controllers does not contain them.
        smooth: Where the plant has a derivative (:mod:`dssc_jax.core.smoothness`); None: linearisations refuse it.
        info: NamedTuple type of what ``monitor`` reports. Fields annotated with a ``Quantity`` have its unit and
            meaning in trajectories; the others have none.
        outputs: ``(params) -> signals`` that ``monitor`` reports, for a plant whose table names them; None: the fields
            of ``info`` declare them.
        inputs: ``(params) -> signals``: further disturbance inputs beside the one of each channel. Every call gets a
            value for each of them in ``input.inputs``, in this order, 0 where nothing acts. None: there are none.
        software: Sampled software on board, which runs between two samples of the loop; None: there is none.
        estimation: Sensors and estimator on board, through which the controllers see; None: there are none.
        advance: ``(params, state, input, t, h) -> state`` after a step of length h [s] with constant input, for a plant
            with a solver of its own; None: the loop integrates ``derivative``.
        begin: See :data:`~dssc_jax.core.outside_state.Begin`; None: the plant keeps no state outside of JAX.
        native: File of the native code that the plant calls, which has no derivative; empty: the plant is all JAX.
        settle: ``(params, state, wind) -> state`` at t = 0, from the state of ``init``: in equilibrium with the mean
            wind at the start [m/s] if the parameters ask for it. Not called without a wind. None: the plant starts in
            the state of ``init`` in any wind.
        flies: Whether the plant is a vehicle that reads ``input.wind``; with several channels, these are x, y, z and
            psi. A plant that does not fly has neither a wind nor the vehicle's references.
    """

    params: type
    init: Callable[[Params], State]
    derivative: Callable[[Params, State, PlantInput[Signal], Scalar], State]
    measure: Callable[[Params, State, PlantInput[Signal]], Output]
    input_gain: Callable[[Params], Signal]
    velocities: tuple[str, ...] = ()
    prepare: Callable[[Params], Params] = unchanged_params
    channels: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    units: tuple[ChannelUnits, ...] = ()
    project: Callable[[Params, State], State] = no_constraint
    monitor: Callable[[Params, State, PlantInput[Signal]], Info] = no_info
    broken: Callable[[Params, State], Scalar | bool] = never_broken
    grounded: Callable[[Params, State, PlantInput[Signal], Scalar, Scalar], Scalar | bool] = never_grounded
    linear: Callable[[Params], LinearDynamics] | None = None
    remainder: Callable[[Params, State, PlantInput[Signal], Scalar], State] | None = None
    onboard: tuple[str, ...] = ()
    smooth: Declaration = None
    info: type | None = None
    outputs: Callable[[Params], tuple[NamedSignal, ...]] | None = None
    inputs: Callable[[Params], tuple[NamedSignal, ...]] | None = None
    software: Onboard | None = None
    estimation: Estimation | None = None
    advance: Callable[[Params, State, PlantInput[Signal], Scalar, float], State] | None = None
    begin: Begin | None = None
    native: str = ""
    settle: Callable[[Params, State, Vec3], State] | None = None
    flies: bool = False

    def reported(self, params: Params) -> tuple[NamedSignal, ...]:
        """Return the declared signals that ``monitor`` reports with these parameters.

        ``outputs`` declares them or, if it declares none, the fields of ``info`` do. A field without a unit and meaning
        declares no signal, and is left out.
        """
        declared_in_table = self.outputs(params) if self.outputs else ()
        if declared_in_table:
            return declared_in_table
        return tuple(NamedSignal.of(name, quantity) for name, quantity in quantities_of(self.info).items())


class Preset(NamedTuple):
    """A part of a study whose table overrides the fields of a complete instance.

    Args:
        params: NamedTuple type of the parameters.
        defaults: The instance.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
    """

    params: type
    defaults: Params
    prepare: Callable[[Params], Params] = unchanged_params


class Controller(NamedTuple):
    """A sampled controller.

    Args:
        gains: NamedTuple type of the gains; must have the field ``l0``.
        init: ``(gains, measurement, reference) -> state`` from the first sample.
        step: ``(gains, state, measurement, reference, dt) -> (state, command, info)``. ``info`` is a NamedTuple of
            scalars for metrics and plots, and is never fed back.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        transfer: ``(gains, measurement, reference, command, dt) -> state`` for a bumpless start: the first step from
            this state gives ``command``. None: the controller has no such state.
        smooth: Where it has a derivative (:mod:`dssc_jax.core.smoothness`); None: linearisations refuse it.
        synthesised: ``(gains) -> (K_P, K_I)`` of the law u = -K_P sigma - K_I int sigma (22) near the origin; None: the
            controller synthesises no such law.
        describing: ``(gains) -> HarmonicBalance``, the describing function of a switching law; None: it is not known.
        takes: ``(gains) -> n``: number of measured signals that the controller takes from ``measurement.signals``; 0:
            only y and y'.
        signals: The measured signals that the controller takes by name, in its own order; (): all signals of the study,
            in the study's order.
        fit: ``(gains, LoopSetting) -> gains`` when the study is built: computes gains from the nominal plant and the
            sample time, or checks them; raises ConfigError. None: the gains need neither.
        tunable: Names of the gains that a comparison tunes, dotted within the controller's table, or a function from
            the gains to these names. Empty: a comparison tunes only what ``[compare.NAME.tune]`` names.
        from_dssc: ``(gains of DSSC) -> table`` of this controller that corresponds to them; None: a comparison needs
            ``[compare.NAME]``.
        limit: Name of the gain that bounds the command; empty: there is none.
        info: NamedTuple type of the info. Fields annotated with a ``Quantity`` have its unit and meaning in
            trajectories; the others have none.
        native: File of the native code that it calls, which has no derivative; empty: the controller is all JAX.
        begin: See :data:`~dssc_jax.core.outside_state.Begin`; None: the controller keeps no state outside of JAX.
        takes_rate: Whether the command depends on y'; None: the package finds out by trial steps.
        without_effect: Names of the parameters of native code whose change altered no command in trial flights.
    """

    gains: type
    init: Callable[[Params, Measurement, ReferencePoint], State]
    step: Callable[[Params, State, Measurement, ReferencePoint, Scalar], tuple[State, Command, Info]]
    prepare: Callable[[Params], Params] = unchanged_params
    transfer: Callable[[Params, Measurement, ReferencePoint, Scalar, Scalar], State] | None = None
    smooth: Declaration = None
    synthesised: Callable[[Params], tuple[Scalar, Scalar]] | None = None
    describing: Callable[[Params], HarmonicBalance] | None = None
    takes: Callable[[Params], int] = no_signals
    signals: tuple[NamedSignal, ...] = ()
    fit: Callable[[Params, LoopSetting], Params] | None = None
    tunable: tuple[str, ...] | Callable[[Params], tuple[str, ...]] = ()
    from_dssc: Callable[[Params], TomlTable] | None = None
    limit: str = ""
    info: type | None = None
    native: str = ""
    begin: Begin | None = None
    takes_rate: bool | None = None
    without_effect: tuple[str, ...] = ()

    def tunable_gains(self, gains: Params) -> tuple[str, ...]:
        """Return the names of the gains that a comparison tunes, dotted within the controller's table."""
        return self.tunable(gains) if callable(self.tunable) else self.tunable

    @property
    def params(self) -> type:
        """The type of the gains, under the name that all models share."""
        return self.gains


class Reference(NamedTuple, Generic[Desired]):
    """A desired trajectory.

    Args:
        params: NamedTuple type of the parameters.
        at: ``(params, t) -> ReferencePoint``; for several channels, a tuple with a point for each.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        defaults: Instance of the parameters with the values of the fields that a table leaves out; None: the type's
            own defaults hold.
        level: ``(params) -> y`` of a reference of one channel: the constant about which the reference moves or at which
            it ends; None: 0.
        of_angle: The reference in place of this one for an output that is an angle, such as one that takes the shorter
            way from value to value; None: this reference serves all outputs.
        last_change: Time from which the reference does nothing new; None: ``[loop.settled]`` refuses it.
    """

    params: type
    at: Callable[[Params, Scalar], Desired]
    prepare: Callable[[Params], Params] = unchanged_params
    defaults: Params = None
    level: Callable[[Params], Scalar] | None = None
    of_angle: "Reference[Desired] | None" = None
    last_change: LastChange | None = None


class Variation(StrEnum):
    """Variables on which a disturbance depends within a sample; they select the method of integration.

    The members are in rising order of dependence.
    """

    HELD = "held"  # none: the disturbance is constant from sample to sample
    TIME = "time"  # time alone
    STATE = "state"  # time and the plant's state


class Disturbance(NamedTuple):
    """A matched disturbance d(y, y', t), in the unit of the command [u].

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, key) -> state``.
        step: ``(params, state, key, t, dt) -> state`` at each sample: what is held over [t, t + dt).
        value: ``(params, state, measurement, sigma, t) -> d``, evaluated in every stage of the integrator.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        variation: Variables on which ``value`` depends within a sample.
        smooth: Where ``value`` has a derivative (:mod:`dssc_jax.core.smoothness`); None: linearisations refuse it.
        last_change: Time from which the disturbance does nothing new; None: ``[loop.settled]`` refuses it.
    """

    params: type
    init: Callable[[Params, jax.Array], State]
    step: Callable[[Params, State, jax.Array, Scalar, Scalar], State]
    value: Callable[[Params, State, Measurement, Scalar, Scalar], Scalar]
    prepare: Callable[[Params], Params] = unchanged_params
    variation: Variation = Variation.STATE
    smooth: Declaration = None
    last_change: LastChange | None = None


class Sensor(NamedTuple):
    """A sensor between one channel of the plant and its controller.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, measurement, key) -> state`` from the first true measurement.
        step: ``(params, state, measurement, key, t, dt) -> (state, measurement)`` at each sample.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        smooth: Where it has a derivative (:mod:`dssc_jax.core.smoothness`); None: linearisations refuse it.
        transparent: ``(params) -> bool``: whether the sensor passes y and y' on at once, but for noise, constant errors
            and rounding. The continuous-time analysis leaves out every sensor, and names those not transparent.
        resolution: ``(params) -> step`` of which the readings of y are multiples, or None; None: they are not rounded.
    """

    params: type
    init: Callable[[Params, Measurement, jax.Array], State]
    step: Callable[[Params, State, Measurement, jax.Array, Scalar, Scalar], tuple[State, Measurement]]
    prepare: Callable[[Params], Params] = unchanged_params
    smooth: Declaration = None
    transparent: Callable[[Params], bool] = never
    resolution: Callable[[Params], Scalar | None] | None = None


class Differentiator(NamedTuple):
    """A differentiator between sensor and controller: it estimates y' if only y is measured.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, measurement) -> state`` from the first measurement, of which only y may be used.
        step: ``(params, state, measurement, dt) -> (state, measurement)`` at each sample.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        smooth: Where it has a derivative (:mod:`dssc_jax.core.smoothness`); None: linearisations refuse it.
        transparent: ``(params) -> bool``: whether the differentiator passes y and y' on at once. The continuous-time
            analysis leaves out every differentiator, and names those that are not transparent.
    """

    params: type
    init: Callable[[Params, Measurement], State]
    step: Callable[[Params, State, Measurement, Scalar], tuple[State, Measurement]]
    prepare: Callable[[Params], Params] = unchanged_params
    smooth: Declaration = None
    transparent: Callable[[Params], bool] = never


class Timing(StrEnum):
    """When an actuator with a state and a piecewise constant output acts on its input; sets its place in a chain."""

    SAMPLED = "sampled"  # once a sample, as a computer does: before all elements that move between the samples
    INVARIANT = "invariant"  # it commutes with dynamics, as a delay does: it acts before them wherever it stands
    INSTANT = "instant"  # at every instant: `follow` advances it between the samples


Mover: TypeAlias = Callable[[State, Scalar], tuple[State, Moments]]
"""``(state, command) -> (state after a step with the command held, Moments of the output over the step)``."""


class Unmodelled(NamedTuple):
    """Unmodelled dynamics G_mu(mu s) in series with the plant input (Section V-A2).

    The loop needs their output between the samples. Linear dynamics declare ``linear``, and dynamics whose output is
    constant between the samples declare ``held``; the loop is then exact at any T_s. All other dynamics advance by
    ``step``, and their output acts on the plant through its :class:`Moments`.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params) -> state``, at rest.
        step: ``(params, state, command, dt) -> state`` with the command held over dt.
        output: ``(params, state, command) -> command`` that the plant receives.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        sample: ``(params, state, command, key, dt) -> state`` once per sample of length dt, at the time of its
            command. The random key differs from channel to channel and from sample to sample.
        linear: ``(params) -> LinearSystem`` from the command to the output; its state lists the leaves of ``state``.
        held: Whether the output is constant from one sample to the next, and ``step`` changes nothing.
        moments: ``(params, state, command, dt) -> Moments`` of the output over dt; None: by Simpson's rule.
        smooth: Where it has a derivative (:mod:`dssc_jax.core.smoothness`); None: linearisations refuse it.
        continuous: Whether the slope of ``step`` at dt = 0 is the derivative of a model in continuous time.
        time_constant: Name of the parameter that scales all times of the dynamics, such as mu of a lag; the theory
            predicts oscillations as a function of this parameter. Empty: no parameter does so.
        timing: When the dynamics act, if their output is held and they have a state.
        advance: ``(params, dt) -> Mover``, called once for a draw, in place of ``step`` and ``moments``. If ``linear``
            is declared, too, ``advance`` moves only the elements before the linear part, leaves the states of the
            linear part alone, and returns the moments of that part's input; ``held`` then says that this input is
            constant from one sample to the next.
        follow: ``(params, state, start, end, dt) -> state`` for a command that goes in a straight line from start to
            end over dt; None: a step with the mean of the command.
        order: Order of the error of ``step``, ``moments`` or ``advance`` in the step; None: the order of the loop's
            method of integration holds.
        superposes: Whether ``sample`` and ``output`` are linear in state and command; ``linear`` implies it.
        averages: ``(params) -> bool``: whether the output may change within a sample, and then acts through its mean.
    """

    params: type
    init: Callable[[Params], State]
    step: Callable[[Params, State, Scalar, Scalar], State]
    output: Callable[[Params, State, Scalar], Scalar]
    prepare: Callable[[Params], Params] = unchanged_params
    sample: Callable[[Params, State, Scalar, jax.Array, Scalar], State] = ignore_sample
    linear: Callable[[Params], LinearSystem] | None = None
    held: bool = False
    moments: Callable[[Params, State, Scalar, Scalar], Moments] | None = None
    smooth: Declaration = None
    continuous: bool = False
    time_constant: str = ""
    timing: Timing = Timing.SAMPLED
    advance: Callable[[Params, Scalar], Mover] | None = None
    follow: Callable[[Params, State, Scalar, Scalar, Scalar], State] | None = None
    order: int | None = None
    superposes: bool = False
    averages: Callable[[Params], bool] = never
