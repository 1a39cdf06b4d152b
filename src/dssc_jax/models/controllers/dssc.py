"""Dynamic Smooth Sliding Control (14)-(18), and SSC as its special case with constant functions.

The sampled forms of filter and predictor are in :mod:`dssc_jax.models.controllers.dssc_forms`.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Controller
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, extent, nominal
from dssc_jax.core.registry import Discretisation, Entry
from dssc_jax.core.signals import (
    Command,
    Measurement,
    ReferencePoint,
    Scalar,
    State,
    TrackingError,
    tracking_error,
)
from dssc_jax.core.smoothness import (
    SWITCHES,
    Declaration,
    SmoothExtent,
    Smoothness,
    declared_smoothness,
    not_smooth,
    piecewise,
)
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.controllers.dssc_forms import (
    ControlSample,
    DsscGains,
    DsscState,
    PredictorStart,
    SampledForm,
    conservative_resting,
    conservative_update,
    explicit_resting,
    explicit_update,
    implicit_resting,
    implicit_update,
    phi_1_coordinate,
    phi_1_rate,
    sample_ratios,
    sigma_coordinate,
    sigma_rate,
    switching_gain,
)
from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS, Constant
from dssc_jax.models.controllers.modulation import ModulationSignals
from dssc_jax.models.controllers.nominal import nominal_control
from dssc_jax.models.controllers.state_functions import StateFunctions


class DsscInfo(NamedTuple):
    """What DSSC reports at each sample, for metrics and plots.

    ``sliding_margin`` is rho - |u_eq| [u], where the equivalent control u_eq = d_0/k_o of (20) is the u_0 that keeps
    sigma_tilde at 0. The sliding condition rho > |d_0|/k_o holds if the margin is not negative. In the implicit and
    the conservative form u_eq brings sigma_tilde to 0 within the sample. The explicit form never reaches 0; there u_eq
    is (20) with the difference of the last two sigma.

    ``integral_gain`` is K_I = 1/(k_o tau_av tau_m) of the synthesised law (22), whose K_P is K_I tau_m.
    """

    sigma_tilde: Annotated[Scalar, Quantity("y/s", "sliding variable")]
    sigma_hat: Annotated[Scalar, Quantity("y/s", "predictor's state")]
    u_av: Annotated[Scalar, Quantity("u", "averaged control")]
    u_0: Annotated[Scalar, Quantity("u", "switched control")]
    rho: Annotated[Scalar, Quantity("u", "modulation")]
    sliding_margin: Annotated[Scalar, Quantity("u", "rho - |u_eq|")]
    k_o: Annotated[Scalar, Quantity("y/(s^2 u)", "predictor gain")]
    tau_m: Annotated[Scalar, Quantity("s", "predictor time constant")]
    tau_av: Annotated[Scalar, Quantity("s", "averaging time constant")]
    integral_gain: Annotated[Scalar, Quantity("u/y", "integral gain of the synthesised law")]


def control_sample(
    gains: DsscGains, modulation: State, u_av: Scalar, measurement: Measurement, reference: ReferencePoint, dt: Scalar
) -> tuple[State, Scalar, ControlSample]:
    """The next state of the modulation, the nominal control, and what filter and predictor see at one sample.

    Args:
        gains: Gains of DSSC.
        modulation: State of the modulation rho.
        u_av: Averaged control before the sample [u].
        measurement: y and y'.
        reference: y_m and its derivatives.
        dt: T_s [s].
    """
    error: TrackingError = tracking_error(measurement, reference, gains.l0)
    at: StateFunctions = gains.functions.at(error.sigma, error.e, gains.l0)
    ratios = sample_ratios(at, dt)
    u_nominal = nominal_control(gains.nominal, gains.l0, error, reference, ratios.pole)
    signals = ModulationSignals(
        u_av=u_av,
        u_nominal=u_nominal,
        y=measurement.y,
        y_dot=measurement.y_dot,
        sigma=error.sigma,
        sigma_m_dot=reference.y_ddot + gains.l0 * reference.y_dot,
        k_o=at.k_o,
        tau_m=at.tau_m,
        l0=gains.l0,
    )
    modulation, rho = gains.rho.at(modulation, signals, dt)
    return modulation, u_nominal, ControlSample(error, at, ratios, rho)


def sliding_smoothness(gains: DsscGains) -> Smoothness:
    """Where DSSC has a derivative: in sliding and outside of it, but not at its end, |u_eq| = rho.

    There the clip of u_0 to rho has a corner. If the state-dependent functions have a derivative nowhere, nor has DSSC.

    Raises:
        ConfigError: The functions do not declare where they have a derivative.
    """
    try:
        functions = declared_smoothness(gains.functions, gains)
    except ConfigError as error:
        raise error.within_path("functions") from None
    if functions.extent == SmoothExtent.NOWHERE:
        return functions
    return piecewise("the end of sliding, |u_eq| = rho")


def explicit_smoothness(gains: DsscGains) -> Smoothness:
    """Where DSSC in its explicit form has a derivative: nowhere, unless a positive width smooths its sign."""
    smallest_width = 0.0
    if gains.sign_width is not None:
        smallest_width, _ = extent(gains.sign_width)
    if smallest_width == 0.0:
        return not_smooth(f"in its explicit form {SWITCHES}")
    return sliding_smoothness(gains)


def synthesised_gains(gains: DsscGains) -> tuple[Scalar, Scalar]:
    """K_P = 1/(k_o tau_av) [u s/y] and K_I = K_P/tau_m [u/y] of the law that (22) synthesises near 0.

    Near 0 means at sigma = 0 and e = 0, where the state-dependent functions are evaluated.
    """
    at = gains.functions.at(0.0, 0.0, gains.l0)
    proportional = 1.0 / (at.k_o * at.tau_av)
    return proportional, proportional / at.tau_m


def tunable_functions(gains: DsscGains) -> tuple[str, ...]:
    """Names of the constants that a comparison tunes, such as ``functions.kappa1``; () if none are declared."""
    return tuple(f"functions.{name}" for name in getattr(gains.functions, "tunable", ()))


def constant_gains(gains: DsscGains) -> TomlTable:
    """The table of an SSC that corresponds to DSSC: its constants are the values of DSSC's functions at the origin.

    The origin is sigma = 0 and e = 0. A law of l_0 counts with its median.
    """
    at = gains.functions.at(0.0, 0.0, nominal(gains.l0))
    constants = {"kind": "constant", **{name: float(value) for name, value in at._asdict().items()}}
    return {"functions": constants, "rho": switching_gain(gains), "predictor_start": gains.predictor_start.value}


def dssc(form: SampledForm, smooth: Declaration = sliding_smoothness) -> Controller:
    """Make the controller DSSC with a sampled form of its filter and predictor.

    Args:
        form: The sampled form.
        smooth: Declaration where the controller has a derivative.
    """

    def init(gains: DsscGains, measurement: Measurement, reference: ReferencePoint) -> DsscState:
        """u_av = 0, and sigma_hat = 0 or the first sigma; a start at 0 adds about phi_1(sigma) to the command.

        With the start ``midpoint`` the predictor's state belongs to half a sample before the first sample.
        """
        error = tracking_error(measurement, reference, gains.l0)
        predictor = 0.0 if gains.predictor_start == PredictorStart.ZERO else form.predictor(gains, error)
        earlier = 0.5 if gains.predictor_start == PredictorStart.MIDPOINT else ()
        return DsscState(0.0, predictor, error.sigma, gains.rho.init(), earlier)

    def step(
        gains: DsscGains, state: DsscState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[DsscState, Command, DsscInfo]:
        # one sample; `at` holds the values of the state-dependent functions
        modulation, u_nominal, sample = control_sample(gains, state.modulation, state.u_av, measurement, reference, dt)
        error, at, ratios, rho = sample
        earlier = state.earlier
        if gains.predictor_start == PredictorStart.MIDPOINT:
            # The form's update decays a state that is one sample old. At the first sample the state is half a sample
            # old (earlier = 0.5), so the decay of the other half is undone in advance.
            undecayed = state.predictor * (1.0 + earlier * dt * form.rate(gains, sample))
            state = state._replace(predictor=undecayed)
            earlier = 0.0 * earlier  # 0, but computed: the time loop of a kernel cannot carry a plain number
        after = form.update(gains, state, sample, dt)
        info = DsscInfo(
            sigma_tilde=error.sigma - after.sigma_hat,
            sigma_hat=after.sigma_hat,
            u_av=after.u_av,
            u_0=after.u_0,
            rho=rho,
            sliding_margin=rho - abs(after.u_eq),
            **at._asdict(),
            integral_gain=ratios.integral_gain,
        )
        state = DsscState(after.u_av, after.predictor, error.sigma, modulation, earlier)
        return state, Command(-after.u_av, u_nominal), info

    def transfer(
        gains: DsscGains, measurement: Measurement, reference: ReferencePoint, command: Scalar, dt: Scalar
    ) -> DsscState:
        """u_av is what the command lacks of the nominal control, and the predictor's state keeps it in sliding.

        Because u = -u_av + u_n, u_av is the nominal control minus the command. The first step from the returned state
        gives the command, for a bumpless start.
        """
        state = init(gains, measurement, reference)
        _, u_nominal, sample = control_sample(gains, state.modulation, 0.0, measurement, reference, dt)
        u_av = u_nominal - command  # command = -u_av + u_n
        # once more, because rho may depend on u_av
        _, _, sample = control_sample(gains, state.modulation, u_av, measurement, reference, dt)
        start, predictor = form.resting(gains, u_av, sample, dt)
        earlier = 0.0 if gains.predictor_start == PredictorStart.MIDPOINT else ()
        return state._replace(u_av=start, predictor=predictor, earlier=earlier)

    return Controller(
        DsscGains,
        init,
        step,
        transfer=transfer,
        smooth=smooth,
        synthesised=synthesised_gains,
        tunable=tunable_functions,
        info=DsscInfo,
    )


def require_constant_functions(gains: DsscGains) -> DsscGains:
    """The gains themselves, whose state-dependent functions must be constants, as those of SSC; raises ConfigError.

    Args:
        gains: Gains of an SSC, as its table states them.
    """
    if not isinstance(gains.functions, Constant):
        raise ConfigError("functions.kind", "ssc has constant functions; for others take kind = 'dssc'")
    return gains


MEMBERS = {
    Discretisation.IMPLICIT: dssc(SampledForm(sigma_coordinate, sigma_rate, implicit_update, implicit_resting)),
    Discretisation.CONSERVATIVE: dssc(
        SampledForm(phi_1_coordinate, phi_1_rate, conservative_update, conservative_resting)
    ),
    Discretisation.EXPLICIT: dssc(
        SampledForm(sigma_coordinate, sigma_rate, explicit_update, explicit_resting), explicit_smoothness
    ),
}


def default_form(table: TomlTable) -> Discretisation:
    """The sampled form for a controller's table that states none: the one that suits its state-dependent functions."""
    functions = table.get("functions")
    kind = functions.get("kind") if isinstance(functions, dict) else None
    if kind not in GAIN_FUNCTIONS:  # its absence is reported where the functions are parsed
        return Discretisation.CONSERVATIVE
    return GAIN_FUNCTIONS[kind].members[None].sampled_form


DSSC = Entry(
    MEMBERS,
    "dynamic smooth sliding control (14)-(18)",
    "discretisation",
    Discretisation.CONSERVATIVE,
    default_of=default_form,
    example={"l0": 0.5, "rho": 2.0, "functions": {"kind": "approx_sta_2", **GAIN_FUNCTIONS["approx_sta_2"].example}},
)
SSC = Entry(
    {
        form: member._replace(prepare=require_constant_functions, from_dssc=constant_gains)
        for form, member in MEMBERS.items()
    },
    "smooth sliding control: DSSC with constant functions",
    "discretisation",
    Discretisation.CONSERVATIVE,
    {"functions": {"kind": "constant"}},
    example={"l0": 0.5, "rho": 2.0, "functions": {"kind": "constant", **GAIN_FUNCTIONS["constant"].example}},
)
